// SPDX-License-Identifier: AGPL-3.0-or-later
#include "solvers/shell_texture/shared_visibility.h"

#include <Eigen/Geometry>
#include <algorithm>
#include <cmath>
#include <limits>
#include <utility>

#include "solvers/shell_texture/shadow_rays.h"

namespace shellgrid {

namespace {

constexpr double vertices_a_cell = 16;
constexpr int least_agreeing = 2;  // cells that are above whose horizon the light is

}  // namespace

SharedVisibility::SharedVisibility(const TexturedFrames& frames, const SceneGeometry& geometry,
                                   std::vector<Vec3> lights)
    : frames_(frames), geometry_(geometry), lights_(std::move(lights)) {
  const std::vector<float> areas = vertex_areas(frames.mesh);
  double area = 0;
  for (const float one : areas) area += static_cast<double>(one);
  if (lights_.empty() || !(area > 0)) return;
  VertexBuckets cells(frames, areas, std::sqrt(vertices_a_cell * area / static_cast<double>(areas.size())));
  if (static_cast<std::size_t>(cells.count()) * 4 > areas.size()) return;
  cells_ = std::move(cells);
  const auto count = static_cast<std::size_t>(cells_.count());
  samples_.resize(count);
  agreed_.resize(count);
}

const SharedVisibility::Sample& SharedVisibility::sample(int cell) const {
  return samples_.get(cell, [&] {
    const int vertex = vertex_in_middle(frames_.mesh, cells_[cell].members);
    const Vec3 normal = frames_.normals.row(vertex).transpose();
    const Vec3 origin = frames_.mesh.vertex(vertex) + geometry_.offset() * normal;
    Sample made;
    made.seen.assign((lights_.size() + 63) / 64, 0);
    made.hidden = made.seen;
    ShadowRays rays(geometry_, origin);
    const auto put = [](std::vector<std::uint64_t>& bits, int light) {
      bits[static_cast<std::size_t>(light) / 64] |= std::uint64_t{1} << (light % 64);
    };
    const auto unhide = [&](int light) { put(made.seen, light); };
    for (int i = 0; i < static_cast<int>(lights_.size()); ++i) {
      if (!(lights_[i].dot(normal) > 0)) continue;
      put(made.hidden, i);
      rays.ask(i, lights_[i], std::numeric_limits<double>::infinity(), unhide);
    }
    rays.finish(unhide);
    for (std::size_t word = 0; word < made.seen.size(); ++word) made.hidden[word] &= ~made.seen[word];
    shadow_rays_ += rays.traced();
    return made;
  });
}

const SharedVisibility::Agreed* SharedVisibility::about(int vertex) const {
  if (cells_.count() == 0) return nullptr;
  const int own = cells_.of_vertex(vertex);
  return &agreed_.get(own, [&] {
    const VertexBuckets::Bucket& bucket = cells_[own];
    std::vector<const Sample*> samples;
    cells_.visit_about(bucket.middle, 1, [&](int other) {
      if (cells_[other].facing.dot(bucket.facing) > 0) samples.push_back(&sample(other));
    });
    Agreed made;
    for (std::size_t word = 0; word < (lights_.size() + 63) / 64; ++word) {
      // Of each light whether one saw it, two did; the same of those from which it is hidden.
      static_assert(least_agreeing == 2);
      std::uint64_t seen = 0, seen_twice = 0, hidden = 0, hidden_twice = 0;
      for (const Sample* one : samples) {
        seen_twice |= seen & one->seen[word];
        seen |= one->seen[word];
        hidden_twice |= hidden & one->hidden[word];
        hidden |= one->hidden[word];
      }
      made.seen_words.push_back(seen_twice & ~hidden);
      made.known_words.push_back(made.seen_words.back() | (hidden_twice & ~seen));
    }
    return made;
  });
}

}  // namespace shellgrid
