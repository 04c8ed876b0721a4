// SPDX-License-Identifier: AGPL-3.0-or-later
#include <Eigen/CholmodSupport>

#include "tests/benchmarks/library_solvers.h"

namespace shellgrid::test {
namespace {

class CholmodSolver : public LibrarySolver {
 public:
  void prepare(const Eigen::SparseMatrix<double>& matrix) override { factor_.compute(matrix); }
  Eigen::VectorXd solve(const Eigen::VectorXd& right_side, double) override { return factor_.solve(right_side); }

 private:
  Eigen::CholmodSupernodalLLT<Eigen::SparseMatrix<double>> factor_;
};

}  // namespace

std::unique_ptr<LibrarySolver> cholmod_solver() { return std::make_unique<CholmodSolver>(); }

}  // namespace shellgrid::test
