// SPDX-License-Identifier: AGPL-3.0-or-later
#include "solvers/dipole/point_tree.h"

#include <Eigen/Eigenvalues>
#include <algorithm>
#include <cmath>
#include <numbers>
#include <numeric>

#include "meshing/core/parallel.h"

namespace shellgrid {

namespace {

// Chebyshev points of n and the denominators of their Lagrange polynomials.
struct ChebyshevPoints {
  std::array<float, PointTree::most_order> place = {}, over = {};
};

const ChebyshevPoints& chebyshev_points(int n) {
  static const std::array<ChebyshevPoints, PointTree::most_order + 1> all = [] {
    std::array<ChebyshevPoints, PointTree::most_order + 1> points;
    for (int m = 1; m <= PointTree::most_order; ++m)
      for (int i = 0; i < m; ++i)
        points[m].place[i] = static_cast<float>(std::cos((2 * i + 1) * std::numbers::pi / (2 * m)));
    for (int m = 1; m <= PointTree::most_order; ++m)
      for (int i = 0; i < m; ++i) {
        double product = 1;
        for (int j = 0; j < m; ++j)
          if (j != i) product *= static_cast<double>(points[m].place[i]) - static_cast<double>(points[m].place[j]);
        points[m].over[i] = static_cast<float>(1 / product);
      }
    return points;
  }();
  return all[n];
}

void lagrange(int n, float x, float* values) {
  const ChebyshevPoints& points = chebyshev_points(n);
  for (int i = 0; i < n; ++i) {
    float product = points.over[i];
    for (int j = 0; j < n; ++j)
      if (j != i) product *= x - points.place[j];
    values[i] = product;
  }
}

}  // namespace

float PointTree::Node::squared_least_distance(const Node& other) const {
  return (low - other.high).cwiseMax(other.low - high).cwiseMax(0.0f).squaredNorm();
}

float PointTree::Node::squared_most_distance(const Node& other) const {
  return (high - other.low).cwiseMax(other.high - low).squaredNorm();
}

std::array<int, 3> PointTree::Node::counts(int order) const {
  // Relative errors of interpolating r⁻³ at half its distance: C(n + 2, 2) x^n 2^{1 − n}, as node_reach.cpp takes them.
  const auto error = [](int n, float x) {
    float power = 1;
    for (int i = 0; i < n; ++i) power *= x / 2;
    return static_cast<float>((n + 2) * (n + 1) / 2) * power * 2;
  };
  std::array<int, 3> counts = {order, order, order};
  const float allowed = error(order, 0.5f);
  for (int a = 1; a < 3; ++a) {
    const float x = half[0] > 0 ? 0.5f * half[a] / half[0] : 0;
    int n = 1;
    while (n < order && error(n, x) > allowed) ++n;
    counts[a] = n;
  }
  if (!(half[0] > 0)) counts[0] = 1;
  return counts;
}

PointTree::PointTree(const std::vector<Vec3f>& points) : order_(points.size()), points_(points.size()) {
  std::iota(order_.begin(), order_.end(), 0);
  points_ = points;
  Node root;
  root.last = static_cast<std::int32_t>(points.size());
  bound(root);
  nodes_.push_back(root);
  // Level by level: each node's points are halved along its longest axis.
  std::size_t begin = 0;
  while (begin < nodes_.size()) {
    const std::size_t end = nodes_.size();
    std::size_t added = end;
    for (std::size_t i = begin; i < end; ++i)
      if (nodes_[i].count() > leaf_points && nodes_[i].half[0] > 0) {
        nodes_[i].left = static_cast<std::int32_t>(added++);
        nodes_[i].right = static_cast<std::int32_t>(added++);
      }
    nodes_.resize(added);
    parallel_for(
        end - begin,
        [&](std::size_t k) {
          const Node node = nodes_[begin + k];
          if (node.is_leaf()) return;
          const std::int32_t middle = node.first + node.count() / 2;
          std::vector<std::pair<float, std::int32_t>> along(static_cast<std::size_t>(node.count()));
          for (std::int32_t i = node.first; i < node.last; ++i)
            along[i - node.first] = {node.axes[0].dot(points_[i]), order_[i]};
          std::nth_element(along.begin(), along.begin() + (middle - node.first), along.end());
          for (std::int32_t i = node.first; i < node.last; ++i) {
            order_[i] = along[i - node.first].second;
            points_[i] = points[order_[i]];
          }
          Node& left = nodes_[node.left];
          Node& right = nodes_[node.right];
          left.first = node.first;
          left.last = right.first = middle;
          right.last = node.last;
          bound(left);
          bound(right);
        },
        1);
    begin = end;
  }
}

void PointTree::bound(Node& node) const {
  Vec3 mean = Vec3::Zero();
  node.low = node.high = points_[node.first];
  for (std::int32_t i = node.first; i < node.last; ++i) {
    mean += points_[i].cast<double>();
    node.low = node.low.cwiseMin(points_[i]);
    node.high = node.high.cwiseMax(points_[i]);
  }
  mean /= node.count();
  Mat3 covariance = Mat3::Zero();
  for (std::int32_t i = node.first; i < node.last; ++i) {
    const Vec3 d = points_[i].cast<double>() - mean;
    covariance.noalias() += d * d.transpose();
  }
  Eigen::SelfAdjointEigenSolver<Mat3> solver;
  solver.computeDirect(covariance);
  Mat3 axes = solver.eigenvectors();
  if (!axes.allFinite() || !(axes.transpose() * axes).isIdentity(1e-3)) axes.setIdentity();
  Vec3 least = Vec3::Constant(std::numeric_limits<double>::infinity()), most = -least;
  for (std::int32_t i = node.first; i < node.last; ++i) {
    const Vec3 d = axes.transpose() * (points_[i].cast<double>() - mean);
    least = least.cwiseMin(d);
    most = most.cwiseMax(d);
  }
  const Vec3 half = (most - least) / 2;
  std::array<int, 3> rank = {0, 1, 2};
  std::sort(rank.begin(), rank.end(), [&](int a, int b) { return half[a] > half[b] || (half[a] == half[b] && a < b); });
  for (int a = 0; a < 3; ++a) {
    node.axes[a] = axes.col(rank[a]).cast<float>();
    node.half[a] = static_cast<float>(half[rank[a]]);
  }
  node.center = (mean + axes * ((most + least) / 2)).cast<float>();
}

void PointTree::interpolation_points(const Node& node, int order, std::vector<Vec3f>& places) const {
  const std::array<int, 3> n = node.counts(order);
  places.clear();
  for (int k = 0; k < n[2]; ++k)
    for (int j = 0; j < n[1]; ++j)
      for (int i = 0; i < n[0]; ++i)
        places.push_back(node.center + node.axes[0] * (node.half[0] * chebyshev_points(n[0]).place[i]) +
                         node.axes[1] * (node.half[1] * chebyshev_points(n[1]).place[j]) +
                         node.axes[2] * (node.half[2] * chebyshev_points(n[2]).place[k]));
}

int PointTree::interpolation_weights(const Node& node, int order, const Vec3f& point, float* weights) {
  const std::array<int, 3> n = node.counts(order);
  float along[3][most_order];
  const Vec3f d = point - node.center;
  for (int a = 0; a < 3; ++a) lagrange(n[a], node.half[a] > 0 ? node.axes[a].dot(d) / node.half[a] : 0.0f, along[a]);
  int at = 0;
  for (int k = 0; k < n[2]; ++k)
    for (int j = 0; j < n[1]; ++j) {
      const float across = along[2][k] * along[1][j];
      for (int i = 0; i < n[0]; ++i) weights[at++] = across * along[0][i];
    }
  return at;
}

}  // namespace shellgrid
