// SPDX-License-Identifier: AGPL-3.0-or-later
#include <Eigen/Cholesky>
#include <Eigen/Geometry>
#include <algorithm>
#include <cmath>
#include <queue>
#include <vector>

#include "meshing/core/error.h"
#include "meshing/polycube/tetrahedralize.h"
#include "meshing/surface/half_edges.h"

namespace shellgrid {
namespace {

// The squared distances to planes, summed: xᵀ a x + 2 bᵀ x + c.
struct Quadric {
  Mat3 a = Mat3::Zero();
  Vec3 b = Vec3::Zero();
  double c = 0;

  void add_plane(const Vec3& normal, const Vec3& point, double weight) {
    const double offset = -normal.dot(point);
    a += weight * normal * normal.transpose();
    b += weight * offset * normal;
    c += weight * offset * offset;
  }
  Quadric& operator+=(const Quadric& other) {
    a += other.a, b += other.b, c += other.c;
    return *this;
  }
  double at(const Vec3& x) const { return std::max(0.0, x.dot(a * x) + 2 * b.dot(x) + c); }
  // Where it is least; directions in which it hardly changes stay as at `near`.
  Vec3 least(const Vec3& near) const {
    const double scale = a.trace();
    if (!(scale > 0)) return near;
    const Mat3 damped = a + 1e-7 * scale * Mat3::Identity();
    return near - damped.ldlt().solve(a * near + b);
  }
};

// Collapses edges of a closed surface, the cheapest first.
class Simplifier {
 public:
  explicit Simplifier(const TriangleMesh& surface)
      : mesh_(surface), edges_(build_half_edges(surface)), faces_left_(surface.face_count()) {
    if (std::find(edges_.twin.begin(), edges_.twin.end(), -1) != edges_.twin.end())
      throw InputError("the surface is open; expected a closed surface; try sg-prepare");
    const int n = surface.vertex_count();
    quadrics_.resize(n);
    stamps_.assign(n, 0);
    marks_.assign(n, 0);
    removed_.assign(surface.face_count(), 0);
    // About its middle the sums keep their digits.
    centre_ = surface.vertices.colwise().mean().transpose();
    mesh_.vertices.rowwise() -= centre_.transpose();
    for (int f = 0; f < surface.face_count(); ++f) {
      const Vec3 normal = face_normal(f);
      const double area = normal.norm();
      if (!(area > 0)) continue;
      for (int k = 0; k < 3; ++k)
        quadrics_[mesh_.faces(f, k)].add_plane(normal / area, mesh_.vertex(mesh_.faces(f, 0)), area);
    }
  }

  TriangleMesh run(int faces) {
    for (std::int32_t h = 0; h < static_cast<std::int32_t>(edges_.twin.size()); ++h)
      if (h < edges_.twin[h]) offer(h);
    while (faces_left_ > std::max(faces, 4) && !queue_.empty()) {
      const Candidate next = queue_.top();
      queue_.pop();
      if (removed_[HalfEdges::face(next.edge)]) continue;
      const int from = HalfEdges::from(mesh_, next.edge), to = HalfEdges::to(mesh_, next.edge);
      if (stamps_[from] + stamps_[to] != next.stamp || !may_collapse(next.edge)) continue;
      collapse(next.edge);
    }
    return compact();
  }

 private:
  struct Candidate {
    double cost;
    std::int32_t edge;
    std::int64_t stamp;  // of its two ends when it was offered: they only grow
    bool operator<(const Candidate& other) const { return cost != other.cost ? cost > other.cost : edge > other.edge; }
  };

  Vec3 face_normal(int f) const {
    const Vec3 a = mesh_.vertex(mesh_.faces(f, 0));
    return (mesh_.vertex(mesh_.faces(f, 1)) - a).cross(mesh_.vertex(mesh_.faces(f, 2)) - a);
  }

  Vec3 place(int from, int to, Quadric& sum) const {
    sum = quadrics_[from];
    sum += quadrics_[to];
    const Vec3 a = mesh_.vertex(from), b = mesh_.vertex(to);
    const Vec3 middle = (a + b) / 2, best = sum.least(middle);
    // Far from the edge it would be a spike.
    return (best - middle).squaredNorm() <= (b - a).squaredNorm() ? best : middle;
  }

  void offer(std::int32_t h) {
    if (edges_.twin[h] < 0) return;
    const int from = HalfEdges::from(mesh_, h), to = HalfEdges::to(mesh_, h);
    Quadric sum;
    const Vec3 at = place(from, to, sum);
    // On flat ground the shortest edge goes first.
    const double cost = sum.at(at) + 1e-6 * sum.a.trace() * (mesh_.vertex(to) - mesh_.vertex(from)).squaredNorm();
    queue_.push({cost, h, static_cast<std::int64_t>(stamps_[from]) + stamps_[to]});
  }

  // No face around `vertex`, except those of the collapsing edge, may turn by more than 60° or lose its area.
  bool keeps_faces(int vertex, int other, const Vec3& at) const {
    bool kept = true;
    edges_.for_each_outgoing(vertex, [&](std::int32_t h) {
      const int b = HalfEdges::to(mesh_, h), c = HalfEdges::to(mesh_, HalfEdges::next(h));
      if (!kept || b == other || c == other) return;
      const Vec3 pb = mesh_.vertex(b), pc = mesh_.vertex(c);
      const Vec3 before = (pb - mesh_.vertex(vertex)).cross(pc - mesh_.vertex(vertex));
      const Vec3 after = (pb - at).cross(pc - at);
      const double longest = std::max({(pb - at).squaredNorm(), (pc - at).squaredNorm(), (pc - pb).squaredNorm()});
      kept = after.dot(before) > 0.5 * after.norm() * before.norm() && after.norm() > 1e-3 * longest;
    });
    return kept;
  }

  // Its ends have two neighbours in common, the corners opposite it, and these keep three neighbours.
  bool may_collapse(std::int32_t h) {
    const std::int32_t back = edges_.twin[h];
    if (back < 0) return false;
    const int from = HalfEdges::from(mesh_, h), to = HalfEdges::to(mesh_, h);
    ++mark_;
    edges_.for_each_outgoing(from, [&](std::int32_t e) { marks_[HalfEdges::to(mesh_, e)] = mark_; });
    int shared = 0;
    edges_.for_each_outgoing(to, [&](std::int32_t e) { shared += marks_[HalfEdges::to(mesh_, e)] == mark_; });
    if (shared != 2) return false;
    for (const std::int32_t side : {h, back}) {
      int valence = 0;
      edges_.for_each_outgoing(HalfEdges::to(mesh_, HalfEdges::next(side)), [&](std::int32_t) { ++valence; });
      if (valence <= 3) return false;
    }
    Quadric sum;
    const Vec3 at = place(from, to, sum);
    return keeps_faces(from, to, at) && keeps_faces(to, from, at);
  }

  void collapse(std::int32_t h) {
    const int from = HalfEdges::from(mesh_, h), to = HalfEdges::to(mesh_, h);
    Quadric sum;
    mesh_.vertices.row(from) = place(from, to, sum).transpose();
    quadrics_[from] = sum;
    around_.clear();
    edges_.for_each_outgoing(to, [&](std::int32_t e) { around_.push_back(e); });
    for (const std::int32_t e : around_) mesh_.faces(e / 3, e % 3) = from;
    for (const std::int32_t side : {h, edges_.twin[h]}) {
      // The two other sides of the vanishing face become one edge.
      const std::int32_t one = edges_.twin[HalfEdges::next(side)], two = edges_.twin[HalfEdges::previous(side)];
      edges_.twin[one] = two;
      edges_.twin[two] = one;
      edges_.outgoing[HalfEdges::from(mesh_, one)] = one;
      edges_.outgoing[HalfEdges::from(mesh_, two)] = two;
      removed_[HalfEdges::face(side)] = 1;
    }
    faces_left_ -= 2;
    stamps_[from] = std::max(stamps_[from], stamps_[to]) + 1;
    edges_.for_each_outgoing(from, [&](std::int32_t e) { offer(e); });
  }

  TriangleMesh compact() const {
    std::vector<std::int32_t> index(mesh_.vertex_count(), -1);
    TriangleMesh result;
    result.faces.resize(faces_left_, 3);
    Eigen::Index face = 0;
    for (int f = 0; f < mesh_.face_count(); ++f)
      if (!removed_[f]) {
        for (int k = 0; k < 3; ++k) index[mesh_.faces(f, k)] = 0;
        result.faces.row(face++) = mesh_.faces.row(f);
      }
    std::int32_t count = 0;
    for (std::int32_t& i : index)
      if (i == 0) i = count++;
    result.vertices.resize(count, 3);
    for (int v = 0; v < mesh_.vertex_count(); ++v)
      if (index[v] >= 0) result.vertices.row(index[v]) = mesh_.vertices.row(v) + centre_.transpose();
    for (std::int32_t* corner = result.faces.data(); corner != result.faces.data() + result.faces.size(); ++corner)
      *corner = index[*corner];
    return result;
  }

  TriangleMesh mesh_;
  HalfEdges edges_;
  int faces_left_;
  Vec3 centre_;
  std::vector<Quadric> quadrics_;
  std::vector<std::int32_t> stamps_, marks_;
  std::int32_t mark_ = 0;
  std::vector<char> removed_;
  std::vector<std::int32_t> around_;
  std::priority_queue<Candidate> queue_;
};

}  // namespace

TriangleMesh simplify_surface(const TriangleMesh& surface, int faces) { return Simplifier(surface).run(faces); }

}  // namespace shellgrid
