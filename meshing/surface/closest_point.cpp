// SPDX-License-Identifier: AGPL-3.0-or-later
#include "meshing/surface/closest_point.h"

#include <Eigen/Geometry>
#include <algorithm>

#include "meshing/core/parallel.h"

// Lanes are passed within this file only, so it does not matter in which registers.
#pragma GCC diagnostic ignored "-Wpsabi"

namespace shellgrid {
namespace {

constexpr double infinity = std::numeric_limits<double>::infinity();

Lanes load(const double* values) {
  Lanes lanes;
  std::memcpy(&lanes, values, sizeof lanes);
  return lanes;
}

double inverse_or_zero(double value) { return value > 0 && 1 / value < infinity ? 1 / value : 0; }

}  // namespace

ClosestPointQuery::ClosestPointQuery(const TriangleMesh& mesh, Facing facing) {
  std::vector<Box> boxes(mesh.face_count());
  parallel_for(boxes.size(), [&](std::size_t f) {
    for (int k = 0; k < 3; ++k) boxes[f].add(mesh.corner(static_cast<int>(f), k));
  });
  tree_ = BoxTree(boxes);
  packets_.resize(tree_.leaf_count());
  if (facing == Facing::known) normals_.resize(packets_.size());
  parallel_for(packets_.size(), [&](std::size_t leaf) {
    Packet& packet = packets_[leaf];
    for (int slot = 0; slot < 8; ++slot) {
      const int face = tree_.item(static_cast<int>(leaf), slot);
      packet.face[slot] = face;
      Vec3 a = Vec3::Constant(infinity), ab = Vec3::Zero(), ac = Vec3::Zero();
      if (face >= 0) {
        a = mesh.corner(face, 0);
        ab = mesh.corner(face, 1) - a;
        ac = mesh.corner(face, 2) - a;
      }
      for (int axis = 0; axis < 3; ++axis) {
        packet.a[axis][slot] = a[axis];
        packet.ab[axis][slot] = ab[axis];
        packet.ac[axis][slot] = ac[axis];
      }
      packet.inverse_ab2[slot] = inverse_or_zero(ab.squaredNorm());
      packet.inverse_ac2[slot] = inverse_or_zero(ac.squaredNorm());
      packet.inverse_bc2[slot] = inverse_or_zero((ac - ab).squaredNorm());
      packet.inverse_determinant[slot] = inverse_or_zero(ab.cross(ac).squaredNorm());
      if (normals_.empty()) continue;
      const Vec3 normal = ab.cross(ac).stableNormalized();
      normals_[leaf].x[slot] = normal.x(), normals_[leaf].y[slot] = normal.y(), normals_[leaf].z[slot] = normal.z();
    }
  });
}

Lanes ClosestPointQuery::squared_distances(const Packet& packet, const Vec3& point, Lanes& v, Lanes& w) {
  Lanes ap[3], ab[3], ac[3];
  for (int axis = 0; axis < 3; ++axis) {
    ap[axis] = point[axis] - load(packet.a[axis]);
    ab[axis] = load(packet.ab[axis]);
    ac[axis] = load(packet.ac[axis]);
  }
  const auto dot = [](const Lanes* u, const Lanes* v) { return u[0] * v[0] + u[1] * v[1] + u[2] * v[2]; };
  const Lanes zero = {}, one = zero + 1;
  const auto clamp = [&](const Lanes& t) {
    const Lanes low = t > zero ? t : zero;
    return low < one ? low : one;
  };
  const auto residual = [&](const Lanes& v, const Lanes& w) {
    const Lanes r[3] = {ap[0] - v * ab[0] - w * ac[0], ap[1] - v * ab[1] - w * ac[1], ap[2] - v * ab[2] - w * ac[2]};
    return dot(r, r);
  };
  const Lanes d1 = dot(ab, ap), d2 = dot(ac, ap);
  const Lanes ab2 = dot(ab, ab), ac2 = dot(ac, ac), abac = dot(ab, ac);

  // The nearest points of the three edges.
  v = clamp(d1 * load(packet.inverse_ab2)), w = zero;
  Lanes distance = residual(v, w);
  const Lanes on_ac = clamp(d2 * load(packet.inverse_ac2));
  const Lanes distance_ac = residual(zero, on_ac);
  v = distance_ac < distance ? zero : v;
  w = distance_ac < distance ? on_ac : w;
  distance = distance_ac < distance ? distance_ac : distance;
  const Lanes on_bc = clamp((d2 - d1 - abac + ab2) * load(packet.inverse_bc2));
  const Lanes distance_bc = residual(one - on_bc, on_bc);
  v = distance_bc < distance ? one - on_bc : v;
  w = distance_bc < distance ? on_bc : w;
  distance = distance_bc < distance ? distance_bc : distance;

  // The projection onto the plane, where it falls inside.
  const Lanes inverse = load(packet.inverse_determinant);
  const Lanes plane_v = (ac2 * d1 - abac * d2) * inverse;
  const Lanes plane_w = (ab2 * d2 - abac * d1) * inverse;
  const Lanes distance_plane = residual(plane_v, plane_w);
  const auto inside = (plane_v > zero) & (plane_w > zero) & (plane_v + plane_w < one) & (distance_plane < distance);
  v = inside ? plane_v : v;
  w = inside ? plane_w : w;
  return inside ? distance_plane : distance;
}

template <class Cost>
SurfacePoint ClosestPointQuery::least(const Vec3& point, double best, const Cost& cost) const {
  double best_v = 0, best_w = 0;
  int best_leaf = -1, best_slot = 0;
  best = std::min(best, std::numeric_limits<double>::max());  // an infinite cost is none
  tree_.search(point, best, [&](int leaf) {
    Lanes v, w;
    const Lanes distance = cost(leaf, squared_distances(packets_[leaf], point, v, w));
    alignas(64) double distances[8], vs[8], ws[8];
    std::memcpy(distances, &distance, sizeof distances);
    std::memcpy(vs, &v, sizeof vs);
    std::memcpy(ws, &w, sizeof ws);
    for (int slot = 0; slot < 8; ++slot)
      if (distances[slot] < best || (best_leaf < 0 && distances[slot] <= best)) {
        best = distances[slot];
        best_v = vs[slot];
        best_w = ws[slot];
        best_leaf = leaf;
        best_slot = slot;
      }
  });

  SurfacePoint result;
  if (best_leaf < 0) return result;
  const Packet& packet = packets_[best_leaf];
  for (int axis = 0; axis < 3; ++axis)
    result.point[axis] =
        packet.a[axis][best_slot] + best_v * packet.ab[axis][best_slot] + best_w * packet.ac[axis][best_slot];
  result.face_index = packet.face[best_slot];
  result.barycentric = Vec3(1 - best_v - best_w, best_v, best_w);
  if (result.barycentric.x() < 0) result.barycentric.x() = 0;
  result.squared_distance = best;
  return result;
}

SurfacePoint ClosestPointQuery::nearest(const Vec3& point, double max_distance) const {
  return least(point, max_distance * max_distance, [](int, const Lanes& distance) { return distance; });
}

SurfacePoint ClosestPointQuery::nearest_facing(const Vec3& point, const Vec3& facing, double least_cosine,
                                               double max_distance) const {
  SurfacePoint result = least(point, max_distance * max_distance, [&](int leaf, const Lanes& distance) {
    const NormalPacket& normals = normals_[leaf];
    const Lanes cosine = facing.x() * load(normals.x) + facing.y() * load(normals.y) + facing.z() * load(normals.z);
    const Lanes none = Lanes{} + infinity;
    return cosine < least_cosine ? none : distance * (2.0 - cosine);
  });
  if (result.face_index >= 0) result.squared_distance = (result.point - point).squaredNorm();
  return result;
}

std::vector<int> ClosestPointQuery::faces_within(const Vec3& point, double radius) const {
  std::vector<int> faces;
  double reach = radius * radius;
  tree_.search(point, reach, [&](int leaf) {
    Lanes v, w;
    const Lanes distance = squared_distances(packets_[leaf], point, v, w);
    for (int slot = 0; slot < 8; ++slot)
      if (distance[slot] <= reach) faces.push_back(packets_[leaf].face[slot]);
  });
  return faces;
}

NearestVertexQuery::NearestVertexQuery(const VertexMatrix& points) : points_(points) {
  std::vector<Box> boxes(points.rows());
  for (Eigen::Index i = 0; i < points.rows(); ++i) boxes[i].add(Vec3(points.row(i).transpose()));
  tree_ = BoxTree(boxes);
  packets_.resize(tree_.leaf_count());
  parallel_for(packets_.size(), [&](std::size_t leaf) {
    for (int slot = 0; slot < 8; ++slot) {
      const int index = tree_.item(static_cast<int>(leaf), slot);
      packets_[leaf].index[slot] = index;
      for (int axis = 0; axis < 3; ++axis)
        packets_[leaf].position[axis][slot] = index < 0 ? infinity : points(index, axis);
    }
  });
}

int NearestVertexQuery::nearest(const Vec3& point, int candidate) const {
  int best_index = candidate;
  double best = infinity;
  // A hair of slack, because the packets may round the candidate's distance otherwise.
  if (candidate >= 0) best = (points_.row(candidate).transpose() - point).squaredNorm() * (1 + 1e-14);
  tree_.search(point, best, [&](int leaf) {
    const Packet& packet = packets_[leaf];
    const Lanes x = load(packet.position[0]) - point.x();
    const Lanes y = load(packet.position[1]) - point.y();
    const Lanes z = load(packet.position[2]) - point.z();
    const Lanes distance = x * x + y * y + z * z;
    alignas(64) double distances[8];
    std::memcpy(distances, &distance, sizeof distances);
    for (int slot = 0; slot < 8; ++slot)
      if (distances[slot] < best || (distances[slot] == best && packet.index[slot] < best_index)) {
        best = distances[slot];
        best_index = packet.index[slot];
      }
  });
  return best_index;
}

int NearestVertexQuery::count_within(const Vec3& point, double radius, int most) const {
  int count = 0;
  double reach = radius * radius;
  tree_.search(point, reach, [&](int leaf) {
    const Packet& packet = packets_[leaf];
    for (int slot = 0; slot < 8; ++slot) {
      const Vec3 offset(packet.position[0][slot] - point.x(), packet.position[1][slot] - point.y(),
                        packet.position[2][slot] - point.z());
      count += offset.squaredNorm() <= reach;
    }
    if (count >= most) reach = -1;
  });
  return std::min(count, most);
}

}  // namespace shellgrid
