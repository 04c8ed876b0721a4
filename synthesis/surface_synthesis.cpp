// SPDX-License-Identifier: AGPL-3.0-or-later
#include "synthesis/surface_synthesis.h"

#include <fmt/format.h>

#include <Eigen/Geometry>
#include <algorithm>
#include <array>
#include <atomic>
#include <cmath>
#include <limits>
#include <optional>

#include "meshing/core/error.h"
#include "meshing/core/parallel.h"
#include "meshing/core/random.h"
#include "meshing/surface/direction_field.h"
#include "synthesis/sample_areas.h"
#include "synthesis/synthesis_level.h"
#include "synthesis/texton_sweep.h"
#include "synthesis/window_optimization.h"

namespace shellgrid {
namespace {

constexpr int slots = SynthesisLevel::slots;
constexpr float reach_texels = 1.5f;  // how near continuations must agree to count as one patch, texels of the level

// An appearance vector lies in one vector register.
using Appearance = Eigen::Array<float, TextonSet::dimension, 1>;

class Synthesizer {
 public:
  Synthesizer(const TextonSet& textons, SurfaceTexture& result, const SynthesisOptions& options)
      : textons_(textons), layers_(textons.layers), result_(result), options_(options) {
    if (layers_.sample_count > 1)
      areas_.emplace(result.surface, options.paint.sample, layers_.sample_count, options.blend_width * textons.voxel,
                     options.blend_cost);
  }

  void run(Progress& progress) {
    if (options_.method == SynthesisMethod::textons) {
      progress.begin("synthesize", 1);
      comparisons_ = sweep_textons(result_.surface, textons_,
                                   {.neighbourhood = options_.neighbourhood, .seed = options_.seed}, place_);
      measure_coherence(build_synthesis_level(result_.surface, result_.hierarchy, 0, textons_.voxel, layers_.symmetry));
      write_result();
      progress.end();
      return;
    }
    const VertexHierarchy& hierarchy = result_.hierarchy;
    const int coarsest = static_cast<int>(hierarchy.levels.size()) - 1;
    place_.resize(result_.surface.mesh.vertex_count());
    progress.begin("synthesize", coarsest + 1);
    for (int l = coarsest; l >= 0; --l) {
      const SynthesisLevel level =
          build_synthesis_level(result_.surface, hierarchy, l, textons_.voxel, layers_.symmetry);
      appearance_scale_ = appearance_variance(l);
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
      comparisons_ += optimize_windows(
          result_.surface, hierarchy.levels[l], level, l, textons_,
          {.passes = options_.window_passes + (l > 0 && options_.window_passes > 0),
           .exhaustive = options_.method == SynthesisMethod::exhaustive,
           .evenness = l == 0 ? options_.final_evenness : options_.evenness},
          [&](std::int32_t v, int sample) { return price(v, sample) < SampleAreas::never; }, place_);
      if (l == 0) measure_coherence(level);
      progress.advance();
    }
    write_result();
    if (areas_) warn_of_narrow_areas(progress);
    progress.end();
  }

 private:
  // Areas of which nothing is farther from their border than another sample may come.
  void warn_of_narrow_areas(Progress& progress) const {
    int count = 0;
    long vertices = 0, others = 0;
    double surface = 0;
    for (const PaintedArea& area : areas_->list()) {
      if (area.depth >= options_.blend_width * textons_.voxel) continue;
      ++count;
      surface += area.surface;
      vertices += static_cast<long>(area.vertices.size());
      for (std::int32_t v : area.vertices) others += result_.sample[v] != area.sample;
    }
    if (10 * others <= vertices) return;
    progress.warn(
        fmt::format("{} painted area{}, {:.3g} mm² in all, narrower than {:g} texels ({:.3g} mm): {:.0f} % of {} "
                    "surface carries another "
                    "sample than painted there",
                    count, count == 1 ? " is" : "s are", surface, 2 * options_.blend_width,
                    2 * options_.blend_width * textons_.voxel,
                    100.0 * static_cast<double>(others) / static_cast<double>(vertices), count == 1 ? "its" : "their"));
  }

  float price(std::int32_t v, int sample) const { return areas_ ? areas_->price(v, sample) : 0.0f; }

  float appearance_variance(int l) const {
    if (!areas_) return 0;
    const std::vector<float>& appearance = textons_.levels[l].appearance;
    Appearance sum = Appearance::Zero(), squares = Appearance::Zero();
    for (int t = 0; t < textons_.texel_count(); ++t) {
      const Eigen::Map<const Appearance> a(&appearance[static_cast<std::size_t>(t) * TextonSet::dimension]);
      sum += a, squares += a.square();
    }
    const float n = static_cast<float>(textons_.texel_count());
    return (squares / n - (sum / n).square()).sum();
  }

  // What the neighbour's patch has at `place` of the asking frame, in texels.
  LayerPlace continued(const TangentNeighbour& neighbour, const Vec2f& place) const {
    LayerPlace from = layers_.turned(place_[neighbour.vertex], -neighbour.turn);
    from.at = layers_.wrap(from.layer, from.at + neighbour.rotate(place - neighbour.offset));
    return from;
  }

  void start_randomly(const SynthesisLevel& level) {
    for (std::int32_t v : level.vertices) {
      RandomStream random(hash64(options_.seed, 51), static_cast<std::uint64_t>(v));
      const double u = random.next(), t = random.next();
      int layer = !areas_ ? 0 : options_.paint.sample[v];
      place_[v] = {layer, layers_.wrap(layer, Vec2f(static_cast<float>(u * layers_[layer].width),
                                                    static_cast<float>(t * layers_[layer].height)))};
    }
  }

  // Every vertex continues the coarser vertex nearest to it.
  void upsample(const SynthesisLevel& level, int l) {
    const VertexHierarchy::Level& coarser = result_.hierarchy.levels[l + 1];
    const float jitter = l >= options_.least_jitter_level ? std::ldexp(static_cast<float>(options_.jitter), l) : 0.0f;
    std::vector<LayerPlace> started(level.vertices.size());
    parallel_for(level.vertices.size(), [&](std::size_t i) {
      const std::int32_t v = level.vertices[i];
      const TangentNeighbour parent =
          find_tangent_neighbour(result_.surface, coarser, v, Vec2::Zero(), textons_.voxel, layers_.symmetry);
      RandomStream random(hash64(options_.seed, 52, static_cast<std::uint64_t>(l)), static_cast<std::uint64_t>(v));
      const float ju = std::round(jitter * static_cast<float>(2 * random.next() - 1));
      const float jv = std::round(jitter * static_cast<float>(2 * random.next() - 1));
      started[i] = continued(parent, Vec2f::Zero());
      started[i].at = layers_.wrap(started[i].layer, started[i].at + Vec2f(ju, jv));
    });
    for (std::size_t i = 0; i < level.vertices.size(); ++i) place_[level.vertices[i]] = started[i];
  }

  // Gives one vertex the candidate whose surroundings in the sample differ least from its neighbours on the surface.
  void correct(const SynthesisLevel& level, int l, std::int32_t position) {
    const float step = std::ldexp(1.0f, l);
    const TextonSet::Level& textons = textons_.levels[l];
    const float* appearance = textons.appearance.data();
    const auto appearance_at = [&](std::int32_t t) {
      return Eigen::Map<const Appearance>(appearance + static_cast<std::size_t>(t) * TextonSet::dimension);
    };
    struct Shift {
      int x, y;
    };
    std::array<Appearance, slots> wanted;
    std::array<Shift, slots> shifts;
    std::array<LayerPlace, slots + 1> continuations;
    std::array<std::int32_t, slots + 1> texels;
    int used = 0, continuation_count = 0;
    const std::int32_t v = level.vertices[position];
    const auto add_continuation = [&](const LayerPlace& place) {
      const std::int32_t texel = layers_.texel(place);
      for (int c = 0; c < continuation_count; ++c)
        if (texels[c] == texel) return;
      texels[continuation_count] = texel;
      continuations[continuation_count++] = place;
    };
    add_continuation(place_[v]);
    for (int s = 0; s < slots; ++s) {
      const TangentNeighbour& neighbour = level.neighbour(position, s);
      if (neighbour.vertex < 0) continue;
      const Vec2f place = SynthesisLevel::offsets[s] * step;
      wanted[used] = appearance_at(layers_.texel(continued(neighbour, place)));
      shifts[used++] = {static_cast<int>(place.x()), static_cast<int>(place.y())};
      add_continuation(continued(neighbour, Vec2f::Zero()));
    }
    float best_distance = std::numeric_limits<float>::max();
    LayerPlace best = place_[v];
    long compared = 0;
    const float variance = appearance_scale_ * static_cast<float>(used);
    const auto consider = [&](int layer_index, int tx, int ty, const Vec2f& fraction, float penalty) {
      const SampleLayer& layer = layers_[layer_index];
      ++compared;
      float distance = variance * price(v, layer.sample);
      if (!(distance * penalty < best_distance)) return;
      for (int s = 0; s < used; ++s) {
        int x = tx + shifts[s].x, y = ty + shifts[s].y;
        x += x < 0 ? layer.width : x >= layer.width ? -layer.width : 0;
        y += y < 0 ? layer.height : y >= layer.height ? -layer.height : 0;
        distance += (wanted[s] - appearance_at(layer.first + y * layer.width + x)).square().sum();
        if (distance * penalty >= best_distance) return;
      }
      best_distance = distance * penalty;
      best = {layer_index, Vec2f(static_cast<float>(tx), static_cast<float>(ty)) + fraction};
    };
    const auto consider_texel = [&](int layer, std::int32_t texel, const Vec2f& fraction, float penalty) {
      const std::int32_t at = texel - layers_[layer].first;
      consider(layer, at % layers_[layer].width, at / layers_[layer].width, fraction, penalty);
    };
    const float penalty = static_cast<float>(options_.incoherence_penalty);
    const float turn_penalty = static_cast<float>(options_.turn_penalty);
    const bool exhaustive = options_.method == SynthesisMethod::exhaustive;
    for (int c = 0; c < continuation_count; ++c) {
      const LayerPlace& from = continuations[c];
      const Vec2f fraction = from.at - from.at.array().floor().matrix();
      consider(from.layer, static_cast<int>(from.at.x()), static_cast<int>(from.at.y()), fraction, 1.0f);
      if (exhaustive) continue;
      const std::int32_t* candidates =
          textons.candidates.data() + static_cast<std::size_t>(texels[c]) * textons_.candidates_each();
      for (int k = 0; k < textons_.candidates_each(); ++k)
        if (candidates[k] >= 0) {
          const int layer = layers_.layer_of(candidates[k]);
          const bool turns = layers_.turn_of(layer) != layers_.turn_of(from.layer);
          consider_texel(layer, candidates[k], fraction, turns ? penalty * turn_penalty : penalty);
        }
    }
    for (int layer = 0; exhaustive && layer < layers_.size(); ++layer)
      for (int t = 0; t < layers_[layer].texel_count(); ++t)
        consider_texel(layer, layers_[layer].first + t, Vec2f(0.5f, 0.5f), penalty);
    best.at = layers_.wrap(best.layer, best.at);
    place_[v] = best;
    comparisons_.fetch_add(compared, std::memory_order_relaxed);
  }

  // Within a patch, moves every coordinate to the mean of what its neighbours' continuations say, so that rounding and
  // the mesh's irregularity do not fray the edges of what the patch shows. Patches stay apart.
  void relax(const SynthesisLevel& level, int l) {
    const float reach = std::ldexp(reach_texels, l);  // neighbours farther off show another patch
    std::vector<Vec2f> moved(level.vertices.size());
    for (int sweep = 0; sweep < options_.relaxation_sweeps; ++sweep) {
      parallel_for(level.vertices.size(), [&](std::size_t i) {
        const LayerPlace& own = place_[level.vertices[i]];
        Vec2f sum = Vec2f::Zero();
        float weight = 1;
        for (int s = 0; s < slots; ++s) {
          const TangentNeighbour& neighbour = level.neighbour(i, s);
          if (neighbour.vertex < 0) continue;
          const LayerPlace there = continued(neighbour, Vec2f::Zero());
          if (there.layer != own.layer) continue;
          const Vec2f step = layers_.difference(own.layer, there.at, own.at);
          if (step.cwiseAbs().maxCoeff() < reach) sum += step, weight += 1;
        }
        moved[i] = layers_.wrap(own.layer, own.at + sum / weight);
      });
      for (std::size_t i = 0; i < level.vertices.size(); ++i) place_[level.vertices[i]].at = moved[i];
    }
  }

  void measure_coherence(const SynthesisLevel& level) {
    result_.coherence.assign(level.vertices.size(), 1.0f);
    parallel_for(level.vertices.size(), [&](std::size_t i) {
      const LayerPlace& own = place_[level.vertices[i]];
      int used = 0, coherent = 0;
      for (int s = 0; s < slots; ++s) {
        const TangentNeighbour& neighbour = level.neighbour(i, s);
        if (neighbour.vertex < 0) continue;
        const LayerPlace there = continued(neighbour, Vec2f::Zero());
        ++used;
        coherent +=
            there.layer == own.layer && layers_.difference(own.layer, there.at, own.at).cwiseAbs().maxCoeff() < 1.0f;
      }
      if (used > 0) result_.coherence[level.vertices[i]] = static_cast<float>(coherent) / static_cast<float>(used);
    });
  }

  // Coordinates of the samples as they are; the turns go into the directions.
  void write_result() {
    TexturedSurface& surface = result_.surface;
    result_.comparisons = comparisons_;
    result_.coordinate.resize(place_.size());
    result_.sample.resize(place_.size());
    parallel_for(place_.size(), [&](std::size_t v) {
      const int turn = layers_.turn_of(place_[v].layer);
      const LayerPlace base = layers_.turned(place_[v], -turn);
      result_.coordinate[v] = layers_.wrap(base.layer, base.at);
      result_.sample[v] = base.layer;
      if (turn == 0) return;
      const Vec3 u = surface.directions.row(v).transpose(), n = surface.normals.row(v).transpose();
      const int quarters = layers_[place_[v].layer].turn;
      const Vec3 across = n.cross(u);
      surface.directions.row(v) = (quarters == 1 ? across : quarters == 2 ? Vec3(-u) : Vec3(-across)).transpose();
    });
  }

  const TextonSet& textons_;
  const SampleLayers& layers_;
  SurfaceTexture& result_;
  const SynthesisOptions& options_;
  std::vector<LayerPlace> place_;     // of each vertex
  std::optional<SampleAreas> areas_;  // of several samples
  float appearance_scale_ = 0;
  std::atomic<long> comparisons_ = 0;
};

void check_inputs(const TriangleMesh& mesh, const TextonSet& textons, const SurfacePaint& paint) {
  if (mesh.face_count() == 0) throw InputError("a mesh without faces cannot be textured");
  const double spacing = mean_edge_length(mesh);
  if (!(spacing > 0.4 * textons.voxel && spacing < 1.7 * textons.voxel))
    throw InputError("the mesh's mean edge length is " + std::to_string(spacing) + " mm and the sample's voxel " +
                     std::to_string(textons.voxel) + " mm; they must match; try sg-prepare --spacing " +
                     std::to_string(textons.voxel));
  const std::size_t n = mesh.vertex_count();
  if (textons.layers.sample_count > 1 && paint.sample.empty())
    throw InputError("there are " + std::to_string(textons.layers.sample_count) +
                     " samples, but nothing says which vertex takes which");
  if ((!paint.sample.empty() && paint.sample.size() != n) ||
      (!paint.direction.empty() && paint.direction.size() != n) || (!paint.scale.empty() && paint.scale.size() != n))
    throw InternalError("one value of the paint a vertex expected");
  for (std::int32_t s : paint.sample)
    if (s < 0 || s >= textons.layers.sample_count)
      throw InputError("a vertex wants sample " + std::to_string(s) + ", but there are " +
                       std::to_string(textons.layers.sample_count) + ", counted from 0");
  for (float s : paint.scale)
    if (!(s >= 0.25f && s <= 4)) throw InputError("the sample's scale must be within 0.25 and 4");
}

// Painted directions that run along the surface.
void add_painted(const SurfacePaint& paint, const TexturedSurface& surface,
                 std::vector<DirectionConstraint>& constraints) {
  for (std::size_t v = 0; v < paint.direction.size(); ++v) {
    const Vec3 wanted = paint.direction[v].cast<double>(), n = surface.normals.row(v).transpose();
    if (!wanted.allFinite() || !((wanted - n * n.dot(wanted)).norm() > 0.1 * wanted.norm())) continue;
    constraints.push_back({surface.mesh.vertex(static_cast<int>(v)), wanted, static_cast<std::int32_t>(v)});
  }
}

}  // namespace

SurfaceTexture synthesize_surface(const TriangleMesh& mesh, const TextonSet& textons, const SynthesisOptions& options,
                                  Progress& progress) {
  check_inputs(mesh, textons, options.paint);
  SurfaceTexture result;
  TexturedSurface& surface = result.surface;
  surface.mesh = mesh;
  surface.half_edges = build_half_edges(mesh);
  surface.normals = vertex_normals(mesh);
  surface.scale = options.paint.scale;
  result.hierarchy = build_vertex_hierarchy(mesh, surface.half_edges, surface.normals, textons.voxel,
                                            static_cast<int>(textons.levels.size()), options.seed);
  std::vector<DirectionConstraint> constraints = options.orient;
  add_painted(options.paint, surface, constraints);
  const int symmetry = textons.layers.symmetry;
  surface.directions =
      make_direction_field(mesh, surface.normals, result.hierarchy, options.direction, constraints, symmetry);
  const std::vector<int> indices = direction_field_indices(mesh, surface.normals, surface.directions, symmetry);
  for (int f = 0; f < mesh.face_count(); ++f)
    if (indices[f] != 0)
      result.singularities.push_back(
          {(mesh.vertex(mesh.faces(f, 0)) + mesh.vertex(mesh.faces(f, 1)) + mesh.vertex(mesh.faces(f, 2))) / 3,
           static_cast<double>(indices[f]) / symmetry});
  Synthesizer(textons, result, options).run(progress);
  return result;
}

}  // namespace shellgrid
