// SPDX-License-Identifier: AGPL-3.0-or-later
// Linear solvers of other libraries behind one face, to compare with.
#pragma once
#include <Eigen/SparseCore>
#include <memory>

namespace shellgrid::test {

class LibrarySolver {
 public:
  virtual ~LibrarySolver() = default;
  // Of a symmetric positive definite matrix, both halves stored.
  virtual void prepare(const Eigen::SparseMatrix<double>& matrix) = 0;
  // `tolerance`: of the residual's norm over the right-hand side's, where the solver iterates. `most_iterations`: what
  // it has reached after so many is taken as well; 0: the tolerance must be reached.
  virtual Eigen::VectorXd solve(const Eigen::VectorXd& right_side, double tolerance, int most_iterations) = 0;
};

// What a factorisation takes.
struct FactorCost {
  double operations = 0, bytes = 0;
};
class FactorSolver : public LibrarySolver {
 public:
  // Orders the unknowns; `prepare` then takes matrices of the same pattern.
  virtual FactorCost analyze(const Eigen::SparseMatrix<double>& matrix) = 0;
};

// Conjugate gradients with a preconditioner that can be had alone.
class PreconditionedSolver : public LibrarySolver {
 public:
  virtual Eigen::VectorXd precondition(const Eigen::VectorXd& residual) = 0;
};

// CHOLMOD's supernodal factorisation.
std::unique_ptr<FactorSolver> cholmod_solver();
// hypre: conjugate gradients around one V-cycle of BoomerAMG (HMIS coarsening, aggressive on the first level,
// extended+i interpolation, symmetric hybrid Gauss–Seidel).
std::unique_ptr<PreconditionedSolver> hypre_solver();

}  // namespace shellgrid::test
