// SPDX-License-Identifier: AGPL-3.0-or-later
// Closed loops on a closed mesh, as bands of vertices: geodesic circles, and loops that no surface within spans.
#pragma once
#include <algorithm>
#include <queue>
#include <utility>
#include <vector>

#include "meshing/surface/half_edges.h"

namespace shellgrid::testing {

struct EdgeDistances {
  std::vector<double> length;        // n: along edges to the nearest source
  std::vector<std::int32_t> before;  // n: the half-edge that leads here, -1 at sources
};

inline EdgeDistances edge_distances(const TriangleMesh& mesh, const HalfEdges& half_edges,
                                    const std::vector<int>& sources, double reach = 1e300) {
  EdgeDistances result{std::vector<double>(mesh.vertex_count(), 1e300),
                       std::vector<std::int32_t>(mesh.vertex_count(), -1)};
  using Entry = std::pair<double, int>;
  std::priority_queue<Entry, std::vector<Entry>, std::greater<>> queue;
  for (int v : sources) result.length[v] = 0, queue.emplace(0.0, v);
  while (!queue.empty()) {
    const auto [d, v] = queue.top();
    queue.pop();
    if (d > result.length[v]) continue;
    half_edges.for_each_outgoing(v, [&](std::int32_t h) {
      const int w = HalfEdges::to(mesh, h);
      const double length = d + (mesh.vertex(w) - mesh.vertex(v)).norm();
      if (length < result.length[w] && length <= reach)
        result.length[w] = length, result.before[w] = h, queue.emplace(length, w);
    });
  }
  return result;
}

// Vertices whose way to `centre` differs from `radius` by less than half a `width`; empty where the surface ends
// before.
inline std::vector<int> geodesic_circle(const TriangleMesh& mesh, const HalfEdges& half_edges, int centre,
                                        double radius, double width) {
  const EdgeDistances distances = edge_distances(mesh, half_edges, {centre}, radius + width);
  std::vector<int> band;
  for (int v = 0; v < mesh.vertex_count(); ++v)
    if (std::abs(distances.length[v] - radius) < width / 2) band.push_back(v);
  return band;
}

// 2g loops that together go around every handle of a surface of genus g, each as the band of vertices within half a
// `width`: the ends of an edge, joined through a tree of shortest ways, for the edges that neither this tree nor one
// of faces across all others needs. Source: [Eppstein2003].
inline std::vector<std::vector<int>> handle_loops(const TriangleMesh& mesh, const HalfEdges& half_edges, int root,
                                                  double width) {
  const EdgeDistances ways = edge_distances(mesh, half_edges, {root});
  const std::size_t edges = half_edges.twin.size();
  std::vector<char> used(edges, 0);
  for (std::int32_t h : ways.before)
    if (h >= 0) used[h] = used[half_edges.twin[h]] = 1;
  std::vector<char> reached(mesh.face_count(), 0);
  std::vector<int> faces = {0};
  reached[0] = 1;
  for (std::size_t next = 0; next < faces.size(); ++next)
    for (int k = 0; k < 3; ++k) {
      const std::int32_t h = 3 * faces[next] + k, twin = half_edges.twin[h];
      if (used[h] || reached[HalfEdges::face(twin)]) continue;
      used[h] = used[twin] = 1;
      reached[HalfEdges::face(twin)] = 1;
      faces.push_back(HalfEdges::face(twin));
    }
  std::vector<std::vector<int>> loops;
  for (std::int32_t h = 0; h < static_cast<std::int32_t>(edges); ++h) {
    if (used[h] || h > half_edges.twin[h]) continue;
    const auto way_of = [&](int v) {
      std::vector<int> way = {v};
      while (ways.before[v] >= 0) way.push_back(v = HalfEdges::from(mesh, ways.before[v]));
      return way;
    };
    std::vector<int> first = way_of(HalfEdges::from(mesh, h)), second = way_of(HalfEdges::to(mesh, h));
    while (first.size() > 1 && second.size() > 1 && first[first.size() - 2] == second[second.size() - 2])
      first.pop_back(), second.pop_back();
    first.insert(first.end(), second.begin(), second.end());
    const EdgeDistances distances = edge_distances(mesh, half_edges, first, width);
    loops.emplace_back();
    for (int v = 0; v < mesh.vertex_count(); ++v)
      if (distances.length[v] < width / 2) loops.back().push_back(v);
  }
  return loops;
}

}  // namespace shellgrid::testing
