// SPDX-License-Identifier: AGPL-3.0-or-later
#include "solvers/diffusion/paper_operator.h"

#include <Eigen/IterativeLinearSolvers>
#include <Eigen/SparseCore>
#include <algorithm>
#include <cmath>
#include <string>

#include "meshing/core/error.h"
#include "meshing/core/parallel.h"

namespace shellgrid {
namespace {

using SparseMatrix = Eigen::SparseMatrix<double, Eigen::RowMajor>;

struct ChannelSystem {
  SparseMatrix matrix;    // of ψ = κφ at interior nodes, boundary nodes eliminated
  Eigen::VectorXd light;  // right-hand side
};

void check(const PolygridGraph& graph, const PaperProblem& problem) {
  const auto n = static_cast<std::size_t>(graph.interior.rows()), b = static_cast<std::size_t>(graph.boundary.rows());
  if (n == 0 || b == 0) throw InputError("polygrid: its graph has no nodes");
  if (static_cast<std::size_t>(graph.links.rows()) != n || static_cast<std::size_t>(graph.weights.rows()) != n ||
      graph.boundary_owner.size() != b || graph.boundary_distance.size() != b || problem.diffusion.size() != n ||
      problem.absorption.size() != n || problem.boundary_diffusion.size() != b || problem.boundary_light.size() != b)
    throw InputError("polygrid: its graph's arrays differ in length");
  for (Eigen::Index k = 0; k < graph.links.size(); ++k) {
    const std::int64_t link = graph.links.data()[k];
    if (link >= static_cast<std::int64_t>(n) || -1 - link >= static_cast<std::int64_t>(b))
      throw InputError("polygrid: a link of its graph is out of range");
  }
  if (!graph.weights.allFinite()) throw InputError("polygrid: a weight of its graph is not finite");
  for (double distance : graph.boundary_distance)
    if (!(distance > 0)) throw InputError("polygrid: a boundary node of its graph lies on its interior node");
}

// ψ_b = offset + factor ψ_owner. Source: [Diffusion eq. 9, second line; §5.2].
void boundary_relation(const PolygridGraph& graph, const PaperProblem& problem, std::int64_t b, int c, double& offset,
                       double& factor) {
  const double kappa = problem.boundary_diffusion[b][c];
  const double owner_kappa = problem.diffusion[graph.boundary_owner[b]][c];
  const double slope = 2 * problem.boundary_factor * kappa / graph.boundary_distance[b];
  offset = kappa * problem.boundary_light[b][c] / (1 + slope);
  factor = kappa / owner_kappa * slope / (1 + slope);
}

ChannelSystem assemble(const PolygridGraph& graph, const PaperProblem& problem, int c) {
  const Eigen::Index n = graph.interior.rows();
  ChannelSystem system;
  system.light = Eigen::VectorXd::Zero(n);
  std::vector<Eigen::Triplet<double>> entries;
  entries.reserve(7 * n);
  for (Eigen::Index i = 0; i < n; ++i) {
    double diagonal = problem.absorption[i][c] / problem.diffusion[i][c];
    for (int k = 0; k < 6; ++k) {
      const double weight = graph.weights(i, k);
      const std::int64_t link = graph.links(i, k);
      diagonal += weight;
      if (link >= 0) {
        entries.emplace_back(i, link, -weight);
      } else {
        double offset, factor;
        boundary_relation(graph, problem, -1 - link, c, offset, factor);
        const std::int32_t owner = graph.boundary_owner[-1 - link];
        if (owner == i)
          diagonal -= weight * factor;
        else
          entries.emplace_back(i, owner, -weight * factor);
        system.light[i] += weight * offset;
      }
    }
    entries.emplace_back(i, i, diagonal);
  }
  system.matrix.resize(n, n);
  system.matrix.setFromTriplets(entries.begin(), entries.end());
  return system;
}

struct ChannelSolution {
  Eigen::VectorXd psi;
  int iterations = 0;
  double residual = 1;  // before the last iteration where it was stopped
  bool stopped = false;
  std::vector<double> history;
};

ChannelSolution solve_bicgstab(const ChannelSystem& system, const PaperProblem& problem, const Eigen::VectorXd& start) {
  Eigen::BiCGSTAB<SparseMatrix, Eigen::IncompleteLUT<double>> solver;
  solver.preconditioner().setDroptol(1e-3);
  solver.preconditioner().setFillfactor(4);
  solver.setTolerance(problem.tolerance);
  solver.setMaxIterations(problem.most_iterations);
  solver.compute(system.matrix);
  ChannelSolution solution;
  if (solver.info() != Eigen::Success) throw NumericalError("paper's operator: incomplete factorisation failed");
  solution.psi = solver.solveWithGuess(system.light, start);
  solution.iterations = static_cast<int>(solver.iterations());
  return solution;
}

// The interior nodes at most `depth` links below the boundary, ascending; the first layer has the depth 1.
std::vector<std::int32_t> nodes_within(const PolygridGraph& graph, int depth) {
  std::vector<char> taken(static_cast<std::size_t>(graph.interior.rows()), 0);
  std::vector<std::int32_t> layer, nodes;
  for (std::int32_t owner : graph.boundary_owner)
    if (!taken[owner]) taken[owner] = 1, layer.push_back(owner);
  for (int d = 1; d <= depth && !layer.empty(); ++d) {
    nodes.insert(nodes.end(), layer.begin(), layer.end());
    std::vector<std::int32_t> below;
    for (std::int32_t i : layer)
      for (int k = 0; k < 6; ++k)
        if (const std::int32_t j = graph.links(i, k); j >= 0 && !taken[j]) taken[j] = 1, below.push_back(j);
    layer = std::move(below);
  }
  std::sort(nodes.begin(), nodes.end());
  return nodes;
}

// The update of the radiance buffer at all nodes, or at `active` ones where `some`. Source: [Diffusion §5.2].
ChannelSolution relax(const ChannelSystem& system, const PaperProblem& problem, const Eigen::VectorXd& start, bool some,
                      const std::vector<std::int32_t>& active, int level, int channel) {
  ChannelSolution solution;
  const Eigen::VectorXd inverse_diagonal = system.matrix.diagonal().cwiseInverse();
  const double size = system.light.norm();
  const auto count = some ? static_cast<Eigen::Index>(active.size()) : system.light.size();
  Eigen::VectorXd change(count);
  solution.psi = start;
  const int* row_start = system.matrix.outerIndexPtr();
  const int* column = system.matrix.innerIndexPtr();
  const double* value = system.matrix.valuePtr();
  for (;; ++solution.iterations) {
    if (problem.watch)
      solution.stopped = problem.watch({level, channel, solution.iterations, solution.residual, solution.psi});
    if (solution.stopped && !solution.history.empty()) break;
    double sum = 0;
    for (Eigen::Index k = 0; k < count; ++k) {
      const Eigen::Index i = some ? active[k] : k;
      double residual = system.light[i];
      for (int m = row_start[i]; m < row_start[i + 1]; ++m) residual -= value[m] * solution.psi[column[m]];
      change[k] = inverse_diagonal[i] * residual;
      sum += residual * residual;
    }
    solution.residual = std::sqrt(sum) / size;
    solution.history.push_back(solution.residual);
    if (!(solution.residual > problem.tolerance) || solution.iterations == problem.most_iterations) break;
    if (solution.residual > 1e6) throw NumericalError("paper's operator: its relaxation diverges on this grid");
    if (some)
      for (Eigen::Index k = 0; k < count; ++k) solution.psi[active[k]] += change[k];
    else
      solution.psi += change;
  }
  return solution;
}

// The same problem on the next coarser level. Source: [Diffusion §5.3].
PaperProblem coarsen(const PaperProblem& problem, const PolygridLevel& level) {
  const auto nodes = static_cast<std::size_t>(level.graph.interior.rows());
  const std::size_t boundary = level.graph.boundary_owner.size();
  const Rgb zero = Rgb::Zero();
  PaperProblem coarse;
  coarse.boundary_factor = problem.boundary_factor;
  coarse.tolerance = problem.tolerance;
  coarse.most_iterations = problem.most_iterations;
  coarse.method = problem.method;
  if (!problem.depths.empty()) coarse.depths.assign(problem.depths.begin() + 1, problem.depths.end());
  coarse.watch = problem.watch;
  coarse.diffusion = average_children(level.parent, nodes, problem.diffusion, zero);
  coarse.absorption = average_children(level.parent, nodes, problem.absorption, zero);
  coarse.boundary_diffusion = average_children(level.boundary_parent, boundary, problem.boundary_diffusion, zero);
  coarse.boundary_light = average_children(level.boundary_parent, boundary, problem.boundary_light, zero);
  return coarse;
}

PaperSolution solve_level(const PolygridGraph& graph, const PaperProblem& problem,
                          std::span<const PolygridLevel> levels, int number) {
  check(graph, problem);
  const Eigen::Index n = graph.interior.rows(), b = graph.boundary.rows();
  PaperSolution result;
  std::vector<Rgb> start(n, Rgb::Zero());
  bool has_start = false;
  if (!levels.empty()) {
    const PolygridLevel& level = levels.front();
    if (static_cast<Eigen::Index>(level.parent.size()) != n ||
        static_cast<Eigen::Index>(level.boundary_parent.size()) != b)
      throw InputError("polygrid: its hierarchy does not match its graph");
    try {
      PaperSolution coarse = solve_level(level.graph, coarsen(problem, level), levels.subspan(1), number + 1);
      for (Eigen::Index i = 0; i < n; ++i) start[i] = coarse.interior[level.parent[i]];
      result.coarse_iterations = std::move(coarse.coarse_iterations);
      result.coarse_iterations.push_back(coarse.iterations);
      has_start = true;
    } catch (const NumericalError&) {
      // A level too coarse for the paper's operator gives no start.
    }
  }
  const bool some = has_start && !problem.depths.empty() && problem.depths[0] > 0;
  const std::vector<std::int32_t> active = some ? nodes_within(graph, problem.depths[0]) : std::vector<std::int32_t>{};
  result.relaxed = some ? active.size() : static_cast<std::size_t>(n);
  result.interior.assign(n, Rgb::Zero());
  result.boundary.assign(b, Rgb::Zero());
  ChannelSolution channels[3];
  parallel_for(
      3,
      [&](std::size_t channel) {
        const int c = static_cast<int>(channel);
        const ChannelSystem system = assemble(graph, problem, c);
        ChannelSolution& solution = channels[c];
        const double size = system.light.norm();
        if (size == 0) {
          solution.psi = Eigen::VectorXd::Zero(n);
          solution.residual = 0;
        } else {
          Eigen::VectorXd psi(n);
          for (Eigen::Index i = 0; i < n; ++i) psi[i] = problem.diffusion[i][c] * start[i][c];
          if (problem.method == PaperMethod::bicgstab) {
            solution = solve_bicgstab(system, problem, psi);
            solution.residual = (system.light - system.matrix * solution.psi).norm() / size;
          } else {
            solution = relax(system, problem, psi, some, active, number, c);
          }
        }
        for (Eigen::Index i = 0; i < n; ++i)
          result.interior[i][c] = static_cast<float>(solution.psi[i] / problem.diffusion[i][c]);
        for (Eigen::Index k = 0; k < b; ++k) {
          double offset, factor;
          boundary_relation(graph, problem, k, c, offset, factor);
          result.boundary[k][c] = static_cast<float>((offset + factor * solution.psi[graph.boundary_owner[k]]) /
                                                     problem.boundary_diffusion[k][c]);
        }
      },
      1);
  for (const ChannelSolution& solution : channels) {
    if (!std::isfinite(solution.residual) || (!solution.stopped && solution.residual > 1.01 * problem.tolerance))
      throw NumericalError("paper's operator: no convergence to " + std::to_string(problem.tolerance) + " after " +
                           std::to_string(solution.iterations) + " iterations; relative residual " +
                           std::to_string(solution.residual));
    result.iterations = std::max(result.iterations, solution.iterations);
    result.residual = std::max(result.residual, solution.residual);
    if (solution.history.size() > result.residual_history.size()) result.residual_history = solution.history;
  }
  if (result.residual_history.empty()) result.residual_history = {1.0, result.residual};
  return result;
}

}  // namespace

PaperProblem paper_problem(const Polygrid& polygrid, const CellCoefficients& coefficients,
                           const std::vector<Rgb>& irradiance) {
  const Eigen::Index cores = polygrid.graph.interior.rows(), quads = polygrid.boundary_quads.rows();
  if (cores + quads != polygrid.cells.rows() || polygrid.graph.boundary.rows() != quads)
    throw InputError("polygrid: its graph does not match its cells");
  const auto diffusion = [&](Eigen::Index cell) -> Rgb {
    Rgb sum = Rgb::Zero();
    for (int k = 0; k < 8; ++k) sum += 1 / (24 * coefficients.reduced_extinction[8 * cell + k]);
    return sum;
  };
  // Interior node i is the centre of core cell i, boundary node k belongs to boundary quad k and the k-th layer cell.
  PaperProblem problem;
  for (Eigen::Index i = 0; i < cores; ++i) {
    problem.diffusion.push_back(diffusion(i));
    Rgb absorption = Rgb::Zero();
    for (int k = 0; k < 8; ++k) absorption += coefficients.absorption[8 * i + k];
    problem.absorption.push_back(absorption / 8);
  }
  for (Eigen::Index k = 0; k < quads; ++k) {
    problem.boundary_diffusion.push_back(diffusion(cores + k));
    Rgb light = Rgb::Zero();
    for (int a = 0; a < 4; ++a) light += irradiance[polygrid.boundary_quads(k, a)] / 4;
    problem.boundary_light.push_back(light);
  }
  return problem;
}

PaperSolution solve_paper_operator(const PolygridGraph& graph, const PaperProblem& problem,
                                   std::span<const PolygridLevel> levels) {
  if (!problem.depths.empty() && problem.method != PaperMethod::relaxation)
    throw InputError("paper's operator: depths are for its relaxation");
  return solve_level(graph, problem, levels, 0);
}

}  // namespace shellgrid
