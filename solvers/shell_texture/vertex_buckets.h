// SPDX-License-Identifier: AGPL-3.0-or-later
// Vertices of a surface in pieces: near each other, and facing the same way.
#pragma once
#include <algorithm>
#include <cstdint>
#include <unordered_map>
#include <utility>
#include <vector>

#include "solvers/shell_texture/incident_light.h"

namespace shellgrid {

// A third of the faces about each vertex, mm².
std::vector<float> vertex_areas(const TriangleMesh& mesh);

// Of some vertices the one nearest to the middle of all.
int vertex_in_middle(const TriangleMesh& mesh, const std::vector<int>& members);

class VertexBuckets {
 public:
  struct Bucket {
    std::vector<int> members;     // ascending
    Vec3 middle = Vec3::Zero();   // of the area
    Vec3 facing = Vec3::Zero();   // area · normal
    double area = 0, radius = 0;  // of the members' places about the middle, mm
  };

  VertexBuckets() = default;
  // A bucket for each cube of that edge, mm, and side of a cube that the normals look at. areas: of the vertices.
  VertexBuckets(const TexturedFrames& frames, const std::vector<float>& areas, double edge);

  double edge() const { return edge_; }
  int count() const { return static_cast<int>(buckets_.size()); }
  const Bucket& operator[](int bucket) const { return buckets_[bucket]; }
  int of_vertex(int vertex) const { return of_vertex_[vertex]; }

  // Calls visit(bucket) for the buckets of all cubes that are at most `reach` cubes off that of the point, on each
  // axis.
  template <class Visit>
  void visit_about(const Vec3& point, int reach, const Visit& visit) const {
    const Vec3i cell = (point / edge_).array().floor().template cast<int>();
    for (int x = -reach; x <= reach; ++x)
      for (int y = -reach; y <= reach; ++y) visit_column(cell + Vec3i(x, y, 0), reach, visit);
  }

 private:
  static std::uint64_t key(const Vec3i& cell) {
    const auto part = [](int i) { return static_cast<std::uint64_t>(i + (1 << 20)) & 0x1fffff; };
    return part(cell.x()) << 42 | part(cell.y()) << 21 | part(cell.z());
  }
  template <class Visit>
  void visit_column(const Vec3i& cell, int reach, const Visit& visit) const {
    const std::uint64_t first = key(cell - Vec3i(0, 0, reach)), last = key(cell + Vec3i(0, 0, reach));
    const auto column = columns_.find(first >> 21);
    if (column == columns_.end()) return;
    const auto begin = cells_.begin() + column->second.first, end = cells_.begin() + column->second.second;
    for (auto at = std::lower_bound(begin, end, std::pair(first, 0)); at != end && at->first <= last; ++at)
      visit(at->second);
  }

  double edge_ = 1;
  std::vector<Bucket> buckets_;
  std::vector<int> of_vertex_;
  std::vector<std::pair<std::uint64_t, int>> cells_;                // sorted: cell and bucket
  std::unordered_map<std::uint64_t, std::pair<int, int>> columns_;  // of cells along z: which of them
};

}  // namespace shellgrid
