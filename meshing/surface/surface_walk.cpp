// SPDX-License-Identifier: AGPL-3.0-or-later
#include "meshing/surface/surface_walk.h"

#include <Eigen/Geometry>
#include <algorithm>
#include <cmath>

namespace shellgrid {
namespace {

// The outgoing half-edge whose face, projected to the tangent plane, holds the direction; −1 if none does.
std::int32_t first_half_edge(const TriangleMesh& mesh, const HalfEdges& half_edges, int vertex, const Vec3& normal,
                             const Vec3& direction) {
  const Vec3 origin = mesh.vertex(vertex);
  const Vec3 side = normal.cross(direction);
  std::int32_t found = -1;
  double best = -2;
  half_edges.for_each_outgoing(vertex, [&](std::int32_t h) {
    const Vec3 right = mesh.vertex(HalfEdges::to(mesh, h)) - origin;
    const Vec3 left = mesh.vertex(HalfEdges::from(mesh, HalfEdges::previous(h))) - origin;
    const double right_side = right.dot(side), left_side = left.dot(side);
    if (right_side > 0 || left_side < 0 || right_side == left_side) return;
    // Where the direction's line crosses the opposite edge, ahead or behind.
    const double t = right_side / (right_side - left_side);
    const Vec3 crossing = right + t * (left - right);
    const double ahead = crossing.dot(direction) / std::max(crossing.norm(), 1e-300);
    if (ahead > 0 && ahead > best) best = ahead, found = h;
  });
  return found;
}

}  // namespace

SurfaceWalkEnd walk_from_vertex(const TriangleMesh& mesh, const HalfEdges& half_edges, int vertex, const Vec3& normal,
                                const Vec3& direction, double length) {
  SurfaceWalkEnd point;
  std::int32_t entry = first_half_edge(mesh, half_edges, vertex, normal, direction);
  if (entry < 0) return point;
  const auto face_normal = [&](std::int32_t face) {
    const Vec3 n = (mesh.corner(face, 1) - mesh.corner(face, 0)).cross(mesh.corner(face, 2) - mesh.corner(face, 0));
    const double norm = n.norm();
    return norm > 0 ? Vec3(n / norm) : Vec3(Vec3::Zero());
  };
  Vec3 position = mesh.vertex(vertex);
  Vec3 n = face_normal(HalfEdges::face(entry));
  Vec3 d = direction - n * n.dot(direction);
  if (!(d.norm() > 1e-12)) return point;
  d.normalize();
  // The first face is left through the edge opposite to the vertex, later ones through one of two.
  std::int32_t candidates[2] = {HalfEdges::next(entry), -1};
  for (int step = 0; step < 100000; ++step) {
    const Vec3 side = n.cross(d);
    std::int32_t exit = candidates[0];
    if (candidates[1] >= 0) {
      // The corner between the two candidate edges decides.
      const Vec3 apex = mesh.vertex(HalfEdges::to(mesh, candidates[0]));
      if ((apex - position).dot(side) < 0) exit = candidates[1];
    }
    const Vec3 a = mesh.vertex(HalfEdges::from(mesh, exit)), b = mesh.vertex(HalfEdges::to(mesh, exit));
    const double side_a = (a - position).dot(side), side_b = (b - position).dot(side);
    double t = side_a == side_b ? 0.5 : side_a / (side_a - side_b);
    t = std::min(1.0, std::max(0.0, t));
    const Vec3 crossing = a + t * (b - a);
    const double advance = std::max(0.0, (crossing - position).dot(d));
    if (advance >= length) {
      point.face = HalfEdges::face(exit);
      point.position = position + length * d;
      point.direction = d;
      point.normal = n;
      return point;
    }
    length -= advance;
    position = crossing;
    const std::int32_t twin = half_edges.twin[exit];
    if (twin < 0) return point;
    // Unfolding keeps the components along the shared edge and across it.
    const Vec3 next_normal = face_normal(HalfEdges::face(twin));
    const double edge_length = (b - a).norm();
    if (!(edge_length > 0) || next_normal.isZero()) return point;
    const Vec3 edge = (b - a) / edge_length;
    d = edge * d.dot(edge) + next_normal.cross(edge) * d.dot(n.cross(edge));
    d.normalize();
    n = next_normal;
    candidates[0] = HalfEdges::next(twin);
    candidates[1] = HalfEdges::previous(twin);
  }
  return point;
}

}  // namespace shellgrid
