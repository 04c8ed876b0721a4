// SPDX-License-Identifier: AGPL-3.0-or-later
#include "synthesis/surface_synthesis.h"

#include <algorithm>
#include <array>
#include <cmath>

#include "meshing/core/error.h"
#include "meshing/core/parallel.h"
#include "meshing/core/random.h"
#include "meshing/surface/direction_field.h"

namespace shellgrid {
namespace {

constexpr int slot_count = 8;
constexpr float reach_texels = 1.5f;  // how near continuations must agree to count as one patch, texels of the level
const std::array<Vec2f, slot_count> slot_offsets = {Vec2f(1, 0),  Vec2f(1, 1),   Vec2f(0, 1),  Vec2f(-1, 1),
                                                    Vec2f(-1, 0), Vec2f(-1, -1), Vec2f(0, -1), Vec2f(1, -1)};

// An appearance vector lies in one vector register.
using Appearance = Eigen::Array<float, TextonSet::dimension, 1>;

// Steps from a texel to a neighbour's place.
struct Shift {
  int x, y;
};

// One level of the synthesis: its vertices, their neighbours, and groups that may change at once.
struct SynthesisLevel {
  std::vector<std::int32_t> vertices;
  std::vector<TangentNeighbour> neighbours;       // 8 a vertex
  std::vector<std::vector<std::int32_t>> groups;  // positions in `vertices`
};

// Splits the level's vertices so that no vertex has a neighbour, or is one, in its own group. Greedy, in vertex order.
void color_vertices(SynthesisLevel& level, int mesh_vertices) {
  const int count = static_cast<int>(level.vertices.size());
  std::vector<std::int32_t> position(mesh_vertices, -1);
  for (int i = 0; i < count; ++i) position[level.vertices[i]] = i;
  std::vector<std::int32_t> offsets(count + 1, 0), readers(level.neighbours.size());
  const auto neighbour_of = [&](int i, int s) {
    const std::int32_t v = level.neighbours[static_cast<std::size_t>(i) * slot_count + s].vertex;
    return v < 0 ? -1 : position[v];
  };
  for (int i = 0; i < count; ++i)
    for (int s = 0; s < slot_count; ++s)
      if (const int j = neighbour_of(i, s); j >= 0) ++offsets[j + 1];
  for (int i = 0; i < count; ++i) offsets[i + 1] += offsets[i];
  std::vector<std::int32_t> fill(offsets.begin(), offsets.end() - 1);
  for (int i = 0; i < count; ++i)
    for (int s = 0; s < slot_count; ++s)
      if (const int j = neighbour_of(i, s); j >= 0) readers[fill[j]++] = i;
  std::vector<std::int32_t> color(count, -1), taken;
  for (int i = 0; i < count; ++i) {
    const auto mark = [&](int j) {
      if (j < 0 || j == i || color[j] < 0) return;
      taken[color[j]] = i;
    };
    taken.resize(level.groups.size(), -1);
    for (int s = 0; s < slot_count; ++s) mark(neighbour_of(i, s));
    for (int at = offsets[i]; at < offsets[i + 1]; ++at) mark(readers[at]);
    int free = 0;
    while (free < static_cast<int>(taken.size()) && taken[free] == i) ++free;
    if (free == static_cast<int>(taken.size())) level.groups.emplace_back(), taken.push_back(-1);
    color[i] = free;
    level.groups[free].push_back(i);
  }
}

class Synthesizer {
 public:
  Synthesizer(const TextonSet& textons, SurfaceTexture& result, const SynthesisOptions& options)
      : textons_(textons), result_(result), options_(options), size_(textons.width, textons.height) {}

  void run(Progress& progress) {
    const VertexHierarchy& hierarchy = result_.hierarchy;
    const int coarsest = static_cast<int>(hierarchy.levels.size()) - 1;
    result_.coordinate.assign(result_.surface.mesh.vertex_count(), Vec2f::Zero());
    progress.begin("synthesize", coarsest + 1);
    for (int l = coarsest; l >= 0; --l) {
      const SynthesisLevel level = build_level(l);
      if (l == coarsest)
        start_randomly(level);
      else
        upsample(level, l);
      const int passes = l == coarsest ? std::max(options_.coarse_passes, l == 0 ? options_.final_passes : 0)
                         : l == 0      ? options_.final_passes
                                       : options_.passes;
      for (int pass = 0; pass < passes; ++pass) {
        for (const std::vector<std::int32_t>& group : level.groups)
          parallel_for(
              group.size(), [&](std::size_t i) { correct(level, l, group[i]); }, 64);
        relax(level, l);
      }
      if (l == 0) measure_coherence(level);
      progress.advance();
    }
    progress.end();
  }

 private:
  Vec2f wrap(Vec2f c) const {
    for (int axis = 0; axis < 2; ++axis) {
      const float n = static_cast<float>(size_[axis]);
      c[axis] -= n * std::floor(c[axis] / n);
      if (!(c[axis] < n)) c[axis] = 0;
    }
    return c;
  }
  // The shortest way from b to a on the torus of texels.
  Vec2f difference(const Vec2f& a, const Vec2f& b) const {
    Vec2f d = a - b;
    for (int axis = 0; axis < 2; ++axis) {
      const float n = static_cast<float>(size_[axis]);
      d[axis] -= n * std::round(d[axis] / n);
    }
    return d;
  }
  // The coordinate must be wrapped.
  int texel(const Vec2f& c) const { return static_cast<int>(c.y()) * size_.x() + static_cast<int>(c.x()); }

  SynthesisLevel build_level(int l) const {
    const VertexHierarchy::Level& hierarchy_level = result_.hierarchy.levels[l];
    SynthesisLevel level;
    level.vertices = hierarchy_level.vertices;
    level.neighbours.resize(level.vertices.size() * slot_count);
    const double step = std::ldexp(1.0, l);
    parallel_for(
        level.vertices.size(),
        [&](std::size_t i) {
          for (int s = 0; s < slot_count; ++s)
            level.neighbours[i * slot_count + s] =
                find_tangent_neighbour(result_.surface, hierarchy_level, level.vertices[i],
                                       slot_offsets[s].cast<double>() * step, textons_.voxel);
        },
        64);
    color_vertices(level, result_.surface.mesh.vertex_count());
    return level;
  }

  void start_randomly(const SynthesisLevel& level) {
    for (std::int32_t v : level.vertices) {
      RandomStream random(hash64(options_.seed, 51), static_cast<std::uint64_t>(v));
      const double u = random.next() * size_.x(), t = random.next() * size_.y();
      result_.coordinate[v] = wrap(Vec2f(static_cast<float>(u), static_cast<float>(t)));
    }
  }

  // Every vertex continues the coarser vertex nearest to it.
  void upsample(const SynthesisLevel& level, int l) {
    const VertexHierarchy::Level& coarser = result_.hierarchy.levels[l + 1];
    const float jitter = l >= options_.least_jitter_level ? std::ldexp(static_cast<float>(options_.jitter), l) : 0.0f;
    std::vector<Vec2f> started(level.vertices.size());
    parallel_for(level.vertices.size(), [&](std::size_t i) {
      const std::int32_t v = level.vertices[i];
      const TangentNeighbour parent = find_tangent_neighbour(result_.surface, coarser, v, Vec2::Zero(), textons_.voxel);
      RandomStream random(hash64(options_.seed, 52, static_cast<std::uint64_t>(l)), static_cast<std::uint64_t>(v));
      const float ju = std::round(jitter * static_cast<float>(2 * random.next() - 1));
      const float jv = std::round(jitter * static_cast<float>(2 * random.next() - 1));
      started[i] = wrap(result_.coordinate[parent.vertex] - parent.rotate(parent.offset) + Vec2f(ju, jv));
    });
    for (std::size_t i = 0; i < level.vertices.size(); ++i) result_.coordinate[level.vertices[i]] = started[i];
  }

  // Gives one vertex the candidate whose surroundings in the sample differ least from its neighbours on the surface.
  void correct(const SynthesisLevel& level, int l, std::int32_t position) {
    const float step = std::ldexp(1.0f, l);
    const TextonSet::Level& textons = textons_.levels[l];
    const float* appearance = textons.appearance.data();
    const auto appearance_at = [&](int t) {
      return Eigen::Map<const Appearance>(appearance + static_cast<std::size_t>(t) * TextonSet::dimension);
    };
    std::array<Appearance, slot_count> wanted;
    std::array<Vec2f, slot_count + 1> continuations;
    std::array<Shift, slot_count> shifts;
    int used = 0, continuation_count = 0;
    const std::int32_t v = level.vertices[position];
    continuations[continuation_count++] = result_.coordinate[v];
    for (int s = 0; s < slot_count; ++s) {
      const TangentNeighbour& neighbour = level.neighbours[static_cast<std::size_t>(position) * slot_count + s];
      if (neighbour.vertex < 0) continue;
      const Vec2f place = slot_offsets[s] * step, coordinate = result_.coordinate[neighbour.vertex];
      wanted[used] = appearance_at(texel(wrap(coordinate + neighbour.rotate(place - neighbour.offset))));
      shifts[used++] = {static_cast<int>(place.x()), static_cast<int>(place.y())};
      continuations[continuation_count++] = wrap(coordinate - neighbour.rotate(neighbour.offset));
    }
    float best_distance = 3e38f;
    Vec2f best = result_.coordinate[v];
    const auto consider = [&](int tx, int ty, const Vec2f& fraction, float penalty) {
      float distance = 0;
      for (int s = 0; s < used; ++s) {
        int x = (tx + shifts[s].x) % size_.x(), y = (ty + shifts[s].y) % size_.y();
        x += x < 0 ? size_.x() : 0, y += y < 0 ? size_.y() : 0;
        distance += (wanted[s] - appearance_at(y * size_.x() + x)).square().sum();
        if (distance * penalty >= best_distance) return;
      }
      best_distance = distance * penalty;
      best = Vec2f(static_cast<float>(tx), static_cast<float>(ty)) + fraction;
    };
    const float penalty = static_cast<float>(options_.incoherence_penalty);
    for (int c = 0; c < continuation_count; ++c) {
      const int tx = static_cast<int>(continuations[c].x()), ty = static_cast<int>(continuations[c].y());
      const Vec2f fraction = continuations[c] - Vec2f(static_cast<float>(tx), static_cast<float>(ty));
      consider(tx, ty, fraction, 1.0f);
      const std::int32_t* candidates =
          textons.candidates.data() + static_cast<std::size_t>(ty * size_.x() + tx) * textons_.candidate_count;
      for (int k = 0; k < textons_.candidate_count; ++k)
        consider(candidates[k] % size_.x(), candidates[k] / size_.x(), fraction, penalty);
    }
    result_.coordinate[v] = wrap(best);
  }

  // Within a patch, moves every coordinate to the mean of what its neighbours' continuations say, so that rounding and
  // the mesh's irregularity do not fray the edges of what the patch shows. Patches stay apart.
  void relax(const SynthesisLevel& level, int l) {
    const float reach = std::ldexp(reach_texels, l);  // neighbours farther off show another patch
    std::vector<Vec2f> moved(level.vertices.size());
    for (int sweep = 0; sweep < options_.relaxation_sweeps; ++sweep) {
      parallel_for(level.vertices.size(), [&](std::size_t i) {
        const Vec2f own = result_.coordinate[level.vertices[i]];
        Vec2f sum = Vec2f::Zero();
        float weight = 1;
        for (int s = 0; s < slot_count; ++s) {
          const TangentNeighbour& neighbour = level.neighbours[i * slot_count + s];
          if (neighbour.vertex < 0) continue;
          const Vec2f step = difference(result_.coordinate[neighbour.vertex] - neighbour.rotate(neighbour.offset), own);
          if (step.cwiseAbs().maxCoeff() < reach) sum += step, weight += 1;
        }
        moved[i] = wrap(own + sum / weight);
      });
      for (std::size_t i = 0; i < level.vertices.size(); ++i) result_.coordinate[level.vertices[i]] = moved[i];
    }
  }

  void measure_coherence(const SynthesisLevel& level) {
    result_.coherence.assign(level.vertices.size(), 1.0f);
    parallel_for(level.vertices.size(), [&](std::size_t i) {
      int used = 0, coherent = 0;
      for (int s = 0; s < slot_count; ++s) {
        const TangentNeighbour& neighbour = level.neighbours[i * slot_count + s];
        if (neighbour.vertex < 0) continue;
        const Vec2f step = difference(result_.coordinate[neighbour.vertex] - neighbour.rotate(neighbour.offset),
                                      result_.coordinate[level.vertices[i]]);
        ++used;
        coherent += step.cwiseAbs().maxCoeff() < 1.0f;
      }
      if (used > 0) result_.coherence[level.vertices[i]] = static_cast<float>(coherent) / static_cast<float>(used);
    });
  }

  const TextonSet& textons_;
  SurfaceTexture& result_;
  const SynthesisOptions& options_;
  const Eigen::Vector2i size_;
};

}  // namespace

SurfaceTexture synthesize_surface(const TriangleMesh& mesh, const TextonSet& textons, const SynthesisOptions& options,
                                  Progress& progress) {
  if (mesh.face_count() == 0) throw InputError("a mesh without faces cannot be textured");
  const double spacing = mean_edge_length(mesh);
  if (!(spacing > 0.4 * textons.voxel && spacing < 1.7 * textons.voxel))
    throw InputError("the mesh's mean edge length is " + std::to_string(spacing) + " mm and the sample's voxel " +
                     std::to_string(textons.voxel) + " mm; they must match; try sg-prepare --spacing " +
                     std::to_string(textons.voxel));
  SurfaceTexture result;
  TexturedSurface& surface = result.surface;
  surface.mesh = mesh;
  surface.half_edges = build_half_edges(mesh);
  surface.normals = vertex_normals(mesh);
  result.hierarchy = build_vertex_hierarchy(mesh, surface.half_edges, surface.normals, textons.voxel,
                                            static_cast<int>(textons.levels.size()), options.seed);
  surface.directions = make_direction_field(mesh, surface.normals, result.hierarchy, options.direction, options.orient);
  const std::vector<int> indices = direction_field_indices(mesh, surface.normals, surface.directions);
  for (int f = 0; f < mesh.face_count(); ++f)
    if (indices[f] != 0)
      result.singularities.push_back(
          {(mesh.vertex(mesh.faces(f, 0)) + mesh.vertex(mesh.faces(f, 1)) + mesh.vertex(mesh.faces(f, 2))) / 3,
           indices[f]});
  Synthesizer(textons, result, options).run(progress);
  return result;
}

}  // namespace shellgrid
