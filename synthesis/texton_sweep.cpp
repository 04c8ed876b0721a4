// SPDX-License-Identifier: AGPL-3.0-or-later
#include "synthesis/texton_sweep.h"

#include <Eigen/Geometry>
#include <algorithm>
#include <cmath>
#include <queue>

#include "meshing/core/error.h"
#include "meshing/core/parallel.h"
#include "meshing/core/random.h"
#include "meshing/surface/direction_field.h"
#include "synthesis/candidate_search.h"

namespace shellgrid {
namespace {

constexpr int dimension = TextonSet::dimension;
constexpr double ring_reach = 2;  // texels: neighbours no farther off are continued

// Textons as vectors: the means of their texels' appearance.
RowMatrixf texton_centers(const TextonSet& textons) {
  Eigen::MatrixXd sums = Eigen::MatrixXd::Zero(textons.texton_count, dimension);
  std::vector<int> members(textons.texton_count, 0);
  for (int t = 0; t < textons.texel_count(); ++t) {
    const int label = textons.textons[t];
    ++members[label];
    for (int d = 0; d < dimension; ++d)
      sums(label, d) += textons.levels[0].appearance[static_cast<std::size_t>(t) * dimension + d];
  }
  for (int k = 0; k < textons.texton_count; ++k) sums.row(k) /= std::max(1, members[k]);
  return sums.cast<float>();
}

class TextonSweep {
 public:
  TextonSweep(const TexturedSurface& surface, const TextonSet& textons, const TextonSweepOptions& options,
              std::vector<LayerPlace>& place)
      : surface_(surface),
        textons_(textons),
        layer_(textons.layers[0]),
        options_(options),
        place_(place),
        reach_(options.neighbourhood / 2),
        assigned_(surface.mesh.vertex_count(), 0),
        stamp_(surface.mesh.vertex_count(), -1),
        flat_(surface.mesh.vertex_count()) {
    const RowMatrixf centers = texton_centers(textons);
    products_ = centers * centers.transpose();
    find_alike(centers);
  }

  long run() {
    for (std::int32_t v : distance_order()) {
      assign(v);
      assigned_[v] = 1;
    }
    return comparisons_;
  }

 private:
  // For each texel the k places whose windows of the texton map are most like its own.
  void find_alike(const RowMatrixf& centers) {
    const int w = layer_.width, h = layer_.height, across = options_.neighbourhood;
    RowMatrixf windows(w * h, across * across * dimension);
    parallel_for(static_cast<std::size_t>(w) * h, [&](std::size_t t) {
      const int x = static_cast<int>(t) % w, y = static_cast<int>(t) / w;
      for (int k = 0; k < across * across; ++k)
        windows.block(static_cast<Eigen::Index>(t), k * dimension, 1, dimension) =
            centers.row(textons_.textons[texel(x + k % across - reach_, y + k / across - reach_)]);
    });
    const int room = static_cast<int>(std::sqrt(w * h / (4.0 * (options_.coherence + 1))));
    alike_ = find_candidates(reduce_dimensions(windows, dimension), SampleLayers::make({{w, h}}, 1), {0}, {0},
                             options_.coherence, std::clamp(room, 1, 5));
  }

  std::int32_t texel(int x, int y) const {
    x %= layer_.width, y %= layer_.height;
    return (y < 0 ? y + layer_.height : y) * layer_.width + (x < 0 ? x + layer_.width : x);
  }

  // All vertices by their distance along edges from the first of their component.
  std::vector<std::int32_t> distance_order() const {
    const TriangleMesh& mesh = surface_.mesh;
    std::vector<std::int32_t> order;
    std::vector<double> distance(mesh.vertex_count(), 1e300);
    std::vector<char> done(mesh.vertex_count(), 0);
    using Entry = std::pair<double, std::int32_t>;
    std::priority_queue<Entry, std::vector<Entry>, std::greater<>> queue;
    for (int start = 0; start < mesh.vertex_count(); ++start) {
      if (done[start]) continue;
      distance[start] = 0;
      queue.emplace(0.0, start);
      while (!queue.empty()) {
        const auto [d, v] = queue.top();
        queue.pop();
        if (done[v]) continue;
        done[v] = 1;
        order.push_back(v);
        for_each_neighbour(v, [&](std::int32_t w) {
          const double length = d + (mesh.vertex(w) - mesh.vertex(v)).norm();
          if (length < distance[w]) distance[w] = length, queue.emplace(length, w);
        });
      }
    }
    return order;
  }

  template <class Visit>
  void for_each_neighbour(std::int32_t v, const Visit& visit) const {
    surface_.half_edges.for_each_outgoing(v, [&](std::int32_t h) {
      visit(HalfEdges::to(surface_.mesh, h));
      visit(HalfEdges::from(surface_.mesh, HalfEdges::previous(h)));
    });
  }

  // Places the vertices around `v` in its tangent plane, in texels of its frame.
  void flatten_around(std::int32_t v) {
    const Vec3 origin = surface_.mesh.vertex(v), n = surface_.normals.row(v).transpose();
    const Vec3 u = surface_.directions.row(v).transpose(), across = n.cross(u);
    const double texel_length = surface_.texel_length(v, textons_.voxel), reach = std::sqrt(2.0) * (reach_ + 1);
    around_.assign(1, v);
    stamp_[v] = v;
    flat_[v] = Vec2::Zero();
    for (std::size_t at = 0; at < around_.size(); ++at)
      for_each_neighbour(around_[at], [&](std::int32_t w) {
        if (stamp_[w] == v) return;
        const Vec3 way = surface_.mesh.vertex(w) - origin;
        if (surface_.normals.row(w).dot(n.transpose()) < 0) return;
        Vec2 flat(way.dot(u), way.dot(across));
        if (const double length = flat.norm(); length > 1e-12) flat *= way.norm() / length;
        flat /= texel_length;
        if (flat.norm() > reach) return;
        stamp_[w] = v;
        flat_[w] = flat;
        around_.push_back(w);
      });
  }

  // A place of the neighbourhood, and the interpolated texton there.
  struct Place {
    int x, y;
    std::int32_t textons[3];
    float weights[3];
    float squared_norm;  // Σ w_i w_j (a_i·a_j)
  };

  // Interpolates the textons of assigned vertices on the grid around `v`.
  void fill_neighbourhood(std::int32_t v) {
    neighbourhood_.clear();
    const int across = options_.neighbourhood;
    filled_.assign(static_cast<std::size_t>(across) * across, 0);
    for (std::int32_t a : around_)
      surface_.half_edges.for_each_outgoing(a, [&](std::int32_t h) {
        const int face = HalfEdges::face(h);
        const std::int32_t corner[3] = {surface_.mesh.faces(face, 0), surface_.mesh.faces(face, 1),
                                        surface_.mesh.faces(face, 2)};
        if (a != std::min({corner[0], corner[1], corner[2]})) return;
        for (std::int32_t c : corner)
          if (stamp_[c] != v || !assigned_[c]) return;
        const Vec2 p = flat_[corner[0]], q = flat_[corner[1]] - p, r = flat_[corner[2]] - p;
        const double area = q.x() * r.y() - q.y() * r.x();
        if (!(area > 1e-9)) return;
        const Vec2 lower = p + Vec2::Zero().cwiseMin(q).cwiseMin(r), upper = p + Vec2::Zero().cwiseMax(q).cwiseMax(r);
        const int x0 = std::max(-reach_, static_cast<int>(std::ceil(lower.x())));
        const int x1 = std::min(reach_, static_cast<int>(std::floor(upper.x())));
        const int y0 = std::max(-reach_, static_cast<int>(std::ceil(lower.y())));
        const int y1 = std::min(reach_, static_cast<int>(std::floor(upper.y())));
        for (int y = y0; y <= y1; ++y)
          for (int x = x0; x <= x1; ++x) {
            char& filled = filled_[(y + reach_) * across + x + reach_];
            if (filled) continue;
            const Vec2 s = Vec2(x, y) - p;
            const double b = (s.x() * r.y() - s.y() * r.x()) / area, c = (q.x() * s.y() - q.y() * s.x()) / area;
            if (b < -1e-9 || c < -1e-9 || b + c > 1 + 1e-9) continue;
            filled = 1;
            Place place{x, y, {}, {static_cast<float>(1 - b - c), static_cast<float>(b), static_cast<float>(c)}, 0};
            for (int i = 0; i < 3; ++i) place.textons[i] = textons_.textons[textons_.layers.texel(place_[corner[i]])];
            for (int i = 0; i < 3; ++i)
              for (int j = 0; j < 3; ++j)
                place.squared_norm +=
                    place.weights[i] * place.weights[j] * products_(place.textons[i], place.textons[j]);
            neighbourhood_.push_back(place);
          }
      });
  }

  // ‖Σ w_i a_i − b‖² summed over the neighbourhood, left once above `bound`. Source: [Tong2002 §4].
  float distance_to(int x, int y, float bound) const {
    float sum = 0;
    for (const Place& place : neighbourhood_) {
      const std::int32_t b = textons_.textons[texel(x + place.x, y + place.y)];
      sum += place.squared_norm + products_(b, b);
      for (int i = 0; i < 3; ++i) sum -= 2 * place.weights[i] * products_(b, place.textons[i]);
      if (sum >= bound) break;
    }
    return sum;
  }

  void assign(std::int32_t v) {
    flatten_around(v);
    fill_neighbourhood(v);
    const Vec3 n = surface_.normals.row(v).transpose(), u = surface_.directions.row(v).transpose();
    float best_distance = 3e38f;
    bool found = false;
    seen_.clear();
    for (std::int32_t w : around_) {
      if (!assigned_[w] || flat_[w].norm() > ring_reach) continue;
      // From the place of `w` back to `v`, in the frame of `w`.
      const Vec3 wn = surface_.normals.row(w).transpose(), wu = surface_.directions.row(w).transpose();
      const Vec3 carried = carry_tangent(u, n, wn);
      const double angle = std::atan2(carried.dot(wn.cross(wu)), carried.dot(wu));
      const Vec2f back = -(Eigen::Rotation2Dd(angle) * flat_[w]).cast<float>();
      const std::int32_t own = textons_.layers.texel(place_[w]);
      const Vec2f fraction = place_[w].at - place_[w].at.array().floor().matrix();
      for (int k = -1; k < options_.coherence; ++k) {
        const std::int32_t from = k < 0 ? own : alike_[static_cast<std::size_t>(own) * options_.coherence + k];
        if (from < 0) continue;
        const Vec2f at = textons_.layers.wrap(
            0,
            Vec2f(static_cast<float>(from % layer_.width), static_cast<float>(from / layer_.width)) + fraction + back);
        const std::int32_t texel = textons_.layers.texel({0, at});
        if (std::find(seen_.begin(), seen_.end(), texel) != seen_.end()) continue;
        seen_.push_back(texel);
        ++comparisons_;
        const float distance = distance_to(texel % layer_.width, texel / layer_.width, best_distance);
        if (found && !(distance < best_distance)) continue;
        best_distance = distance;
        place_[v] = {0, at};
        found = true;
      }
    }
    if (found) return;
    RandomStream random(hash64(options_.seed, 54), static_cast<std::uint64_t>(v));
    const double x = random.next() * layer_.width, y = random.next() * layer_.height;
    place_[v] = {0, textons_.layers.wrap(0, Vec2f(static_cast<float>(x), static_cast<float>(y)))};
  }

  const TexturedSurface& surface_;
  const TextonSet& textons_;
  const SampleLayer& layer_;
  const TextonSweepOptions& options_;
  std::vector<LayerPlace>& place_;
  const int reach_;
  RowMatrixf products_;              // a_i·a_j of all textons
  std::vector<std::int32_t> alike_;  // k for each texel
  std::vector<char> assigned_, filled_;
  std::vector<std::int32_t> stamp_;  // the vertex around which a vertex was flattened last
  std::vector<Vec2> flat_;
  std::vector<std::int32_t> around_, seen_;
  std::vector<Place> neighbourhood_;
  long comparisons_ = 0;
};

}  // namespace

long sweep_textons(const TexturedSurface& surface, const TextonSet& textons, const TextonSweepOptions& options,
                   std::vector<LayerPlace>& place) {
  if (textons.layers.sample_count > 1) throw InputError("the sweep by textons takes one sample, not several");
  if (textons.layers.symmetry > 1)
    throw InputError("the sweep by textons lays the sample as it is; try sg-textons --symmetry 1");
  place.assign(surface.mesh.vertex_count(), {});
  return TextonSweep(surface, textons, options, place).run();
}

}  // namespace shellgrid
