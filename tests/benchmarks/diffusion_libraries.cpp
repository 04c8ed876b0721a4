// SPDX-License-Identifier: AGPL-3.0-or-later
#include "tests/benchmarks/diffusion_libraries.h"

#include <Eigen/IterativeLinearSolvers>
#include <Eigen/SparseCore>
#include <algorithm>
#include <cmath>
#include <functional>
#include <map>
#include <memory>

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

// Eigen's loop, step by step, to see after which iteration the exitance is good enough; `took`: the time of as many
// iterations, without the looking. Source: [Hestenes1952].
Iterations observe(const Channel& channel, const std::function<Eigen::VectorXd(const Eigen::VectorXd&)>& precondition,
                   double seconds, std::array<Seconds, error_levels.size()>& took) {
  Iterations result;
  Seconds spent, since = Seconds::now();
  Eigen::VectorXd x = Eigen::VectorXd::Zero(channel.right_side.size()), r = channel.right_side, p = precondition(r),
                  z(x.size()), q(x.size());
  double product = r.dot(p);
  for (int k = 1; spent.processor < seconds; ++k) {
    q.noalias() = channel.matrix * p;
    const double alpha = product / p.dot(q);
    x += alpha * p;
    r -= alpha * q;
    spent = spent + (Seconds::now() - since);
    const Iterations before = result;
    const bool all = result.note(k, channel.error(x));
    for (std::size_t l = 0; l < error_levels.size(); ++l)
      if (result.count[l] != before.count[l]) took[l] = spent;
    if (all) break;
    since = Seconds::now();
    z = precondition(r);
    const double last = product;
    product = r.dot(z);
    p = z + product / last * p;
  }
  return result;
}

void add_channel(const Channel& channel, const Iterations& iterations,
                 const std::array<Seconds, error_levels.size()>& took, const PeakMemory& memory, const Limits& limits,
                 Tally& tally) {
  for (std::size_t l = 0; l < error_levels.size(); ++l) {
    if (iterations.count[l] < 0)
      tally.note[l] = "not reached in " + std::to_string(static_cast<int>(limits.seconds)) + " s a channel";
    tally.solve[l] = tally.solve[l] + took[l];
    tally.error[l] = std::max(tally.error[l], iterations.error[l]);
  }
  tally.bytes = std::max(tally.bytes, memory.bytes());
  add_application(channel, tally);
}

template <class Preconditioner>
Tally run_eigen(const DiscreteProblem& problem, const Limits& limits) {
  Tally tally;
  for (int c = 0; c < 3; ++c) {
    const PeakMemory memory;
    const Channel channel(problem, c);
    Eigen::ConjugateGradient<Matrix, Eigen::Lower | Eigen::Upper, Preconditioner> solver;
    tally.setup = tally.setup + time_of([&] { solver.compute(channel.matrix); });
    std::array<Seconds, error_levels.size()> took{};
    const Iterations iterations = observe(
        channel, [&](const Eigen::VectorXd& r) -> Eigen::VectorXd { return solver.preconditioner().solve(r); },
        limits.seconds, took);
    add_channel(channel, iterations, took, memory, limits, tally);
  }
  return tally;
}

Tally run_hypre(const DiscreteProblem& problem, const Limits& limits) {
  Tally tally;
  for (int c = 0; c < 3; ++c) {
    const PeakMemory memory;
    const Channel channel(problem, c);
    const std::unique_ptr<PreconditionedSolver> solver = hypre_solver();
    tally.setup = tally.setup + time_of([&] { solver->prepare(channel.matrix); });
    std::array<Seconds, error_levels.size()> took{};
    const Iterations iterations = observe(
        channel, [&](const Eigen::VectorXd& r) { return solver->precondition(r); }, limits.seconds, took);
    // The library's own loop, as many times as the last level takes.
    const int most = *std::max_element(iterations.count.begin(), iterations.count.end());
    if (most > 0) {
      const Seconds each = time_of([&] { solver->solve(channel.right_side, 1e-30, most); }) * (1.0 / most);
      for (std::size_t l = 0; l < error_levels.size(); ++l) took[l] = each * std::max(0, iterations.count[l]);
    }
    add_channel(channel, iterations, took, memory, limits, tally);
  }
  return tally;
}

// What CHOLMOD's factors took at the size before, to foretell those of greater ones. To begin with: hardly more than
// the least of the three discretisations' on the bunny, so that no great matrix is analysed in vain.
struct FactorHistory {
  double unknowns = 1e6, operations = 1e12, bytes = 3.5e9, operations_a_second = 1e10;
};

Tally run_cholmod(const DiscreteProblem& problem, const Limits& limits) {
  static std::vector<std::pair<std::string, FactorHistory>> histories;  // by discretisation
  FactorHistory* history = nullptr;
  for (auto& [name, h] : histories)
    if (name == problem.discretisation) history = &h;
  if (!history) history = &histories.emplace_back(problem.discretisation, FactorHistory{}).second;
  Tally tally;
  const auto unknowns = static_cast<double>(problem.source.size());
  // Nested dissection in three dimensions: operations grow with the square, entries with the power 4/3.
  const double growth = unknowns / history->unknowns;
  FactorCost cost{history->operations * growth * growth, history->bytes * std::pow(growth, 4.0 / 3)};
  const auto refuse = [&](const char* how) {
    char note[160];
    std::snprintf(note, sizeof note, "left out: its factor would take %s %.1f GiB and %.0f s a channel", how,
                  cost.bytes / (1 << 30), cost.operations / history->operations_a_second);
    tally.note.fill(note);
    return tally;
  };
  const auto too_much = [&] {
    return cost.bytes > limits.bytes || cost.operations / history->operations_a_second > limits.factor_seconds;
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
    if (c == 0) history->operations_a_second = cost.operations / factor.processor;
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
  return tally;
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
      const Eigen::VectorXd x = solver->solve(right, s == 0 ? 1e-8 : 1e-5, 0);
      for (Eigen::Index i = 0; i < right.size(); ++i) fluences[s][i][c] = x[i];
    }
  }
  return fluences;
}

void run_libraries(const DiscreteProblem& problem, const Limits& limits, Table& table) {
  // In the unknowns' own order, by place: twice as fast as in Eigen's default one on lattices, the same on tetrahedra.
  using Cholesky = Eigen::IncompleteCholesky<double, Eigen::Lower, Eigen::NaturalOrdering<int>>;
  struct Method {
    const char* name;
    Tally (*run)(const DiscreteProblem&, const Limits&);
  };
  static constexpr Method methods[] = {{"CG + incomplete Cholesky", run_eigen<Cholesky>},
                                       {"CG + Jacobi", run_eigen<Eigen::DiagonalPreconditioner<double>>},
                                       {"hypre BoomerAMG + CG", run_hypre},
                                       {"CHOLMOD", run_cholmod}};
  static std::map<std::string, const char*> quickest;  // by discretisation, of the size before, to an error of 0.5 %
  const auto before = quickest.find(problem.discretisation);
  const bool one =
      before != quickest.end() && problem.source.size() > limits.all_methods && problem.discretisation != "trilinear";
  const char* best = "";
  double least = 1e300;
  for (const Method& method : methods) {
    Tally tally;
    if (one && before->second != std::string(method.name)) {
      tally.note.fill(std::string("left out: slower at the size before than ") + before->second);
    } else {
      tally = method.run(problem, limits);
      const std::size_t level = 3;
      static_assert(error_levels[level] == 0.005);
      const double took = tally.setup.processor + tally.solve[level].processor;
      if (tally.note[level].empty() && took < least) least = took, best = method.name;
    }
    append(method.name, problem, limits, tally, table);
  }
  if (*best) quickest[problem.discretisation] = best;
}

}  // namespace shellgrid::test
