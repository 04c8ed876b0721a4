// SPDX-License-Identifier: AGPL-3.0-or-later
#include "meshing/polycube/target_surface.h"

#include <Eigen/Geometry>
#include <algorithm>
#include <cmath>
#include <numeric>

#include "meshing/core/random.h"

namespace shellgrid {
namespace {

// Barycentric coordinates of the triangle's point nearest to p. Source: [Ericson2005 §5.1.5].
Vec3 nearest_barycentric(const Vec3& p, const Vec3& a, const Vec3& b, const Vec3& c) {
  const Vec3 ab = b - a, ac = c - a, ap = p - a;
  const double d1 = ab.dot(ap), d2 = ac.dot(ap);
  if (d1 <= 0 && d2 <= 0) return {1, 0, 0};
  const Vec3 bp = p - b;
  const double d3 = ab.dot(bp), d4 = ac.dot(bp);
  if (d3 >= 0 && d4 <= d3) return {0, 1, 0};
  const double vc = d1 * d4 - d3 * d2;
  if (vc <= 0 && d1 >= 0 && d3 <= 0) {
    const double v = d1 - d3 > 0 ? d1 / (d1 - d3) : 0;
    return {1 - v, v, 0};
  }
  const Vec3 cp = p - c;
  const double d5 = ab.dot(cp), d6 = ac.dot(cp);
  if (d6 >= 0 && d5 <= d6) return {0, 0, 1};
  const double vb = d5 * d2 - d1 * d6;
  if (vb <= 0 && d2 >= 0 && d6 <= 0) {
    const double w = d2 - d6 > 0 ? d2 / (d2 - d6) : 0;
    return {1 - w, 0, w};
  }
  const double va = d3 * d6 - d5 * d4;
  if (va <= 0 && d4 - d3 >= 0 && d5 - d6 >= 0) {
    const double sum = (d4 - d3) + (d5 - d6);
    const double w = sum > 0 ? (d4 - d3) / sum : 0;
    return {0, 1 - w, w};
  }
  const double sum = va + vb + vc;
  if (!(sum > 0)) return {1, 0, 0};
  return {1 - (vb + vc) / sum, vb / sum, vc / sum};
}

double box_distance2(const Vec3& p, const Vec3& lower, const Vec3& upper) {
  return (lower - p).cwiseMax(p - upper).cwiseMax(Vec3::Zero()).squaredNorm();
}

}  // namespace

TargetSurface::TargetSurface(const TriangleMesh& mesh) : mesh_(mesh) {
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

  order_.resize(faces);
  std::iota(order_.begin(), order_.end(), 0);
  std::vector<Vec3> centres(faces);
  for (int f = 0; f < faces; ++f) centres[f] = (mesh_.corner(f, 0) + mesh_.corner(f, 1) + mesh_.corner(f, 2)) / 3;
  nodes_.push_back({Vec3::Zero(), Vec3::Zero(), 0, faces});
  for (std::size_t n = 0; n < nodes_.size(); ++n) {
    const int first = nodes_[n].first, count = nodes_[n].count;
    Vec3 lower = Vec3::Constant(1e300), upper = Vec3::Constant(-1e300), low = lower, high = upper;
    for (int i = first; i < first + count; ++i) {
      for (int k = 0; k < 3; ++k) {
        lower = lower.cwiseMin(mesh_.corner(order_[i], k));
        upper = upper.cwiseMax(mesh_.corner(order_[i], k));
      }
      low = low.cwiseMin(centres[order_[i]]), high = high.cwiseMax(centres[order_[i]]);
    }
    nodes_[n].lower = lower, nodes_[n].upper = upper;
    if (count <= 4) continue;
    int axis;
    (high - low).maxCoeff(&axis);
    const int half = count / 2;
    std::nth_element(order_.begin() + first, order_.begin() + first + half, order_.begin() + first + count,
                     [&](int a, int b) {
                       return centres[a][axis] != centres[b][axis] ? centres[a][axis] < centres[b][axis] : a < b;
                     });
    const int child = static_cast<int>(nodes_.size());
    nodes_[n].first = child, nodes_[n].count = 0;
    nodes_.push_back({Vec3::Zero(), Vec3::Zero(), first, half});
    nodes_.push_back({Vec3::Zero(), Vec3::Zero(), first + half, count - half});
  }
}

TargetSurface::Nearest TargetSurface::search(const Vec3& place, const Vec3& facing, double least_cosine,
                                             double limit) const {
  Nearest best;
  double best_cost = limit * limit;
  const bool oriented = facing.squaredNorm() > 0;
  int stack[128], depth = 0;
  stack[depth++] = 0;
  while (depth > 0) {
    const Node& node = nodes_[stack[--depth]];
    // The cost is at least the squared distance.
    if (box_distance2(place, node.lower, node.upper) > best_cost) continue;
    if (node.count == 0) {
      const double left = box_distance2(place, nodes_[node.first].lower, nodes_[node.first].upper);
      const double right = box_distance2(place, nodes_[node.first + 1].lower, nodes_[node.first + 1].upper);
      stack[depth++] = left < right ? node.first + 1 : node.first;
      stack[depth++] = left < right ? node.first : node.first + 1;
      continue;
    }
    for (int i = node.first; i < node.first + node.count; ++i) {
      const int f = order_[i];
      if (facing.dot(face_normals_[f]) < least_cosine) continue;
      const Vec3 a = mesh_.corner(f, 0), b = mesh_.corner(f, 1), c = mesh_.corner(f, 2);
      const Vec3 barycentric = nearest_barycentric(place, a, b, c);
      const Vec3 point = barycentric[0] * a + barycentric[1] * b + barycentric[2] * c;
      const double distance2 = (place - point).squaredNorm();
      const double cost = oriented ? distance2 * (2 - facing.dot(face_normals_[f])) : distance2;
      if (cost < best_cost || (cost == best_cost && f < best.face)) {
        best_cost = cost;
        best.point = point, best.face = f, best.distance = std::sqrt(distance2), best.barycentric = barycentric;
      }
    }
  }
  if (best.face >= 0) {
    best.face_normal = face_normals_[best.face];
    Vec3 normal = Vec3::Zero();
    for (int k = 0; k < 3; ++k) normal += best.barycentric[k] * corner_normals_[best.face][k];
    best.normal = normal.norm() > 1e-6 ? Vec3(normal.normalized()) : best.face_normal;
  }
  return best;
}

Vec3 TargetSurface::nearest_normal(const Vec3& place, const Vec3& direction, double tolerance) const {
  std::vector<Vec3> normals;
  int stack[128], depth = 0;
  stack[depth++] = 0;
  while (depth > 0) {
    const Node& node = nodes_[stack[--depth]];
    if (box_distance2(place, node.lower, node.upper) > tolerance * tolerance) continue;
    if (node.count == 0) {
      stack[depth++] = node.first, stack[depth++] = node.first + 1;
      continue;
    }
    for (int i = node.first; i < node.first + node.count; ++i) {
      const int f = order_[i];
      const Vec3 a = mesh_.corner(f, 0), b = mesh_.corner(f, 1), c = mesh_.corner(f, 2);
      const Vec3 barycentric = nearest_barycentric(place, a, b, c);
      const Vec3 point = barycentric[0] * a + barycentric[1] * b + barycentric[2] * c;
      if ((place - point).norm() <= tolerance && face_normals_[f].squaredNorm() > 0)
        normals.push_back(face_normals_[f]);
    }
  }
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
