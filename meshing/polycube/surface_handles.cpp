// SPDX-License-Identifier: AGPL-3.0-or-later
#include "meshing/polycube/surface_handles.h"

#include <algorithm>
#include <array>
#include <limits>
#include <numeric>
#include <queue>
#include <unordered_map>

namespace shellgrid {
namespace {

constexpr double infinity = std::numeric_limits<double>::infinity();

struct Loop {
  std::vector<int> points;
  double length = infinity;
};

// A closed surface that can be cut along loops.
class CutSurface {
 public:
  explicit CutSurface(const TriangleMesh& mesh) {
    for (int v = 0; v < mesh.vertex_count(); ++v) points_.push_back(mesh.vertex(v));
    for (int f = 0; f < mesh.face_count(); ++f)
      faces_.push_back({mesh.faces(f, 0), mesh.faces(f, 1), mesh.faces(f, 2)});
    index_edges();
  }

  const Vec3& point(int v) const { return points_[v]; }

  // The shortest of the loops that a tree of shortest paths from a root and its dual tree leave over.
  Loop shortest_loop(int root) const {
    std::vector<double> distance(points_.size(), infinity);
    std::vector<int> parent(points_.size(), -1);
    std::vector<std::vector<int>> next(points_.size());
    for (const auto& [key, face] : face_of_) next[key >> 32].push_back(static_cast<int>(key & 0xffffffffu));
    for (std::vector<int>& list : next) std::sort(list.begin(), list.end());
    using Entry = std::pair<double, int>;
    std::priority_queue<Entry, std::vector<Entry>, std::greater<>> queue;
    distance[root] = 0;
    queue.push({0, root});
    while (!queue.empty()) {
      const auto [far, v] = queue.top();
      queue.pop();
      if (far > distance[v]) continue;
      for (int n : next[v]) {
        const double d = far + (points_[n] - points_[v]).norm();
        if (d < distance[n]) distance[n] = d, parent[n] = v, queue.push({d, n});
      }
    }
    struct Edge {
      double length;
      int a, b;
    };
    std::vector<Edge> edges;
    for (int a = 0; a < static_cast<int>(next.size()); ++a)
      for (int b : next[a])
        if (a < b && parent[a] != b && parent[b] != a && distance[a] < infinity)
          edges.push_back({distance[a] + distance[b] + (points_[a] - points_[b]).norm(), a, b});
    std::stable_sort(edges.begin(), edges.end(), [](const Edge& a, const Edge& b) { return a.length > b.length; });
    std::vector<int> root_of(faces_.size());
    std::iota(root_of.begin(), root_of.end(), 0);
    const auto find = [&](int f) {
      while (root_of[f] != f) f = root_of[f] = root_of[root_of[f]];
      return f;
    };
    Loop best;
    for (const Edge& edge : edges) {
      const int f = find(face_of_.at(key_of(edge.a, edge.b))), g = find(face_of_.at(key_of(edge.b, edge.a)));
      if (f != g) {
        root_of[f] = g;
        continue;
      }
      Loop loop;
      std::vector<int> back;
      for (int v = edge.a; v >= 0; v = parent[v]) loop.points.push_back(v);
      for (int v = edge.b; v >= 0; v = parent[v]) back.push_back(v);
      while (loop.points.size() > 1 && back.size() > 1 && loop.points[loop.points.size() - 2] == back[back.size() - 2])
        loop.points.pop_back(), back.pop_back();
      loop.points.insert(loop.points.end(), back.rbegin() + 1, back.rend());
      loop.length = 0;
      for (std::size_t n = 0; n < loop.points.size(); ++n)
        loop.length += (points_[loop.points[n]] - points_[loop.points[(n + 1) % loop.points.size()]]).norm();
      if (loop.length < best.length) best = std::move(loop);
    }
    return best;
  }

  // Cuts along a loop and closes both rims with a fan; false where the surface is no manifold there.
  bool cut(const Loop& loop) {
    const int count = static_cast<int>(loop.points.size()), first_copy = static_cast<int>(points_.size());
    std::vector<std::pair<int, int>> left;  // face, place of the loop's point in it
    std::vector<int> copy;
    for (int n = 0; n < count; ++n) {
      const int v = loop.points[n], before = loop.points[(n + count - 1) % count];
      int to = loop.points[(n + 1) % count];
      for (int turn = 0; to != before; ++turn) {
        const auto found = face_of_.find(key_of(v, to));
        if (found == face_of_.end() || turn > 1000) return false;
        const std::array<int, 3>& face = faces_[found->second];
        const int place = static_cast<int>(std::find(face.begin(), face.end(), v) - face.begin());
        left.push_back({found->second, place});
        copy.push_back(first_copy + n);
        to = face[(place + 2) % 3];
      }
    }
    Vec3 centre = Vec3::Zero();
    for (int v : loop.points) centre += points_[v] / count;
    for (int v : loop.points) points_.push_back(Vec3(points_[v]));
    for (std::size_t n = 0; n < left.size(); ++n) faces_[left[n].first][left[n].second] = copy[n];
    const int tip = static_cast<int>(points_.size());
    points_.push_back(centre);
    points_.push_back(centre);
    for (int n = 0; n < count; ++n) {
      faces_.push_back({first_copy + (n + 1) % count, first_copy + n, tip});
      faces_.push_back({loop.points[n], loop.points[(n + 1) % count], tip + 1});
    }
    index_edges();
    return true;
  }

 private:
  static std::uint64_t key_of(int a, int b) {
    return static_cast<std::uint64_t>(static_cast<std::uint32_t>(a)) << 32 | static_cast<std::uint32_t>(b);
  }
  void index_edges() {
    face_of_.clear();
    for (std::size_t f = 0; f < faces_.size(); ++f)
      for (int k = 0; k < 3; ++k) face_of_[key_of(faces_[f][k], faces_[f][(k + 1) % 3])] = static_cast<int>(f);
  }

  std::vector<Vec3> points_;
  std::vector<std::array<int, 3>> faces_;
  std::unordered_map<std::uint64_t, int> face_of_;  // of directed edges
};

}  // namespace

std::vector<SurfaceHandle> find_handles(const TriangleMesh& surface, int most) {
  std::vector<SurfaceHandle> handles;
  if (surface.face_count() == 0) return handles;
  CutSurface cut(surface);
  for (int n = 0; n < most; ++n) {
    Loop loop = cut.shortest_loop(surface.faces(0, 0));
    if (loop.points.empty()) break;
    Loop again = cut.shortest_loop(loop.points[loop.points.size() / 2]);
    if (again.length < loop.length) loop = std::move(again);
    SurfaceHandle handle;
    handle.length = loop.length;
    for (int v : loop.points) handle.centre += cut.point(v) / static_cast<double>(loop.points.size());
    handles.push_back(handle);
    if (!cut.cut(loop)) break;
  }
  return handles;
}

}  // namespace shellgrid
