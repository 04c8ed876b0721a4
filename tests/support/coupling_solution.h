// SPDX-License-Identifier: AGPL-3.0-or-later
// Solves a small system with Eigen, for tests of discretisations without a solver of their own.
#pragma once
#include <Eigen/IterativeLinearSolvers>
#include <vector>

#include "solvers/diffusion/diffusion_system.h"

namespace shellgrid::test {

struct CouplingSolution {
  std::vector<Double4> values;  // in channel 0
  int iterations = 0;
};

// A x = b in channel 0, by conjugate gradients to 1e-13.
inline CouplingSolution solve_coupling(const CouplingOperator& matrix, const std::vector<Double4>& right_side) {
  const auto n = static_cast<Eigen::Index>(matrix.size());
  Eigen::SparseMatrix<double> a(n, n);
  std::vector<Eigen::Triplet<double>> entries;
  Eigen::VectorXd right(n);
  for (Eigen::Index i = 0; i < n; ++i) {
    double diagonal = matrix.reaction[i][0];
    for (std::int64_t k = matrix.row_start[i]; k < matrix.row_start[i + 1]; ++k) {
      diagonal += matrix.coupling[k][0];
      entries.emplace_back(i, matrix.column[k], -matrix.coupling[k][0]);
    }
    entries.emplace_back(i, i, diagonal);
    right[i] = right_side[i][0];
  }
  a.setFromTriplets(entries.begin(), entries.end());
  Eigen::ConjugateGradient<Eigen::SparseMatrix<double>, Eigen::Lower | Eigen::Upper> solver(a);
  solver.setTolerance(1e-13);
  const Eigen::VectorXd x = solver.solve(right);
  CouplingSolution solution{std::vector<Double4>(n, Double4{}), static_cast<int>(solver.iterations())};
  for (Eigen::Index i = 0; i < n; ++i) solution.values[i][0] = x[i];
  return solution;
}

}  // namespace shellgrid::test
