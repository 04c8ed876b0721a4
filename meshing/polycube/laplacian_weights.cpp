// SPDX-License-Identifier: AGPL-3.0-or-later
#include "meshing/polycube/laplacian_weights.h"

#include <Eigen/LU>
#include <Eigen/QR>
#include <Eigen/SVD>
#include <algorithm>
#include <cmath>
#include <limits>
#include <numbers>

#include "meshing/core/parallel.h"

namespace shellgrid {
namespace {

using Matrix6 = Eigen::Matrix<double, 6, 6>;
using Vector6 = Eigen::Matrix<double, 6, 1>;

constexpr double singular = 1e12;  // condition number

double one_norm(const Matrix6& m) { return m.cwiseAbs().colwise().sum().maxCoeff(); }

// The rotation nearest to a matrix, by Newton's iteration for the polar factor.
Mat3 nearest_rotation(Mat3 m) {
  for (int i = 0; i < 12; ++i) {
    const double determinant = m.determinant();
    if (!(std::abs(determinant) > 1e-9)) return Mat3::Identity();
    m = 0.5 * (m + m.inverse().transpose()).eval();
  }
  return m;
}

// The weights ≥ 0 of least squares, for offsets in units of the spacing: of all sets of positive weights the one whose
// own solution is positive and errs least. Zero where every offset is.
Vector6 least_squares_weights(const std::array<Vec3, 6>& offsets) {
  using Rows = Eigen::Matrix<double, 9, Eigen::Dynamic, 0, 9, 6>;
  // How much more an error in linear functions counts, which does not fall with the spacing as that in quadratics does.
  constexpr double linear = 1e3;
  Eigen::Matrix<double, 9, 6> all;
  Eigen::Matrix<double, 9, 1> wanted;
  wanted << 0, 0, 0, 2, 2, 2, 0, 0, 0;
  for (int j = 0; j < 6; ++j) {
    const Vec3& d = offsets[j];
    all.col(j) << linear * d, d.cwiseProduct(d), std::numbers::sqrt2 * d.x() * d.y(),
        std::numbers::sqrt2 * d.x() * d.z(), std::numbers::sqrt2 * d.y() * d.z();
  }
  Vector6 best = Vector6::Zero();
  double least = wanted.squaredNorm();
  for (unsigned set = 1; set < 64; ++set) {
    Rows rows(9, __builtin_popcount(set));
    for (int j = 0, k = 0; j < 6; ++j)
      if (set >> j & 1) rows.col(k++) = all.col(j);
    const Eigen::ColPivHouseholderQR<Rows> factors(rows);
    if (factors.rank() < rows.cols()) continue;
    const Eigen::VectorXd solution = factors.solve(wanted);
    if (!(solution.minCoeff() >= 0)) continue;
    const double error = (rows * solution - wanted).squaredNorm();
    if (!(error < least * (1 - 1e-12))) continue;
    least = error;
    best.setZero();
    for (int j = 0, k = 0; j < 6; ++j)
      if (set >> j & 1) best[j] = solution[k++];
  }
  return best;
}

}  // namespace

LaplacianWeights laplacian_weights(const std::array<Vec3, 6>& offsets, double spacing, double condition_limit) {
  Mat3 lines;
  for (int axis = 0; axis < 3; ++axis) lines.col(axis) = (offsets[2 * axis + 1] - offsets[2 * axis]).stableNormalized();
  const Mat3 frame = nearest_rotation(lines);
  Matrix6 matrix;
  for (int j = 0; j < 6; ++j) {
    const Vec3 d = frame.transpose() * offsets[j] / spacing;
    for (int axis = 0; axis < 3; ++axis) {
      matrix(j, 2 * axis) = d[axis];                      // [Diffusion eq. 10] first derivatives
      matrix(j, 2 * axis + 1) = 0.5 * d[axis] * d[axis];  // second derivatives
    }
  }
  LaplacianWeights result{};
  const Matrix6 inverse = matrix.inverse();
  result.condition = one_norm(matrix) * one_norm(inverse);
  if (!(result.condition < singular)) result.condition = singular;
  if (result.condition < singular && result.condition <= condition_limit) {
    result.method = WeightMethod::appendix_b;
    for (int j = 0; j < 6; ++j)
      result.weights[j] = (inverse(1, j) + inverse(3, j) + inverse(5, j)) / (spacing * spacing);
    return result;
  }
  if (condition_limit < singular) {
    std::array<Vec3, 6> scaled;
    for (int j = 0; j < 6; ++j) scaled[j] = offsets[j] / spacing;
    const Vector6 weights = least_squares_weights(scaled);
    // Where all linked nodes lie to one side only weights near zero are exact for linear functions; elsewhere their sum
    // is about 6.
    if (weights.sum() >= 0.5) {
      result.method = WeightMethod::least_squares;
      for (int j = 0; j < 6; ++j) result.weights[j] = weights[j] / (spacing * spacing);
      return result;
    }
  }
  result.method = WeightMethod::three_lines;
  for (int j = 0; j < 6; ++j) {
    const double near = offsets[j].norm(), far = offsets[j ^ 1].norm();
    result.weights[j] = 2 / (near * (near + far));
  }
  return result;
}

void weigh_links(PolygridGraph& graph, double spacing, double condition_limit) {
  const Eigen::Index nodes = graph.interior.rows();
  graph.weights.resize(nodes, 6);
  graph.weight_condition.resize(nodes);
  graph.weight_method.resize(nodes);
  parallel_for(static_cast<std::size_t>(nodes), [&](std::size_t i) {
    std::array<Vec3, 6> offsets;
    for (int side = 0; side < 6; ++side) {
      const std::int32_t link = graph.links(i, side);
      offsets[side] =
          ((link >= 0 ? graph.interior.row(link) : graph.boundary.row(-1 - link)) - graph.interior.row(i)).transpose();
    }
    const LaplacianWeights weights = laplacian_weights(offsets, spacing, condition_limit);
    for (int side = 0; side < 6; ++side) graph.weights(i, side) = weights.weights[side];
    graph.weight_condition[i] = weights.condition;
    graph.weight_method[i] = static_cast<std::uint8_t>(weights.method);
  });
}

}  // namespace shellgrid
