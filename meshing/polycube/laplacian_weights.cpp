// SPDX-License-Identifier: AGPL-3.0-or-later
#include "meshing/polycube/laplacian_weights.h"

#include <Eigen/LU>
#include <Eigen/SVD>
#include <cmath>

namespace shellgrid {
namespace {

using Matrix6 = Eigen::Matrix<double, 6, 6>;

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

}  // namespace

LaplacianWeights laplacian_weights(const std::array<Vec3, 6>& offsets, double spacing) {
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
  result.exact = std::isfinite(result.condition) && result.condition < 1e12;
  for (int j = 0; j < 6; ++j) {
    if (result.exact) {
      result.weights[j] = (inverse(1, j) + inverse(3, j) + inverse(5, j)) / (spacing * spacing);
    } else {
      const double near = offsets[j].norm(), far = offsets[j ^ 1].norm();
      result.weights[j] = 2 / (near * (near + far));
    }
  }
  if (!result.exact) result.condition = 1e12;
  return result;
}

}  // namespace shellgrid
