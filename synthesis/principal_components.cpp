// SPDX-License-Identifier: AGPL-3.0-or-later
#include "synthesis/principal_components.h"

#include <Eigen/Eigenvalues>
#include <algorithm>

#include "meshing/core/parallel.h"

namespace shellgrid {

RowMatrixf reduce_dimensions(const RowMatrixf& rows, int dimension, double* kept) {
  const Eigen::Index n = rows.rows(), d = rows.cols();
  const Eigen::RowVectorXf mean = rows.cast<double>().colwise().mean().cast<float>();
  // Chunks of fixed size, added in order: the same bits at any thread count.
  const std::size_t chunk = 2048;
  std::vector<Eigen::MatrixXf> partial((n + chunk - 1) / chunk);
  parallel_chunks(static_cast<std::size_t>(n), chunk, [&](std::size_t begin, std::size_t end) {
    const RowMatrixf centered = rows.middleRows(begin, end - begin).rowwise() - mean;
    partial[begin / chunk] = centered.transpose() * centered;
  });
  Eigen::MatrixXd covariance = Eigen::MatrixXd::Zero(d, d);
  for (const Eigen::MatrixXf& part : partial) covariance += part.cast<double>();
  covariance /= static_cast<double>(n);
  const Eigen::SelfAdjointEigenSolver<Eigen::MatrixXd> solver(covariance);
  const int count = static_cast<int>(std::min<Eigen::Index>(dimension, d));
  Eigen::MatrixXf basis = solver.eigenvectors().rightCols(count).rowwise().reverse().cast<float>();
  for (int i = 0; i < count; ++i) {
    Eigen::Index largest = 0;
    basis.col(i).cwiseAbs().maxCoeff(&largest);
    if (basis(largest, i) < 0) basis.col(i) = -basis.col(i);
  }
  if (kept) {
    const double total = covariance.trace();
    *kept = total > 1e-30 ? solver.eigenvalues().tail(count).sum() / total : 1.0;
  }
  RowMatrixf result = RowMatrixf::Zero(n, dimension);
  parallel_chunks(static_cast<std::size_t>(n), chunk, [&](std::size_t begin, std::size_t end) {
    const RowMatrixf centered = rows.middleRows(begin, end - begin).rowwise() - mean;
    result.block(begin, 0, end - begin, count) = centered * basis;
  });
  return result;
}

}  // namespace shellgrid
