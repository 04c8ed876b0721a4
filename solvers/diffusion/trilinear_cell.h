// SPDX-License-Identifier: AGPL-3.0-or-later
// The trilinear hexahedron: shape functions, quadrature and Jacobians.
#pragma once
#include <Eigen/LU>
#include <array>

#include "meshing/polycube/polygrid.h"

namespace shellgrid {

// Reference coordinates (0 or 1) of the corners, VTK_HEXAHEDRON order.
inline constexpr int corner_coordinate[8][3] = {{0, 0, 0}, {1, 0, 0}, {1, 1, 0}, {0, 1, 0},
                                                {0, 0, 1}, {1, 0, 1}, {1, 1, 1}, {0, 1, 1}};

// Shape functions and their reference gradients at one reference point.
struct TrilinearShape {
  std::array<double, 8> value;
  Eigen::Matrix<double, 8, 3> gradient;

  explicit TrilinearShape(const Vec3& reference) {
    for (int a = 0; a < 8; ++a) {
      double factor[3], slope[3];
      for (int k = 0; k < 3; ++k) {
        factor[k] = corner_coordinate[a][k] ? reference[k] : 1 - reference[k];
        slope[k] = corner_coordinate[a][k] ? 1 : -1;
      }
      value[a] = factor[0] * factor[1] * factor[2];
      gradient(a, 0) = slope[0] * factor[1] * factor[2];
      gradient(a, 1) = factor[0] * slope[1] * factor[2];
      gradient(a, 2) = factor[0] * factor[1] * slope[2];
    }
  }
};

// The shapes at the eight Gauss points (each nearest to the corner of its number) and at the corners.
struct TrilinearQuadrature {
  std::vector<TrilinearShape> gauss, corner;

  TrilinearQuadrature() {
    const double inset = 0.5 - 0.28867513459481288225;
    for (const auto& c : corner_coordinate) {
      const Vec3 at(c[0], c[1], c[2]);
      corner.emplace_back(at);
      gauss.emplace_back(at * (1 - 2 * inset) + Vec3::Constant(inset));
    }
  }
  static const TrilinearQuadrature& instance() {
    static const TrilinearQuadrature quadrature;
    return quadrature;
  }
};

using CellCorners = Eigen::Matrix<double, 8, 3>;

inline CellCorners cell_corners(const Polygrid& polygrid, int cell_index) {
  CellCorners x;
  for (int a = 0; a < 8; ++a) x.row(a) = polygrid.points.row(polygrid.cells(cell_index, a));
  return x;
}

// J(k, l) = ∂x_l / ∂ξ_k.
inline Mat3 jacobian(const CellCorners& corners, const TrilinearShape& shape) {
  return shape.gradient.transpose() * corners;
}

}  // namespace shellgrid
