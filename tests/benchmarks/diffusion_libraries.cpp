// SPDX-License-Identifier: AGPL-3.0-or-later
#include "tests/benchmarks/diffusion_libraries.h"

#include <Eigen/IterativeLinearSolvers>
#include <Eigen/SparseCore>
#include <algorithm>
#include <cmath>
#include <functional>
#include <limits>
#include <memory>
#include <optional>

#include "tests/benchmarks/library_solvers.h"

namespace shellgrid::test {
namespace {

using Matrix = Eigen::SparseMatrix<double>;

// One channel of the system, both halves. Rows of the system ascend, so each column of the matrix does.
Matrix channel_matrix(const CouplingOperator& a, int c) {
  const auto n = static_cast<Eigen::Index>(a.size());
  Matrix matrix(n, n);
  matrix.resizeNonZeros(static_cast<Eigen::Index>(a.column.size()) + n);
  int next = 0;
  for (Eigen::Index i = 0; i < n; ++i) {
    matrix.outerIndexPtr()[i] = next;
    double diagonal = a.reaction[i][c];
    int place = -1;
    for (std::int64_t k = a.row_start[i]; k < a.row_start[i + 1]; ++k) {
      if (place < 0 && a.column[k] > i) place = next++;
      diagonal += a.coupling[k][c];
      matrix.innerIndexPtr()[next] = a.column[k];
      matrix.valuePtr()[next++] = -a.coupling[k][c];
    }
    if (place < 0) place = next++;
    matrix.innerIndexPtr()[place] = static_cast<int>(i);
    matrix.valuePtr()[place] = diagonal;
  }
  matrix.outerIndexPtr()[n] = next;
  return matrix;
}

// One channel of a problem, and how far a solution's exitance is off.
struct Channel {
  Matrix matrix;
  Eigen::VectorXd right_side;
  const DiscreteProblem& problem;
  int number;
  double size = 0;

  Channel(const DiscreteProblem& p, int c)
      : matrix(channel_matrix(p.matrix, c)),
        right_side(static_cast<Eigen::Index>(p.source.size())),
        problem(p),
        number(c) {
    for (std::size_t i = 0; i < p.source.size(); ++i) right_side[static_cast<Eigen::Index>(i)] = p.source[i][c];
    for (const DiscreteProblem::Outlet& o : p.outlets) size += o.area * o.exitance[c] * o.exitance[c];
  }
  double error(const Eigen::VectorXd& x) const {
    double sum = 0;
    for (const DiscreteProblem::Outlet& o : problem.outlets) {
      const double off = o.factor[number] * (x[o.unknown] - problem.fluence[o.unknown][number]);
      sum += o.area * off * off;
    }
    return std::sqrt(sum / size);
  }
};

// The first iteration whose exitance is within each level, and its error; −1 where it is not reached.
struct Iterations {
  std::array<int, error_levels.size()> count;
  std::array<double, error_levels.size()> error{};
  Iterations() { count.fill(-1); }
  bool note(int iteration, double e) {  // whether all are reached
    for (std::size_t l = 0; l < error_levels.size(); ++l)
      if (count[l] < 0 && e <= error_levels[l]) count[l] = iteration, error[l] = e;
    return count.back() >= 0;
  }
};

// What a method took for the channels so far.
struct Tally {
  Seconds setup;
  std::array<Seconds, error_levels.size()> solve{};
  std::array<double, error_levels.size()> error{};
  std::array<std::string, error_levels.size()> note;
  double bytes = 0, application = 0, pass_bytes = 0;
};

void add_application(const Channel& channel, Tally& tally) {
  Eigen::VectorXd x = channel.right_side, y(x.size());
  tally.application += least_time_of(3, [&] { y.noalias() = channel.matrix * x; }).processor;
  tally.pass_bytes += 12.0 * static_cast<double>(channel.matrix.nonZeros()) + 24.0 * static_cast<double>(x.size());
}

void append(const std::string& method, const DiscreteProblem& problem, const Limits& limits, const Tally& tally,
            Table& table) {
  for (std::size_t l = 0; l < error_levels.size(); ++l) {
    Row row;
    row.size = problem.size, row.method = method, row.discretisation = problem.discretisation;
    row.unknowns = problem.source.size();
    row.level = error_levels[l], row.error = tally.error[l];
    row.assembly = problem.assembly;
    row.setup = tally.setup;
    row.solve = tally.solve[l];
    row.bytes = tally.bytes;
    row.application = tally.application;
    row.floor = tally.pass_bytes / limits.triad;
    row.discretisation_error = problem.discretisation_error, row.soft_error = problem.soft_error;
    row.note = tally.note[l];
    table.add(row);
  }
}

// Eigen's loop, step by step, to see after which iteration the exitance is good enough. Source: [Hestenes1952].
template <class Preconditioner>
Iterations observe(const Channel& channel, const Preconditioner& preconditioner, double seconds) {
  Iterations result;
  Eigen::VectorXd x = Eigen::VectorXd::Zero(channel.right_side.size()), r = channel.right_side,
                  p = preconditioner.solve(r), z(x.size()), q(x.size());
  double product = r.dot(p);
  const double start = Seconds::now().processor;
  for (int k = 1; Seconds::now().processor - start < seconds; ++k) {
    q.noalias() = channel.matrix * p;
    const double alpha = product / p.dot(q);
    x += alpha * p;
    r -= alpha * q;
    if (result.note(k, channel.error(x))) break;
    z = preconditioner.solve(r);
    const double before = product;
    product = r.dot(z);
    p = z + product / before * p;
  }
  return result;
}

template <class Preconditioner>
void run_eigen(const std::string& method, const DiscreteProblem& problem, const Limits& limits, Table& table) {
  Tally tally;
  for (int c = 0; c < 3; ++c) {
    const PeakMemory memory;
    const Channel channel(problem, c);
    Eigen::ConjugateGradient<Matrix, Eigen::Lower | Eigen::Upper, Preconditioner> solver;
    tally.setup = tally.setup + time_of([&] { solver.compute(channel.matrix); });
    const Iterations iterations = observe(channel, solver.preconditioner(), limits.seconds);
    const int most = *std::max_element(iterations.count.begin(), iterations.count.end());
    Seconds each;
    if (most > 0) {
      solver.setTolerance(1e-30);
      solver.setMaxIterations(most);
      Eigen::VectorXd x;
      each = time_of([&] { x = solver.solve(channel.right_side); }) * (1.0 / most);
    }
    for (std::size_t l = 0; l < error_levels.size(); ++l) {
      if (iterations.count[l] < 0)
        tally.note[l] = "not reached in " + std::to_string(static_cast<int>(limits.seconds)) + " s a channel";
      tally.solve[l] = tally.solve[l] + each * iterations.count[l];
      tally.error[l] = std::max(tally.error[l], iterations.error[l]);
    }
    tally.bytes = std::max(tally.bytes, memory.bytes());
    add_application(channel, tally);
  }
  append(method, problem, limits, tally, table);
}

void run_hypre(const DiscreteProblem& problem, const Limits& limits, Table& table) {
  Tally tally;
  for (int c = 0; c < 3; ++c) {
    const PeakMemory memory;
    const Channel channel(problem, c);
    const std::unique_ptr<LibrarySolver> solver = hypre_solver();
    tally.setup = tally.setup + time_of([&] { solver->prepare(channel.matrix); });
    Iterations iterations;
    std::array<Seconds, error_levels.size()> took{};
    for (int k = 1; k < 200; ++k) {
      const Iterations before = iterations;
      Eigen::VectorXd x;
      const Seconds s = time_of([&] { x = solver->solve(channel.right_side, 1e-30, k); });
      const bool all = iterations.note(k, channel.error(x));
      for (std::size_t l = 0; l < error_levels.size(); ++l)
        if (iterations.count[l] != before.count[l]) took[l] = s;
      if (all || s.processor > limits.seconds) break;
    }
    for (std::size_t l = 0; l < error_levels.size(); ++l) {
      if (iterations.count[l] < 0) tally.note[l] = "not reached";
      tally.solve[l] = tally.solve[l] + took[l];
      tally.error[l] = std::max(tally.error[l], iterations.error[l]);
    }
    tally.bytes = std::max(tally.bytes, memory.bytes());
    add_application(channel, tally);
  }
  append("hypre BoomerAMG + CG", problem, limits, tally, table);
}

// What CHOLMOD's factors took at the size before, to foretell those of greater ones.
struct FactorHistory {
  double unknowns = 0, operations = 0, bytes = 0, operations_a_second = 1e10;
};

void run_cholmod(const DiscreteProblem& problem, const Limits& limits, Table& table) {
  static std::vector<std::pair<std::string, FactorHistory>> histories;  // by discretisation
  FactorHistory* history = nullptr;
  for (auto& [name, h] : histories)
    if (name == problem.discretisation) history = &h;
  if (!history) history = &histories.emplace_back(problem.discretisation, FactorHistory{}).second;
  Tally tally;
  const auto unknowns = static_cast<double>(problem.source.size());
  // Nested dissection in three dimensions: operations grow with the square, entries with the power 4/3.
  const double growth = history->unknowns > 0 ? unknowns / history->unknowns : 0;
  FactorCost cost{history->operations * growth * growth, history->bytes * std::pow(growth, 4.0 / 3)};
  const auto refuse = [&](const char* how) {
    char note[160];
    std::snprintf(note, sizeof note, "left out: its factor would take %s %.1f GiB and %.0f s a channel", how,
                  cost.bytes / (1 << 30), cost.operations / history->operations_a_second);
    tally.note.fill(note);
    append("CHOLMOD", problem, limits, tally, table);
  };
  const auto too_much = [&] {
    return cost.bytes > limits.bytes || cost.operations / history->operations_a_second > limits.seconds;
  };
  if (too_much()) return refuse("about");
  const std::unique_ptr<FactorSolver> solver = cholmod_solver();
  for (int c = 0; c < 3; ++c) {
    const PeakMemory memory;
    const Channel channel(problem, c);
    if (c == 0) {
      tally.setup = time_of([&] { cost = solver->analyze(channel.matrix); });
      history->unknowns = unknowns, history->operations = cost.operations, history->bytes = cost.bytes;
      if (too_much()) return refuse("by its analysis");
    }
    const Seconds factor = time_of([&] { solver->prepare(channel.matrix); });
    if (c == 0) history->operations_a_second = cost.operations / factor.wall;
    tally.setup = tally.setup + factor;
    Eigen::VectorXd x;
    const Seconds s = time_of([&] { x = solver->solve(channel.right_side, 0, 0); });
    const double error = channel.error(x);
    for (std::size_t l = 0; l < error_levels.size(); ++l) {
      tally.solve[l] = tally.solve[l] + s;
      tally.error[l] = std::max(tally.error[l], error);
    }
    tally.bytes = std::max(tally.bytes, memory.bytes());
    add_application(channel, tally);
  }
  append("CHOLMOD", problem, limits, tally, table);
}

}  // namespace

std::vector<std::vector<Double4>> solve_exactly(const CouplingOperator& system,
                                                const std::vector<std::vector<Double4>>& sources) {
  std::vector<std::vector<Double4>> fluences(sources.size(), std::vector<Double4>(system.size(), Double4{}));
  for (int c = 0; c < 3; ++c) {
    const Matrix matrix = channel_matrix(system, c);
    const std::unique_ptr<LibrarySolver> solver = hypre_solver();
    solver->prepare(matrix);
    for (std::size_t s = 0; s < sources.size(); ++s) {
      Eigen::VectorXd right(matrix.rows());
      for (Eigen::Index i = 0; i < right.size(); ++i) right[i] = sources[s][i][c];
      const Eigen::VectorXd x = solver->solve(right, 1e-9, 0);
      for (Eigen::Index i = 0; i < right.size(); ++i) fluences[s][i][c] = x[i];
    }
  }
  return fluences;
}

void run_libraries(const DiscreteProblem& problem, const Limits& limits, Table& table) {
  // In the unknowns' own order, by place: twice as fast as in Eigen's default one on lattices, the same on tetrahedra.
  run_eigen<Eigen::IncompleteCholesky<double, Eigen::Lower, Eigen::NaturalOrdering<int>>>("CG + incomplete Cholesky",
                                                                                          problem, limits, table);
  run_eigen<Eigen::DiagonalPreconditioner<double>>("CG + Jacobi", problem, limits, table);
  run_hypre(problem, limits, table);
  run_cholmod(problem, limits, table);
}

}  // namespace shellgrid::test
