// SPDX-License-Identifier: AGPL-3.0-or-later
#include "meshing/surface/mesh_topology.h"

#include <Eigen/Geometry>
#include <algorithm>
#include <numeric>
#include <vector>

namespace shellgrid {
namespace {

// Disjoint sets of vertices.
class Sets {
 public:
  explicit Sets(int count) : parent_(static_cast<std::size_t>(count)) { std::iota(parent_.begin(), parent_.end(), 0); }
  int root(int item) {
    while (parent_[static_cast<std::size_t>(item)] != item) {
      int& parent = parent_[static_cast<std::size_t>(item)];
      parent = parent_[static_cast<std::size_t>(parent)];
      item = parent;
    }
    return item;
  }
  void join(int a, int b) { parent_[static_cast<std::size_t>(root(a))] = root(b); }

 private:
  std::vector<int> parent_;
};

struct HalfEdge {
  std::int32_t low, high;
  bool runs_up;
  bool operator<(const HalfEdge& other) const {
    return low != other.low ? low < other.low : high != other.high ? high < other.high : runs_up < other.runs_up;
  }
};

}  // namespace

MeshTopology measure_topology(const TriangleMesh& mesh) {
  MeshTopology topology;
  std::vector<HalfEdge> half_edges;
  half_edges.reserve(3 * static_cast<std::size_t>(mesh.face_count()));
  std::vector<char> used(static_cast<std::size_t>(mesh.vertex_count()), 0);
  Sets sets(mesh.vertex_count());
  // Relative to a corner of the mesh, so that a distant origin costs no digits.
  const Vec3 origin = mesh.vertex_count() > 0 ? mesh.vertex(0) : Vec3::Zero();
  for (int f = 0; f < mesh.face_count(); ++f) {
    const Vec3 a = mesh.corner(f, 0) - origin, b = mesh.corner(f, 1) - origin, c = mesh.corner(f, 2) - origin;
    const double doubled_area = (b - a).cross(c - a).norm();
    topology.area += doubled_area / 2;
    topology.volume += a.dot(b.cross(c)) / 6;
    const int i = mesh.faces(f, 0), j = mesh.faces(f, 1), k = mesh.faces(f, 2);
    if (i == j || j == k || k == i || doubled_area == 0) ++topology.degenerate_faces;
    for (const auto& [from, to] : {std::pair(i, j), std::pair(j, k), std::pair(k, i)}) {
      used[static_cast<std::size_t>(from)] = 1;
      sets.join(from, to);
      if (from != to) half_edges.push_back({std::min(from, to), std::max(from, to), from < to});
    }
  }
  std::sort(half_edges.begin(), half_edges.end());
  for (std::size_t first = 0; first < half_edges.size();) {
    std::size_t end = first;
    int up = 0;
    for (; end < half_edges.size() && half_edges[end].low == half_edges[first].low &&
           half_edges[end].high == half_edges[first].high;
         ++end)
      up += half_edges[end].runs_up;
    const std::size_t faces = end - first;
    ++topology.edges;
    if (faces == 1) ++topology.boundary_edges;
    if (faces > 2) ++topology.non_manifold_edges;
    if (faces == 2 && up != 1) ++topology.misoriented_edges;
    first = end;
  }
  std::int64_t vertices = 0;
  for (int v = 0; v < mesh.vertex_count(); ++v) {
    if (!used[static_cast<std::size_t>(v)]) {
      ++topology.isolated_vertices;
      continue;
    }
    ++vertices;
    if (sets.root(v) == v) ++topology.components;
  }
  topology.euler_characteristic = vertices - topology.edges + mesh.face_count();
  return topology;
}

}  // namespace shellgrid
