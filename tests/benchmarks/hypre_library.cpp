// SPDX-License-Identifier: AGPL-3.0-or-later
#define OMPI_SKIP_MPICXX 1
#include <HYPRE.h>
#include <HYPRE_IJ_mv.h>
#include <HYPRE_krylov.h>
#include <HYPRE_parcsr_ls.h>
#include <mpi.h>

#include <numeric>
#include <stdexcept>
#include <vector>

#include "tests/benchmarks/library_solvers.h"

namespace shellgrid::test {
namespace {

// MPI of one process, from the first use to the program's end.
void start_once() {
  struct Session {
    Session() {
      MPI_Init(nullptr, nullptr);
      HYPRE_Init();
    }
    ~Session() {
      HYPRE_Finalize();
      MPI_Finalize();
    }
  };
  static const Session session;
}

void check(HYPRE_Int code, const char* what) {
  if (code == 0) return;
  HYPRE_ClearAllErrors();
  throw std::runtime_error(what);
}

class HypreSolver : public PreconditionedSolver {
 public:
  HypreSolver() { start_once(); }
  HypreSolver(const HypreSolver&) = delete;
  HypreSolver& operator=(const HypreSolver&) = delete;
  ~HypreSolver() override { clear(); }

  void prepare(const Eigen::SparseMatrix<double>& matrix) override {
    clear();
    size_ = static_cast<HYPRE_BigInt>(matrix.rows());
    rows_.resize(static_cast<std::size_t>(size_));
    std::iota(rows_.begin(), rows_.end(), 0);
    HYPRE_IJMatrixCreate(MPI_COMM_WORLD, 0, size_ - 1, 0, size_ - 1, &matrix_);
    HYPRE_IJMatrixSetObjectType(matrix_, HYPRE_PARCSR);
    HYPRE_IJMatrixInitialize(matrix_);
    // Symmetric: columns are rows.
    std::vector<HYPRE_BigInt> columns;
    for (HYPRE_BigInt row = 0; row < size_; ++row) {
      columns.clear();
      const int first = matrix.outerIndexPtr()[row];
      HYPRE_Int count = matrix.outerIndexPtr()[row + 1] - first;
      for (HYPRE_Int k = 0; k < count; ++k) columns.push_back(matrix.innerIndexPtr()[first + k]);
      HYPRE_IJMatrixSetValues(matrix_, 1, &count, &row, columns.data(), matrix.valuePtr() + first);
    }
    HYPRE_IJMatrixAssemble(matrix_);
    void* object = nullptr;
    HYPRE_IJMatrixGetObject(matrix_, &object);
    parallel_matrix_ = static_cast<HYPRE_ParCSRMatrix>(object);
    right_side_ = vector();
    solution_ = vector();
    HYPRE_BoomerAMGCreate(&amg_);
    HYPRE_BoomerAMGSetCoarsenType(amg_, 10);
    HYPRE_BoomerAMGSetAggNumLevels(amg_, 1);
    HYPRE_BoomerAMGSetInterpType(amg_, 6);
    HYPRE_BoomerAMGSetPMaxElmts(amg_, 4);
    HYPRE_BoomerAMGSetStrongThreshold(amg_, 0.25);
    HYPRE_BoomerAMGSetRelaxType(amg_, 6);
    HYPRE_BoomerAMGSetTol(amg_, 0);
    HYPRE_BoomerAMGSetMaxIter(amg_, 1);
    HYPRE_BoomerAMGSetPrintLevel(amg_, 0);
    HYPRE_ParCSRPCGCreate(MPI_COMM_WORLD, &pcg_);
    HYPRE_PCGSetMaxIter(pcg_, 1000);
    HYPRE_PCGSetTwoNorm(pcg_, 1);
    HYPRE_PCGSetPrecond(pcg_, reinterpret_cast<HYPRE_PtrToSolverFcn>(HYPRE_BoomerAMGSolve),
                        reinterpret_cast<HYPRE_PtrToSolverFcn>(HYPRE_BoomerAMGSetup), amg_);
    check(HYPRE_ParCSRPCGSetup(pcg_, parallel_matrix_, parallel(right_side_), parallel(solution_)),
          "BoomerAMG could not be set up");
  }

  Eigen::VectorXd solve(const Eigen::VectorXd& right_side, double tolerance, int most_iterations) override {
    start_from_zero(right_side);
    HYPRE_PCGSetTol(pcg_, tolerance);
    HYPRE_PCGSetMaxIter(pcg_, most_iterations > 0 ? most_iterations : 1000);
    const HYPRE_Int code = HYPRE_ParCSRPCGSolve(pcg_, parallel_matrix_, parallel(right_side_), parallel(solution_));
    if (most_iterations > 0 && HYPRE_CheckError(code, HYPRE_ERROR_CONV))
      HYPRE_ClearAllErrors();
    else
      check(code, "BoomerAMG with conjugate gradients did not converge");
    return solution();
  }

  Eigen::VectorXd precondition(const Eigen::VectorXd& residual) override {
    start_from_zero(residual);
    HYPRE_BoomerAMGSolve(amg_, parallel_matrix_, parallel(right_side_), parallel(solution_));
    HYPRE_ClearAllErrors();
    return solution();
  }

 private:
  void start_from_zero(const Eigen::VectorXd& right_side) {
    const Eigen::VectorXd zero = Eigen::VectorXd::Zero(right_side.size());
    HYPRE_IJVectorSetValues(right_side_, static_cast<HYPRE_Int>(size_), rows_.data(), right_side.data());
    HYPRE_IJVectorSetValues(solution_, static_cast<HYPRE_Int>(size_), rows_.data(), zero.data());
  }
  Eigen::VectorXd solution() const {
    Eigen::VectorXd x(static_cast<Eigen::Index>(size_));
    HYPRE_IJVectorGetValues(solution_, static_cast<HYPRE_Int>(size_), rows_.data(), x.data());
    return x;
  }
  HYPRE_IJVector vector() const {
    HYPRE_IJVector v = nullptr;
    HYPRE_IJVectorCreate(MPI_COMM_WORLD, 0, size_ - 1, &v);
    HYPRE_IJVectorSetObjectType(v, HYPRE_PARCSR);
    HYPRE_IJVectorInitialize(v);
    HYPRE_IJVectorAssemble(v);
    return v;
  }
  static HYPRE_ParVector parallel(HYPRE_IJVector v) {
    void* object = nullptr;
    HYPRE_IJVectorGetObject(v, &object);
    return static_cast<HYPRE_ParVector>(object);
  }
  void clear() {
    if (!matrix_) return;
    HYPRE_ParCSRPCGDestroy(pcg_);
    HYPRE_BoomerAMGDestroy(amg_);
    HYPRE_IJVectorDestroy(solution_);
    HYPRE_IJVectorDestroy(right_side_);
    HYPRE_IJMatrixDestroy(matrix_);
    matrix_ = nullptr;
  }

  HYPRE_BigInt size_ = 0;
  std::vector<HYPRE_BigInt> rows_;  // 0, 1, …
  HYPRE_IJMatrix matrix_ = nullptr;
  HYPRE_ParCSRMatrix parallel_matrix_ = nullptr;
  HYPRE_IJVector right_side_ = nullptr, solution_ = nullptr;
  HYPRE_Solver amg_ = nullptr, pcg_ = nullptr;
};

}  // namespace

std::unique_ptr<PreconditionedSolver> hypre_solver() { return std::make_unique<HypreSolver>(); }

}  // namespace shellgrid::test
