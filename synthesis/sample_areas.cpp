// SPDX-License-Identifier: AGPL-3.0-or-later
#include "synthesis/sample_areas.h"

#include <algorithm>
#include <queue>

namespace shellgrid {
namespace {

// Of the way from an area's border to its middle, how much another sample may take.
constexpr double yielding_share = 0.7;
constexpr double far_away = 1e300;

template <class Visit>
void for_each_neighbour(const TexturedSurface& surface, std::int32_t v, const Visit& visit) {
  surface.half_edges.for_each_outgoing(v, [&](std::int32_t h) {
    visit(HalfEdges::to(surface.mesh, h));
    visit(HalfEdges::from(surface.mesh, HalfEdges::previous(h)));
  });
}

// Lengths along edges to the nearest vertex that wants the sample, none beyond `reach`.
std::vector<double> distances_to(const TexturedSurface& surface, const std::vector<std::int32_t>& wanted, int sample,
                                 double reach) {
  const TriangleMesh& mesh = surface.mesh;
  std::vector<double> distance(wanted.size(), far_away);
  using Entry = std::pair<double, std::int32_t>;
  std::priority_queue<Entry, std::vector<Entry>, std::greater<>> queue;
  for (std::size_t v = 0; v < wanted.size(); ++v)
    if (wanted[v] == sample) distance[v] = 0, queue.emplace(0.0, static_cast<std::int32_t>(v));
  while (!queue.empty()) {
    const auto [d, v] = queue.top();
    queue.pop();
    if (d > distance[v]) continue;
    for_each_neighbour(surface, v, [&](std::int32_t w) {
      const double length = d + (mesh.vertex(w) - mesh.vertex(v)).norm();
      if (length <= reach && length < distance[w]) distance[w] = length, queue.emplace(length, w);
    });
  }
  return distance;
}

std::vector<PaintedArea> find_areas(const TexturedSurface& surface, const std::vector<std::int32_t>& wanted) {
  std::vector<double> share(wanted.size(), 0.0);
  for (int f = 0; f < surface.mesh.face_count(); ++f) {
    const Vec3 a = surface.mesh.vertex(surface.mesh.faces(f, 0));
    const Vec3 u = surface.mesh.vertex(surface.mesh.faces(f, 1)) - a,
               v = surface.mesh.vertex(surface.mesh.faces(f, 2)) - a;
    const double third = std::sqrt(std::max(0.0, u.squaredNorm() * v.squaredNorm() - u.dot(v) * u.dot(v))) / 6;
    for (int k = 0; k < 3; ++k) share[surface.mesh.faces(f, k)] += third;
  }
  std::vector<PaintedArea> areas;
  std::vector<char> found(wanted.size(), 0);
  for (std::size_t start = 0; start < wanted.size(); ++start) {
    if (found[start]) continue;
    found[start] = 1;
    PaintedArea area{wanted[start], {static_cast<std::int32_t>(start)}, 0, 0};
    for (std::size_t next = 0; next < area.vertices.size(); ++next) {
      const std::int32_t v = area.vertices[next];
      area.surface += share[v];
      for_each_neighbour(surface, v, [&](std::int32_t w) {
        if (!found[w] && wanted[w] == area.sample) found[w] = 1, area.vertices.push_back(w);
      });
    }
    areas.push_back(std::move(area));
  }
  return areas;
}

}  // namespace

SampleAreas::SampleAreas(const TexturedSurface& surface, const std::vector<std::int32_t>& wanted, int sample_count,
                         double blend_width, double blend_cost)
    : sample_count_(sample_count), price_(wanted.size() * sample_count, never), areas_(find_areas(surface, wanted)) {
  std::vector<std::vector<double>> distance;
  for (int s = 0; s < sample_count; ++s)
    distance.push_back(distances_to(surface, wanted, s, blend_width / yielding_share));
  for (PaintedArea& area : areas_) {
    for (std::int32_t v : area.vertices) {
      double nearest = far_away;
      for (int s = 0; s < sample_count; ++s)
        if (s != area.sample) nearest = std::min(nearest, distance[s][v]);
      area.depth = std::max(area.depth, nearest);
    }
    const double width = std::min(blend_width, yielding_share * area.depth);
    for (std::int32_t v : area.vertices)
      for (int s = 0; s < sample_count; ++s) {
        const double d = distance[s][v];
        if (d > width && s != area.sample) continue;
        const double far = s == area.sample || !(width > 0) ? 0 : d / width;
        price_[static_cast<std::size_t>(v) * sample_count + s] = static_cast<float>(blend_cost * far * far);
      }
  }
}

}  // namespace shellgrid
