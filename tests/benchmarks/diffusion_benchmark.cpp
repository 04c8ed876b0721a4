// SPDX-License-Identifier: AGPL-3.0-or-later
// Diffusion, red, green and blue: seconds against the exitance's algebraic error, on one cube of n³ cells with a
// heterogeneous material. Methods: this project's multigrid, Eigen's conjugate gradients (incomplete Cholesky;
// Jacobi), hypre's BoomerAMG with conjugate gradients and CHOLMOD on the same matrix, and the 2008 paper's operator by
// its own relaxation, against its own exact solution. `ratio` is the method's total time over this project's at the
// first error at least as small, in the same run.
#include <Eigen/IterativeLinearSolvers>
#include <Eigen/SparseCore>
#include <algorithm>
#include <cmath>
#include <cstdio>
#include <string>

#include "solvers/diffusion/paper_operator.h"
#include "tests/benchmarks/library_solvers.h"
#include "tests/support/diffusion_problem.h"
#include "tests/support/timing.h"

using namespace shellgrid;

namespace {

constexpr double edge = 40, ior = 1.5;
constexpr int repetitions = 3;

struct Row {
  std::string method;
  std::size_t unknowns;
  double assembly, setup, solve, error;
};

double relative_difference(const std::vector<double>& weight, const std::vector<Double4>& a,
                           const std::vector<Double4>& b) {
  double worst = 0;
  for (int c = 0; c < 3; ++c) {
    double error = 0, size = 0;
    for (std::size_t i = 0; i < a.size(); ++i) {
      error += weight[i] * (a[i][c] - b[i][c]) * (a[i][c] - b[i][c]);
      size += weight[i] * b[i][c] * b[i][c];
    }
    worst = std::max(worst, std::sqrt(error / size));
  }
  return worst;
}

Eigen::SparseMatrix<double> channel_matrix(const CouplingOperator& a, int c) {
  std::vector<Eigen::Triplet<double>> entries;
  for (std::size_t i = 0; i < a.size(); ++i) {
    double diagonal = a.reaction[i][c];
    for (std::int64_t k = a.row_start[i]; k < a.row_start[i + 1]; ++k) {
      diagonal += a.coupling[k][c];
      entries.emplace_back(static_cast<int>(i), a.column[k], -a.coupling[k][c]);
    }
    entries.emplace_back(static_cast<int>(i), static_cast<int>(i), diagonal);
  }
  Eigen::SparseMatrix<double> matrix(static_cast<Eigen::Index>(a.size()), static_cast<Eigen::Index>(a.size()));
  matrix.setFromTriplets(entries.begin(), entries.end());
  return matrix;
}

template <class Preconditioner>
void run_eigen(const std::string& name, const PolygridSystem& system, double assembly,
               const std::vector<Double4>& source, const std::vector<Double4>& irradiance,
               const std::vector<Double4>& exact, std::vector<Row>& rows) {
  const Eigen::Index n = static_cast<Eigen::Index>(source.size());
  Eigen::SparseMatrix<double> matrix[3];
  for (int c = 0; c < 3; ++c) matrix[c] = channel_matrix(system.matrix, c);
  Eigen::ConjugateGradient<Eigen::SparseMatrix<double>, Eigen::Lower | Eigen::Upper, Preconditioner> solver[3];
  const double setup = test::median_seconds(repetitions, [&] {
    for (int c = 0; c < 3; ++c) solver[c].compute(matrix[c]);
  });
  for (double tolerance : {1e-2, 1e-3, 1e-4, 1e-6}) {
    std::vector<Double4> fluence(n, Double4{});
    const double solve = test::median_seconds(repetitions, [&] {
      for (int c = 0; c < 3; ++c) {
        Eigen::VectorXd right(n);
        for (Eigen::Index i = 0; i < n; ++i) right[i] = source[i][c];
        solver[c].setTolerance(tolerance);
        const Eigen::VectorXd x = solver[c].solve(right);
        for (Eigen::Index i = 0; i < n; ++i) fluence[i][c] = x[i];
      }
    });
    rows.push_back({name, source.size(), assembly, setup, solve,
                    relative_difference(system.boundary_area, boundary_exitance(system, fluence, irradiance), exact)});
  }
}

void run_library(const std::string& name, std::unique_ptr<test::LibrarySolver> (*make)(),
                 const std::vector<double>& tolerances, const PolygridSystem& system, double assembly,
                 const std::vector<Double4>& source, const std::vector<Double4>& irradiance,
                 const std::vector<Double4>& exact, std::vector<Row>& rows) {
  const Eigen::Index n = static_cast<Eigen::Index>(source.size());
  std::unique_ptr<test::LibrarySolver> solver[3];
  double setup = 0;
  for (int c = 0; c < 3; ++c) {
    const Eigen::SparseMatrix<double> matrix = channel_matrix(system.matrix, c);
    solver[c] = make();
    setup += test::median_seconds(1, [&] { solver[c]->prepare(matrix); });
  }
  for (double tolerance : tolerances) {
    std::vector<Double4> fluence(n, Double4{});
    const double solve = test::median_seconds(repetitions, [&] {
      for (int c = 0; c < 3; ++c) {
        Eigen::VectorXd right(n);
        for (Eigen::Index i = 0; i < n; ++i) right[i] = source[i][c];
        const Eigen::VectorXd x = solver[c]->solve(right, tolerance);
        for (Eigen::Index i = 0; i < n; ++i) fluence[i][c] = x[i];
      }
    });
    rows.push_back({name, source.size(), assembly, setup, solve,
                    relative_difference(system.boundary_area, boundary_exitance(system, fluence, irradiance), exact)});
  }
}

void run_relaxation(const Polygrid& grid, const CellCoefficients& coefficients, std::vector<Row>& rows) {
  PaperProblem problem;
  problem.boundary_factor = 3.96;
  const Eigen::Index cores = grid.graph.interior.rows();
  for (Eigen::Index i = 0; i < cores; ++i) {
    problem.diffusion.push_back(1 / (3 * coefficients.reduced_extinction[8 * i]));
    problem.absorption.push_back(coefficients.absorption[8 * i]);
  }
  for (Eigen::Index k = 0; k < grid.graph.boundary.rows(); ++k) {
    problem.boundary_diffusion.push_back(problem.diffusion[grid.graph.boundary_owner[k]]);
    problem.boundary_light.push_back(Rgb::Constant(grid.graph.boundary(k, 2) > 0.5 * edge ? 1.0f : 0.0f));
  }
  problem.tolerance = 1e-9;
  const PaperSolution exact = solve_paper_operator(grid.graph, problem);
  problem.method = PaperMethod::relaxation;
  for (double tolerance : {1e-2, 1e-3, 1e-4}) {
    problem.tolerance = tolerance;
    PaperSolution solution;
    const double solve =
        test::median_seconds(repetitions, [&] { solution = solve_paper_operator(grid.graph, problem); });
    double error = 0, size = 0;
    for (std::size_t k = 0; k < exact.boundary.size(); ++k) {
      const Rgb light = problem.boundary_light[k];
      error += (solution.boundary[k] - exact.boundary[k]).square().sum();
      size += (exact.boundary[k] - light).square().sum();
    }
    rows.push_back({"paper relaxation", static_cast<std::size_t>(cores), 0, 0, solve, std::sqrt(error / size)});
  }
}

void run_grid(int n) {
  Polygrid grid = test::cube_grid(n, edge, 0.1);
  test::add_cube_graph(grid, n, edge);
  Material marble;
  marble = Material::from_absorption_scattering(Rgb(0.0021f, 0.0041f, 0.0071f), Rgb(2.19f, 2.62f, 3.0f), Rgb::Zero());
  CellCoefficients coefficients = homogeneous_coefficients(grid, marble);
  test::add_contrast(coefficients, 10);
  PolygridSystem system;
  const double assembly =
      test::median_seconds(repetitions, [&] { system = assemble_polygrid_system(grid, coefficients, ior); });
  std::vector<Double4> irradiance(system.key.size(), Double4{});
  for (std::size_t u = 0; u < irradiance.size(); ++u)
    if (system.boundary_area[u] > 0 && grid.points(system.point_of_unknown[u], 2) > 0.5 * edge)
      irradiance[u] = Double4{1, 1, 1, 0};
  const std::vector<Double4> source = boundary_source(system, irradiance);

  std::vector<Row> rows;
  DiffusionSolver solver(grid);
  solver.set_material(coefficients, ior, 1e-11);
  DiffusionLight light;
  for (std::int32_t point : solver.grid().outer_point)
    light.irradiance.push_back(to_float(irradiance[system.unknown_of_point[point]]));
  const auto exitance = [&] {
    std::vector<Double4> result(source.size(), Double4{});
    const std::vector<Double4> own = solver.exitance(light);
    for (std::size_t s = 0; s < own.size(); ++s) result[system.unknown_of_point[solver.grid().outer_point[s]]] = own[s];
    return result;
  };
  solver.solve(light, 1e-11);
  const std::vector<Double4> exact = exitance();
  for (double tolerance : {5e-2, 5e-3, 1e-4, 1e-6}) {
    const double setup = test::median_seconds(repetitions, [&] { solver.set_material(coefficients, ior, tolerance); });
    const double solve = test::median_seconds(repetitions, [&] { solver.solve(light, tolerance); });
    rows.push_back(
        {"multigrid", source.size(), 0, setup, solve, relative_difference(system.boundary_area, exitance(), exact)});
  }
  const std::size_t own = rows.size();
  run_eigen<Eigen::IncompleteCholesky<double>>("CG + incomplete Cholesky", system, assembly, source, irradiance, exact,
                                               rows);
  run_eigen<Eigen::DiagonalPreconditioner<double>>("CG + Jacobi", system, assembly, source, irradiance, exact, rows);
  run_library("hypre BoomerAMG + CG", test::hypre_solver, {1e-2, 1e-3, 1e-4, 1e-6}, system, assembly, source,
              irradiance, exact, rows);
  run_library("CHOLMOD", test::cholmod_solver, {0}, system, assembly, source, irradiance, exact, rows);
  run_relaxation(grid, coefficients, rows);
  for (const Row& row : rows) {
    double own_seconds = rows[own - 1].setup + rows[own - 1].solve;
    for (std::size_t k = own; k-- > 0;)
      if (rows[k].error <= row.error) own_seconds = rows[k].setup + rows[k].solve;
    std::printf("%s,%zu,%.4f,%.4f,%.4f,%.3e,%.2f\n", row.method.c_str(), row.unknowns, row.assembly, row.setup,
                row.solve, row.error, (row.assembly + row.setup + row.solve) / own_seconds);
    std::fflush(stdout);
  }
}

}  // namespace

int main(int argc, char** argv) {
  std::printf("method,unknowns,assembly_s,setup_s,solve_s,exitance_error,ratio\n");
  const bool only_small = argc > 1 && std::string(argv[1]) == "--short";
  run_grid(16);
  if (!only_small) run_grid(44);
}
