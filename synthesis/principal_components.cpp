// SPDX-License-Identifier: AGPL-3.0-or-later
#include "synthesis/principal_components.h"

#include <Eigen/Eigenvalues>
#include <algorithm>

#include "meshing/core/parallel.h"

namespace shellgrid {

namespace {

// Chunks of fixed size, added in order: the same bits at any thread count.
constexpr std::size_t chunk = 2048;

}  // namespace

PrincipalComponents find_principal_components(const RowMatrixf& rows, int dimension) {
  const Eigen::Index n = rows.rows(), d = rows.cols();
  PrincipalComponents result;
  result.mean = rows.cast<double>().colwise().mean().cast<float>();
  std::vector<Eigen::MatrixXf> partial((n + chunk - 1) / chunk);
  parallel_chunks(static_cast<std::size_t>(n), chunk, [&](std::size_t begin, std::size_t end) {
    const RowMatrixf centered = rows.middleRows(begin, end - begin).rowwise() - result.mean;
    partial[begin / chunk] = centered.transpose() * centered;
  });
  Eigen::MatrixXd covariance = Eigen::MatrixXd::Zero(d, d);
  for (const Eigen::MatrixXf& part : partial) covariance += part.cast<double>();
  covariance /= static_cast<double>(n);
  const Eigen::SelfAdjointEigenSolver<Eigen::MatrixXd> solver(covariance);
  const int count = static_cast<int>(std::min<Eigen::Index>(dimension, d));
  result.basis = Eigen::MatrixXf::Zero(d, dimension);
  result.basis.leftCols(count) = solver.eigenvectors().rightCols(count).rowwise().reverse().cast<float>();
  for (int i = 0; i < count; ++i) {
    Eigen::Index largest = 0;
    result.basis.col(i).cwiseAbs().maxCoeff(&largest);
    if (result.basis(largest, i) < 0) result.basis.col(i) = -result.basis.col(i);
  }
  const double total = covariance.trace();
  result.kept = total > 1e-30 ? solver.eigenvalues().tail(count).sum() / total : 1.0;
  return result;
}

RowMatrixf project(const RowMatrixf& rows, const PrincipalComponents& components) {
  RowMatrixf result(rows.rows(), components.basis.cols());
  parallel_chunks(static_cast<std::size_t>(rows.rows()), chunk, [&](std::size_t begin, std::size_t end) {
    const RowMatrixf centered = rows.middleRows(begin, end - begin).rowwise() - components.mean;
    result.middleRows(begin, end - begin) = centered * components.basis;
  });
  return result;
}

RowMatrixf reduce_dimensions(const RowMatrixf& rows, int dimension, double* kept) {
  const PrincipalComponents components = find_principal_components(rows, dimension);
  if (kept) *kept = components.kept;
  return project(rows, components);
}

}  // namespace shellgrid
