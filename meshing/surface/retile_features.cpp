// SPDX-License-Identifier: AGPL-3.0-or-later
#include <algorithm>
#include <array>
#include <cmath>
#include <map>
#include <numbers>

#include "meshing/core/parallel.h"
#include "meshing/surface/retiling.h"

namespace shellgrid {
namespace {

// Sharp edges as a graph: chains of edges that meet in vertices.
class CreaseGraph {
 public:
  struct Edge {
    int a, b;
    double length;
    bool kept = true;
  };

  CreaseGraph(std::vector<Edge> edges, int vertex_count) : edges_(std::move(edges)), at_(vertex_count) {
    for (std::size_t e = 0; e < edges_.size(); ++e)
      for (const int v : {edges_[e].a, edges_[e].b}) at_[v].push_back(static_cast<int>(e));
  }

  // Drops branches that end freely and are shorter than `branch`, then connected parts shorter than `part`.
  void prune(double branch, double part) {
    std::vector<int> path;
    for (std::size_t v = 0; v < at_.size(); ++v) {
      if (degree(static_cast<int>(v)) != 1) continue;
      double length = 0;
      path.clear();
      int at = static_cast<int>(v), last = -1;
      do {
        last = next_edge(at, last);
        path.push_back(last);
        length += edges_[last].length;
        at = other(last, at);
      } while (degree(at) == 2);
      if (length < branch)
        for (const int e : path) edges_[e].kept = false;
    }
    std::vector<char> seen(edges_.size(), 0);
    for (std::size_t first = 0; first < edges_.size(); ++first) {
      if (seen[first] || !edges_[first].kept) continue;
      path.assign(1, static_cast<int>(first));
      seen[first] = 1;
      double length = 0;
      for (std::size_t i = 0; i < path.size(); ++i) {
        length += edges_[path[i]].length;
        for (const int v : {edges_[path[i]].a, edges_[path[i]].b})
          for (const int e : at_[v])
            if (edges_[e].kept && !seen[e]) seen[e] = 1, path.push_back(e);
      }
      if (length < part)
        for (const int e : path) edges_[e].kept = false;
    }
  }

  // Drops edges where the network is denser than edges of the spacing can follow: where more than 7.5 spacings of it
  // lie within 1.5 of an edge's middle. (A line has 3 there, a corner of a box 4.5, two lines side by side 6.)
  void thin_out(const VertexMatrix& vertices, double spacing) {
    const double step = 0.25 * spacing;
    std::vector<Vec3> samples;
    double carry = 0;
    for (const Edge& edge : edges_) {
      if (!edge.kept) continue;
      const Vec3 a = vertices.row(edge.a).transpose(), b = vertices.row(edge.b).transpose();
      double at = step - carry;
      for (; at <= edge.length; at += step) samples.push_back(a + at / edge.length * (b - a));
      carry = edge.length - (at - step);
    }
    if (samples.empty()) return;
    VertexMatrix points(static_cast<Eigen::Index>(samples.size()), 3);
    for (std::size_t i = 0; i < samples.size(); ++i) points.row(static_cast<Eigen::Index>(i)) = samples[i].transpose();
    const NearestVertexQuery query(points);
    parallel_for(edges_.size(), [&](std::size_t e) {
      if (!edges_[e].kept) return;
      const Vec3 middle = 0.5 * (vertices.row(edges_[e].a) + vertices.row(edges_[e].b)).transpose();
      if (query.count_within(middle, 1.5 * spacing, 31) > 30) edges_[e].kept = false;
    });
  }

  const std::vector<Edge>& edges() const { return edges_; }

  std::vector<int> neighbours(int v) const {
    std::vector<int> result;
    for (const int e : at_[v])
      if (edges_[e].kept) result.push_back(other(e, v));
    return result;
  }

 private:
  int other(int e, int v) const { return edges_[e].a == v ? edges_[e].b : edges_[e].a; }
  int degree(int v) const {
    return static_cast<int>(std::count_if(at_[v].begin(), at_[v].end(), [&](int e) { return edges_[e].kept; }));
  }
  int next_edge(int v, int last) const {
    for (const int e : at_[v])
      if (edges_[e].kept && e != last) return e;
    return last;
  }

  std::vector<Edge> edges_;
  std::vector<std::vector<int>> at_;
};

}  // namespace

void Retiling::find_features() {
  const double limit = std::cos(options_.feature_angle * std::numbers::pi / 180);
  std::vector<CreaseGraph::Edge> sharp;
  std::vector<EdgeHandle> handles;
  for (std::size_t i = 0; i < mesh_.n_edges(); ++i) {
    const EdgeHandle e(static_cast<int>(i));
    const HalfedgeHandle h = mesh_.halfedge_handle(e, 0);
    const int f = mesh_.face_handle(h).idx(), g = mesh_.opposite_face_handle(h).idx();
    if (!(face_normals_[f].dot(face_normals_[g]) < limit)) continue;
    sharp.push_back({mesh_.from_vertex_handle(h).idx(), mesh_.to_vertex_handle(h).idx(), std::sqrt(squared_length(e))});
    handles.push_back(e);
  }
  CreaseGraph graph(std::move(sharp), static_cast<int>(mesh_.n_vertices()));
  graph.prune(3 * options_.spacing, 6 * options_.spacing);
  graph.thin_out(input_.vertices, options_.spacing);
  graph.prune(3 * options_.spacing, 6 * options_.spacing);

  // Segments as triangles without area.
  TriangleMesh segments;
  segments.vertices = input_.vertices;
  std::vector<Eigen::Vector3i> kept;
  for (std::size_t i = 0; i < handles.size(); ++i) {
    const CreaseGraph::Edge& edge = graph.edges()[i];
    if (!edge.kept) continue;
    mesh_.status(handles[i]).set_feature(true);
    kept.emplace_back(edge.a, edge.b, edge.b);
  }
  if (kept.empty()) return;
  segments.faces.resize(static_cast<Eigen::Index>(kept.size()), 3);
  for (std::size_t i = 0; i < kept.size(); ++i) segments.faces.row(static_cast<Eigen::Index>(i)) = kept[i].transpose();
  features_ = ClosestPointQuery(segments);

  // Corners: the sharpest first, as near to each other as the spacing lets them be told apart.
  struct Corner {
    double sharpness;
    int vertex;
  };
  std::vector<Corner> corners;
  for (std::size_t v = 0; v < mesh_.n_vertices(); ++v) {
    const std::vector<int> neighbours = graph.neighbours(static_cast<int>(v));
    if (neighbours.empty()) continue;
    const VertexHandle handle(static_cast<int>(v));
    mesh_.status(handle).set_feature(true);
    if (neighbours.size() != 2) {
      corners.push_back({static_cast<double>(neighbours.size()) + 2, static_cast<int>(v)});
      continue;
    }
    const Vec3 p = position(handle);
    const Vec3 in = (p - position(neighbours[0])).normalized(), out = (position(neighbours[1]) - p).normalized();
    if (in.dot(out) < std::cos(std::numbers::pi / 4)) corners.push_back({1 - in.dot(out), static_cast<int>(v)});
  }
  std::stable_sort(corners.begin(), corners.end(),
                   [](const Corner& a, const Corner& b) { return a.sharpness > b.sharpness; });
  const double apart = 0.5 * options_.spacing;
  const auto cell_of = [&](const Vec3& p) -> Vec3i { return (p / apart).array().floor().cast<int>(); };
  std::map<std::array<int, 3>, std::vector<int>> locked;  // by cell
  for (const Corner& corner : corners) {
    const Vec3 p = position(corner.vertex);
    const Vec3i cell = cell_of(p);
    bool free = true;
    for (int n = 0; n < 27 && free; ++n) {
      const auto found = locked.find({cell.x() + n / 9 - 1, cell.y() + n / 3 % 3 - 1, cell.z() + n % 3 - 1});
      if (found == locked.end()) continue;
      for (const int v : found->second) free &= (position(v) - p).norm() >= apart;
    }
    if (!free) continue;
    locked[{cell.x(), cell.y(), cell.z()}].push_back(corner.vertex);
    mesh_.status(VertexHandle(corner.vertex)).set_locked(true);
  }
}

void Retiling::find_tips() {
  for (std::size_t i = 0; i < mesh_.n_vertices(); ++i) {
    const VertexHandle v(static_cast<int>(i));
    double angle = 0, length = 0;
    int count = 0;
    for (const HalfedgeHandle out : mesh_.voh_range(v)) {
      const Vec3 p = position(mesh_.to_vertex_handle(out)) - position(v);
      const Vec3 q = position(mesh_.to_vertex_handle(mesh_.next_halfedge_handle(out))) - position(v);
      angle += std::atan2(p.cross(q).norm(), p.dot(q));
      length += p.norm();
      ++count;
    }
    if (2 * std::numbers::pi - angle > 0.3 && length > 3 * options_.spacing * count) mesh_.status(v).set_locked(true);
  }
}

}  // namespace shellgrid
