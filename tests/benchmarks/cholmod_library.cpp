// SPDX-License-Identifier: AGPL-3.0-or-later
#include <Eigen/CholmodSupport>

#include "tests/benchmarks/library_solvers.h"

namespace shellgrid::test {
namespace {

class CholmodSolver : public FactorSolver {
 public:
  FactorCost analyze(const Eigen::SparseMatrix<double>& matrix) override {
    factor_.analyzePattern(matrix);
    return {factor_.cholmod().fl, 8 * factor_.cholmod().lnz};
  }
  void prepare(const Eigen::SparseMatrix<double>& matrix) override { factor_.factorize(matrix); }
  Eigen::VectorXd solve(const Eigen::VectorXd& right_side, double, int) override { return factor_.solve(right_side); }

 private:
  Eigen::CholmodSupernodalLLT<Eigen::SparseMatrix<double>> factor_;
};

}  // namespace

std::unique_ptr<FactorSolver> cholmod_solver() { return std::make_unique<CholmodSolver>(); }

}  // namespace shellgrid::test
