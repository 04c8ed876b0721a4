// SPDX-License-Identifier: AGPL-3.0-or-later
#pragma once
#include <Eigen/Core>

namespace shellgrid {

using RowMatrixf = Eigen::Matrix<float, Eigen::Dynamic, Eigen::Dynamic, Eigen::RowMajor>;

struct PrincipalComponents {
  Eigen::RowVectorXf mean;  // d
  Eigen::MatrixXf basis;    // d×dimension, orthonormal columns, zero where d is less
  double kept = 1;          // share of the variance that projections keep; 1 where there is none
};

// The first principal components of rows (n×d). Signs are fixed, so the result is unique; the same at any thread count.
PrincipalComponents find_principal_components(const RowMatrixf& rows, int dimension);

// n×dimension coordinates of rows (n×d).
RowMatrixf project(const RowMatrixf& rows, const PrincipalComponents& components);

// Projects rows (n×d) on their first principal components: n×dimension, columns padded with zeros where d is less.
// Distances between rows are kept but for the variance left out. Signs are fixed, so the result is unique.
// kept: share of the variance that stays (1 where there is none).
RowMatrixf reduce_dimensions(const RowMatrixf& rows, int dimension, double* kept = nullptr);

}  // namespace shellgrid
