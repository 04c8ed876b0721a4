// SPDX-License-Identifier: AGPL-3.0-or-later
#include "meshing/distance/winding_number.h"

#include <Eigen/Geometry>
#include <algorithm>
#include <cmath>
#include <limits>
#include <numbers>
#include <numeric>

namespace shellgrid {
namespace {

constexpr int leaf_count = 6;

// Over 2; [VanOosteromStrackee1983 eq. 8].
double half_solid_angle(const Vec3& a, const Vec3& b, const Vec3& c) {
  const double la = a.norm(), lb = b.norm(), lc = c.norm();
  return std::atan2(a.dot(b.cross(c)), la * lb * lc + a.dot(b) * lc + b.dot(c) * la + c.dot(a) * lb);
}

}  // namespace

WindingNumber::WindingNumber(const TriangleMesh& mesh) : mesh_(mesh) {
  order_.resize(static_cast<std::size_t>(mesh.face_count()));
  std::iota(order_.begin(), order_.end(), 0);
  for (int f = 0; f < mesh.face_count(); ++f)
    centroids_.push_back((mesh.corner(f, 0) + mesh.corner(f, 1) + mesh.corner(f, 2)) / 3);
  nodes_.reserve(order_.size());
  if (!order_.empty()) build(0, mesh.face_count());
}

int WindingNumber::build(int first, int count) {
  const int index = static_cast<int>(nodes_.size());
  nodes_.emplace_back();
  Node node;
  node.first = first;
  node.count = count;
  node.right = -1;
  node.area.setZero();
  node.moment.setZero();
  Vec3 weighted = Vec3::Zero(), plain = Vec3::Zero();
  double total = 0, second_moment = 0;
  Vec3 lower = Vec3::Constant(std::numeric_limits<double>::infinity()), upper = -lower;
  const auto area_of = [&](int f) -> Vec3 {
    return 0.5 * (mesh_.corner(f, 1) - mesh_.corner(f, 0)).cross(mesh_.corner(f, 2) - mesh_.corner(f, 0));
  };
  for (int i = first; i < first + count; ++i) {
    const double area = area_of(order_[i]).norm();
    weighted += area * centroids_[order_[i]];
    plain += centroids_[order_[i]];
    total += area;
    lower = lower.cwiseMin(centroids_[order_[i]]);
    upper = upper.cwiseMax(centroids_[order_[i]]);
  }
  node.centre = total > 0 ? Vec3(weighted / total) : Vec3(plain / count);
  for (int i = first; i < first + count; ++i) {
    const Vec3 area = area_of(order_[i]);
    node.area += area;
    node.moment += area * (centroids_[order_[i]] - node.centre).transpose();
    double squares = 0;  // ∫ |x − centre|² = area/12 · (Σ |corner − centre|² + 9 |centroid − centre|²)
    for (int k = 0; k < 3; ++k) {
      const double square = (mesh_.corner(order_[i], k) - node.centre).squaredNorm();
      squares += square;
      node.radius = std::max(node.radius, std::sqrt(square));
    }
    second_moment += area.norm() / 12 * (squares + 9 * (centroids_[order_[i]] - node.centre).squaredNorm());
  }
  node.reach = std::pow(3 * second_moment / (4 * std::numbers::pi), 0.25);
  if (count > leaf_count) {
    int axis = 0;
    (upper - lower).maxCoeff(&axis);
    const int half = count / 2;
    std::nth_element(order_.begin() + first, order_.begin() + first + half, order_.begin() + first + count,
                     [&](int f, int g) {
                       const double x = centroids_[f][axis], y = centroids_[g][axis];
                       return x < y || (x == y && f < g);
                     });
    nodes_[index] = node;
    build(first, half);
    node.right = build(first + half, count - half);
  }
  nodes_[index] = node;
  return index;
}

WindingNumber::Estimate WindingNumber::estimate(const Vec3& point, double tolerance) const {
  // The m-th derivatives of 1/r are at most m!/r^(m + 1). What the dipole and its first moment leave over is half of
  // the third: 3 ∫ |x − centre|² / 4π (distance − radius)⁴ at most.
  const double factor = tolerance > 0 ? std::pow(tolerance, -0.25) : std::numeric_limits<double>::infinity();
  double sum = 0, error = 0;  // the sum times 4π
  if (nodes_.empty()) return {0, 0};
  int stack[64];
  int size = 0;
  stack[size++] = 0;
  while (size > 0) {
    const int at = stack[--size];
    const Node& node = nodes_[at];
    const Vec3 y = node.centre - point;
    const double square = y.squaredNorm();
    const double least = node.radius + factor * node.reach;
    if (square > least * least) {
      const double distance = std::sqrt(square), cube = square * distance;
      sum += (node.area.dot(y) + node.moment.trace() - 3 / square * y.dot(node.moment * y)) / cube;
      const double part = node.reach / (distance - node.radius);
      error += part * part * part * part;
    } else if (node.right < 0) {
      for (int i = node.first; i < node.first + node.count; ++i) {
        const int f = order_[i];
        sum += 2 * half_solid_angle(mesh_.corner(f, 0) - point, mesh_.corner(f, 1) - point, mesh_.corner(f, 2) - point);
      }
    } else {
      stack[size++] = node.right;
      stack[size++] = at + 1;
    }
  }
  return {sum / (4 * std::numbers::pi), error};
}

bool WindingNumber::inside(const Vec3& point) const {
  for (const double tolerance : {4e-3, 1e-3, 1e-4, 1e-6}) {
    const Estimate found = estimate(point, tolerance);
    if (std::abs(found.value - 0.5) > found.error) return found.value > 0.5;
  }
  return estimate(point, 0).value >= 0.5;
}

}  // namespace shellgrid
