// SPDX-License-Identifier: AGPL-3.0-or-later
#include "meshing/polycube/target_surface.h"

#include <Eigen/Geometry>
#include <algorithm>
#include <cmath>
#include <numeric>

#include "meshing/core/random.h"

namespace shellgrid {
TargetSurface::TargetSurface(const TriangleMesh& mesh) : mesh_(mesh), query_(mesh, ClosestPointQuery::Facing::known) {
  const int faces = mesh_.face_count();
  face_normals_.resize(faces);
  std::vector<std::vector<std::pair<int, double>>> around(mesh_.vertex_count());
  for (int f = 0; f < faces; ++f) {
    const Vec3 cross = (mesh_.corner(f, 1) - mesh_.corner(f, 0)).cross(mesh_.corner(f, 2) - mesh_.corner(f, 0));
    const double length = cross.norm();
    face_normals_[f] = length > 0 ? Vec3(cross / length) : Vec3(Vec3::Zero());
    for (int k = 0; k < 3; ++k) {
      const Vec3 u = mesh_.corner(f, (k + 1) % 3) - mesh_.corner(f, k);
      const Vec3 v = mesh_.corner(f, (k + 2) % 3) - mesh_.corner(f, k);
      const double angle = std::atan2(u.cross(v).norm(), u.dot(v));
      around[mesh_.faces(f, k)].emplace_back(f, angle);
    }
  }
  // Angle-weighted normals that do not smooth over creases.
  corner_normals_.resize(faces);
  for (int f = 0; f < faces; ++f)
    for (int k = 0; k < 3; ++k) {
      Vec3 sum = Vec3::Zero();
      for (const auto& [g, angle] : around[mesh_.faces(f, k)])
        if (face_normals_[g].dot(face_normals_[f]) > 0.7) sum += angle * face_normals_[g];
      corner_normals_[f][k] = sum.norm() > 0 ? Vec3(sum.normalized()) : face_normals_[f];
    }
}

TargetSurface::Nearest TargetSurface::complete(const SurfacePoint& found) const {
  Nearest result;
  result.face = found.face_index;
  if (result.face < 0) return result;
  result.point = found.point;
  result.barycentric = found.barycentric;
  result.distance = std::sqrt(found.squared_distance);
  result.face_normal = face_normals_[result.face];
  Vec3 normal = Vec3::Zero();
  for (int k = 0; k < 3; ++k) normal += result.barycentric[k] * corner_normals_[result.face][k];
  result.normal = normal.norm() > 1e-6 ? Vec3(normal.normalized()) : result.face_normal;
  return result;
}

bool TargetSurface::is_way_inside(const Vec3& inside, const Vec3& point) const {
  const double length = (point - inside).norm(), least_step = 0.02 * length;
  for (double way = 0; way < length - least_step;) {
    const Vec3 place = inside + way / length * (point - inside);
    const Nearest there = nearest(place);
    if ((place - there.point).dot(there.normal) > 0.5 * there.distance) return false;
    way += std::max(least_step, there.distance);
  }
  return true;
}

Vec3 TargetSurface::link_normal(const Nearest& nearest, const Vec3& link) const {
  if (nearest.barycentric.minCoeff() >= 1e-5) return nearest.normal;
  const Vec3 at_edge = nearest_normal(nearest.point, link, 1e-6);
  return at_edge.dot(nearest.normal) > 0 ? at_edge : nearest.normal;
}

TargetSurface::Nearest TargetSurface::nearest_from_inside(const Vec3& place, const Vec3& facing, double limit,
                                                          double sure) const {
  const Nearest same_side = nearest_same_side(place, facing, limit);
  if ((same_side.point - place).norm() <= sure || is_way_inside(place, same_side.point)) return same_side;
  return nearest(place);
}

Vec3 TargetSurface::nearest_normal(const Vec3& place, const Vec3& direction, double tolerance) const {
  std::vector<Vec3> normals;
  for (int f : query_.faces_within(place, tolerance))
    if (face_normals_[f].squaredNorm() > 0) normals.push_back(face_normals_[f]);
  if (normals.empty()) return Vec3::Zero();
  // Least squares with non-negative coefficients, one coefficient after another.
  const Vec3 wanted = direction.stableNormalized();
  std::vector<double> share(normals.size(), 0);
  Vec3 rest = wanted;
  for (int sweep = 0; sweep < 100; ++sweep) {
    double moved = 0;
    for (std::size_t i = 0; i < normals.size(); ++i) {
      const double change = std::max(-share[i], normals[i].dot(rest));
      share[i] += change;
      rest -= change * normals[i];
      moved = std::max(moved, std::abs(change));
    }
    if (moved < 1e-12) break;
  }
  const Vec3 nearest = wanted - rest;
  if (nearest.norm() > 1e-6) return nearest.normalized();
  // Against all of them: the one that is least so.
  return *std::max_element(normals.begin(), normals.end(),
                           [&](const Vec3& a, const Vec3& b) { return a.dot(wanted) < b.dot(wanted); });
}

std::vector<TargetSurface::Sample> TargetSurface::samples(int count) const {
  double total = 0;
  std::vector<double> area(mesh_.face_count());
  for (int f = 0; f < mesh_.face_count(); ++f) {
    area[f] = 0.5 * (mesh_.corner(f, 1) - mesh_.corner(f, 0)).cross(mesh_.corner(f, 2) - mesh_.corner(f, 0)).norm();
    total += area[f];
  }
  std::vector<Sample> result;
  const double share = total / count;
  double due = 0.5 * share, passed = 0;
  for (int f = 0; f < mesh_.face_count(); ++f) {
    passed += area[f];
    for (; due < passed; due += share) {
      RandomStream random(0x5a3bu, result.size());
      double u = random.next(), v = random.next();
      if (u + v > 1) u = 1 - u, v = 1 - v;
      result.push_back({mesh_.corner(f, 0) + u * (mesh_.corner(f, 1) - mesh_.corner(f, 0)) +
                            v * (mesh_.corner(f, 2) - mesh_.corner(f, 0)),
                        face_normals_[f]});
    }
  }
  return result;
}

}  // namespace shellgrid
