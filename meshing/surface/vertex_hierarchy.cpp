// SPDX-License-Identifier: AGPL-3.0-or-later
#include "meshing/surface/vertex_hierarchy.h"

#include <algorithm>
#include <cmath>
#include <queue>
#include <tuple>
#include <unordered_map>

#include "meshing/core/random.h"

namespace shellgrid {
namespace {

// Of `from`, a maximal subset with mutual distances of at least `radius` among vertices that face the same way.
std::vector<std::int32_t> thin_out(const TriangleMesh& mesh, const VertexMatrix& normals,
                                   const std::vector<std::int32_t>& from, double radius, std::uint64_t seed) {
  std::vector<std::pair<std::uint64_t, std::int32_t>> order;
  for (std::int32_t v : from) order.emplace_back(hash64(seed, static_cast<std::uint64_t>(v)), v);
  std::sort(order.begin(), order.end());
  const auto cell_of = [&](const Vec3& p) { return Vec3i((p / radius).array().floor().cast<int>()); };
  const auto key_of = [](const Vec3i& c) {
    return (static_cast<std::uint64_t>(c.x() + (1 << 20)) << 42) ^
           (static_cast<std::uint64_t>(c.y() + (1 << 20)) << 21) ^ static_cast<std::uint64_t>(c.z() + (1 << 20));
  };
  std::unordered_map<std::uint64_t, std::vector<std::int32_t>> cells;
  std::vector<std::int32_t> chosen;
  for (const auto& [hash, v] : order) {
    const Vec3 p = mesh.vertex(v);
    const Vec3i cell = cell_of(p);
    bool free = true;
    for (int i = 0; i < 27 && free; ++i) {
      const auto found = cells.find(key_of(cell + Vec3i(i % 3 - 1, i / 3 % 3 - 1, i / 9 - 1)));
      if (found == cells.end()) continue;
      for (std::int32_t other : found->second)
        if ((mesh.vertex(other) - p).squaredNorm() < radius * radius && normals.row(other).dot(normals.row(v)) > 0) {
          free = false;
          break;
        }
    }
    if (!free) continue;
    cells[key_of(cell)].push_back(v);
    chosen.push_back(v);
  }
  std::sort(chosen.begin(), chosen.end());
  return chosen;
}

// Labels every vertex with the nearest of `seeds` along edges.
std::vector<std::int32_t> nearest_along_edges(const TriangleMesh& mesh, const HalfEdges& half_edges,
                                              const std::vector<std::int32_t>& seeds) {
  std::vector<std::int32_t> label(mesh.vertex_count(), -1);
  std::vector<double> distance(mesh.vertex_count(), 1e300);
  using Entry = std::tuple<double, std::int32_t, std::int32_t>;  // distance, vertex, label
  std::priority_queue<Entry, std::vector<Entry>, std::greater<>> queue;
  for (std::int32_t seed : seeds) distance[seed] = 0, queue.emplace(0.0, seed, seed);
  while (!queue.empty()) {
    const auto [d, v, owner] = queue.top();
    queue.pop();
    if (label[v] >= 0) continue;
    label[v] = owner;
    const auto relax = [&](std::int32_t w) {
      const double length = d + (mesh.vertex(w) - mesh.vertex(v)).norm();
      if (label[w] < 0 && length < distance[w]) distance[w] = length, queue.emplace(length, w, owner);
    };
    half_edges.for_each_outgoing(v, [&](std::int32_t h) {
      relax(HalfEdges::to(mesh, h));
      relax(HalfEdges::from(mesh, HalfEdges::previous(h)));
    });
  }
  for (int v = 0; v < mesh.vertex_count(); ++v)
    if (label[v] < 0) label[v] = seeds.front();  // a vertex without faces
  return label;
}

}  // namespace

VertexHierarchy build_vertex_hierarchy(const TriangleMesh& mesh, const HalfEdges& half_edges,
                                       const VertexMatrix& normals, double spacing, int level_count,
                                       std::uint64_t seed) {
  VertexHierarchy hierarchy;
  hierarchy.levels.emplace_back();
  for (int v = 0; v < mesh.vertex_count(); ++v) {
    hierarchy.levels[0].vertices.push_back(v);
    hierarchy.levels[0].nearest.push_back(v);
  }
  for (int level = 1; level < level_count; ++level) {
    // A maximal set of points r apart holds about 0.70/r² of them, a triangular lattice of edge s 1.155/s².
    const double radius = 0.78 * std::ldexp(spacing, level);
    std::vector<std::int32_t> vertices =
        thin_out(mesh, normals, hierarchy.levels.back().vertices, radius, hash64(seed, 31, level));
    if (vertices.size() < 4 || vertices.size() == hierarchy.levels.back().vertices.size()) break;
    std::vector<std::int32_t> nearest = nearest_along_edges(mesh, half_edges, vertices);
    hierarchy.levels.push_back({std::move(vertices), std::move(nearest)});
  }
  return hierarchy;
}

}  // namespace shellgrid
