// SPDX-License-Identifier: AGPL-3.0-or-later
#include "solvers/diffusion/paper_operator.h"

#include <gtest/gtest.h>

#include <algorithm>
#include <array>
#include <cmath>

#include "meshing/core/error.h"
#include "solvers/scattering/fresnel.h"
#include "tests/support/diffusion_problem.h"

namespace shellgrid {
namespace {

constexpr double edge = 10, ior = 1.4;

// κ varies smoothly by e^±variation over the object.
float extinction_at(const Vec3& x, double variation) {
  return static_cast<float>(
      std::exp(variation * std::sin(2 * M_PI * x.x() / edge) * std::cos(2 * M_PI * x.y() / edge)));
}

PaperProblem paper_problem(const Polygrid& grid, double absorption, double variation) {
  const DiffuseFresnel fresnel = diffuse_fresnel(ior);
  PaperProblem problem;
  problem.boundary_factor = fresnel.boundary_factor;
  problem.tolerance = 1e-7;
  for (Eigen::Index i = 0; i < grid.graph.interior.rows(); ++i) {
    problem.diffusion.push_back(Rgb::Constant(1 / (3 * extinction_at(grid.graph.interior.row(i), variation))));
    problem.absorption.push_back(Rgb::Constant(static_cast<float>(absorption)));
  }
  // D2's light, so that both operators solve the same problem at the boundary.
  const auto light = static_cast<float>(4 / (1 - fresnel.fluence_reflectance));
  for (Eigen::Index k = 0; k < grid.graph.boundary.rows(); ++k) {
    problem.boundary_diffusion.push_back(Rgb::Constant(1 / (3 * extinction_at(grid.graph.boundary.row(k), variation))));
    problem.boundary_light.push_back(Rgb::Constant(light));
  }
  return problem;
}

// Relative L2 difference of the fluence at cell centres between the paper's operator and elements.
double difference_to_elements(int n, double variation) {
  const double absorption = 0.01;
  Polygrid grid = test::cube_grid(n, edge, 0.1);
  test::add_cube_graph(grid, n, edge);
  const PaperSolution paper = solve_paper_operator(grid.graph, paper_problem(grid, absorption, variation));
  CellCoefficients coefficients = homogeneous_coefficients(grid, test::grey_material({absorption, 1}));
  for (int cell = 0; cell < grid.cells.rows(); ++cell)
    for (int corner = 0; corner < 8; ++corner)
      coefficients.reduced_extinction[8 * cell + corner] =
          Rgb::Constant(extinction_at(gauss_point(grid, cell, corner), variation));
  const auto elements = test::solve_problem(grid, coefficients, ior, test::uniform_light);
  double error = 0, size = 0;
  for (Eigen::Index i = 0; i < grid.graph.interior.rows(); ++i) {
    double phi = 0;
    for (int a = 0; a < 8; ++a) phi += elements.fluence[elements.system.unknown_of_point[grid.cells(i, a)]][0] / 8;
    error += (paper.interior[i][0] - phi) * (paper.interior[i][0] - phi);
    size += phi * phi;
  }
  return std::sqrt(error / size);
}

TEST(PaperOperator, AgreesWithElementsWhereTheMaterialIsUniform) {
  const double coarse = difference_to_elements(8, 0), fine = difference_to_elements(16, 0);
  EXPECT_LT(fine, 0.01);
  EXPECT_LT(fine, 0.8 * coarse);
}

TEST(PaperOperator, StopsConvergingWhereTheMaterialVaries) {
  const double coarse = difference_to_elements(8, 1), fine = difference_to_elements(16, 1);
  EXPECT_GT(fine, 0.5);  // φ follows 1/κ: no refinement mends it
  EXPECT_GT(fine, 0.85 * coarse);
}

TEST(PaperOperator, ItsRelaxationReachesTheSameSolution) {
  Polygrid grid = test::cube_grid(6, edge, 0.1);
  test::add_cube_graph(grid, 6, edge);
  PaperProblem problem = paper_problem(grid, 0.05, 0.5);
  const PaperSolution fast = solve_paper_operator(grid.graph, problem);
  problem.method = PaperMethod::relaxation;
  const PaperSolution slow = solve_paper_operator(grid.graph, problem);
  EXPECT_GT(slow.iterations, 5 * fast.iterations);
  for (std::size_t i = 0; i < fast.interior.size(); ++i)
    ASSERT_NEAR(fast.interior[i][1], slow.interior[i][1], 1e-4 * fast.interior[i][1]);
}

TEST(PaperOperator, TheHierarchyGivesTheSameSolutionInFewerSteps) {
  Polygrid grid = test::cube_grid(16, edge, 0.1);
  test::add_cube_graph(grid, 16, edge);
  grid.graph.boundary_normal = VertexMatrix::Constant(grid.graph.boundary.rows(), 3, 1);
  grid.hierarchy = build_hierarchy(grid);
  PaperProblem problem = paper_problem(grid, 0.05, 0.5);
  problem.tolerance = 1e-4;
  for (const PaperMethod method : {PaperMethod::bicgstab, PaperMethod::relaxation}) {
    problem.method = method;
    const PaperSolution plain = solve_paper_operator(grid.graph, problem);
    const PaperSolution nested = solve_paper_operator(grid.graph, problem, grid.hierarchy);
    EXPECT_LE(nested.iterations, plain.iterations);
    if (method == PaperMethod::relaxation) {
      EXPECT_LT(nested.iterations, 0.7 * plain.iterations);
    }
    EXPECT_EQ(nested.coarse_iterations.size(), grid.hierarchy.size());
    double difference = 0, size = 0;
    for (std::size_t i = 0; i < plain.interior.size(); ++i) {
      difference += (plain.interior[i] - nested.interior[i]).square().sum();
      size += plain.interior[i].square().sum();
    }
    EXPECT_LT(std::sqrt(difference / size), 2e-2);
  }
  std::vector<PolygridLevel> broken = grid.hierarchy;
  broken[0].parent.pop_back();
  EXPECT_THROW(solve_paper_operator(grid.graph, problem, broken), InputError);
}

// Light from one side; levels of a cube's grid.
struct LitCube {
  Polygrid grid;
  PaperProblem problem;
  explicit LitCube(int n) : grid(test::cube_grid(n, edge, 0.1)) {
    test::add_cube_graph(grid, n, edge);
    grid.graph.boundary_normal = VertexMatrix::Constant(grid.graph.boundary.rows(), 3, 1);
    grid.hierarchy = build_hierarchy(grid);
    problem = paper_problem(grid, 0.02, 0.5);
    for (Eigen::Index k = 0; k < grid.graph.boundary.rows(); ++k)
      if (grid.graph.boundary(k, 2) < 0.9 * edge) problem.boundary_light[k] = Rgb::Zero();
    problem.method = PaperMethod::relaxation;
    problem.tolerance = 1e-6;
  }
  // Relative difference of the boundary's fluence.
  static double difference(const PaperSolution& a, const PaperSolution& b) {
    double error = 0, size = 0;
    for (std::size_t k = 0; k < a.boundary.size(); ++k) {
      error += (a.boundary[k] - b.boundary[k]).square().sum();
      size += b.boundary[k].square().sum();
    }
    return std::sqrt(error / size);
  }
};

TEST(PaperOperator, DeepNodesMayStayOnCoarseLevels) {
  LitCube cube(16);
  const PaperSolution whole = solve_paper_operator(cube.grid.graph, cube.problem, cube.grid.hierarchy);
  EXPECT_EQ(whole.relaxed, 4096u);
  double before = 1;
  for (int depth : {2, 4, 6}) {
    cube.problem.depths = {depth, depth};
    const PaperSolution adaptive = solve_paper_operator(cube.grid.graph, cube.problem, cube.grid.hierarchy);
    const int core = 16 - 2 * depth;
    EXPECT_EQ(adaptive.relaxed, static_cast<std::size_t>(4096 - core * core * core));
    const double error = LitCube::difference(adaptive, whole);
    EXPECT_LT(error, before) << depth;
    before = error;
  }
  EXPECT_LT(before, 0.03);
  EXPECT_GT(before, 1e-6);
  // As deep as the object, all nodes are relaxed.
  cube.problem.depths = {8, 4};
  const PaperSolution all = solve_paper_operator(cube.grid.graph, cube.problem, cube.grid.hierarchy);
  EXPECT_EQ(all.relaxed, 4096u);
  EXPECT_LT(LitCube::difference(all, whole), 1e-3);
  cube.problem.method = PaperMethod::bicgstab;
  EXPECT_THROW(solve_paper_operator(cube.grid.graph, cube.problem, cube.grid.hierarchy), InputError);
}

TEST(PaperOperator, AnEyeOnItsRelaxationSeesEachPass) {
  LitCube cube(8);
  std::array<std::vector<int>, 3> passes;  // of the finest level
  std::array<int, 3> coarse{};
  cube.problem.watch = [&](const PaperPass& pass) {
    if (pass.level == 0)
      passes[pass.channel].push_back(pass.passes);
    else
      ++coarse[pass.channel];
    return false;
  };
  const PaperSolution solution = solve_paper_operator(cube.grid.graph, cube.problem, cube.grid.hierarchy);
  int most = 0;
  for (int c = 0; c < 3; ++c) {
    for (std::size_t k = 0; k < passes[c].size(); ++k) EXPECT_EQ(passes[c][k], static_cast<int>(k));
    most = std::max(most, passes[c].back());
    EXPECT_GT(coarse[c], 0);
  }
  EXPECT_EQ(most, solution.iterations);
  cube.problem.watch = [](const PaperPass& pass) { return pass.level == 0 && pass.passes == 3; };
  EXPECT_EQ(solve_paper_operator(cube.grid.graph, cube.problem, cube.grid.hierarchy).iterations, 3);
}

TEST(PaperOperator, AChannelWithoutLightIsDark) {
  Polygrid grid = test::cube_grid(6, edge, 0.1);
  test::add_cube_graph(grid, 6, edge);
  PaperProblem problem = paper_problem(grid, 0.05, 0.5);
  for (Rgb& light : problem.boundary_light) light[1] = 0;
  for (const PaperMethod method : {PaperMethod::bicgstab, PaperMethod::relaxation}) {
    problem.method = method;
    const PaperSolution solution = solve_paper_operator(grid.graph, problem);
    EXPECT_LE(solution.residual, 1.01 * problem.tolerance);
    for (const Rgb& phi : solution.interior) {
      ASSERT_GT(phi[0], 0);
      ASSERT_EQ(phi[1], 0);
    }
  }
}

TEST(PaperOperator, SaysWhenItDoesNotConvergeAndRefusesBrokenGraphs) {
  Polygrid grid = test::cube_grid(6, edge, 0.1);
  test::add_cube_graph(grid, 6, edge);
  PaperProblem problem = paper_problem(grid, 0, 0);
  problem.method = PaperMethod::relaxation;
  problem.most_iterations = 3;
  EXPECT_THROW(solve_paper_operator(grid.graph, problem), NumericalError);
  PolygridGraph broken = grid.graph;
  broken.links(0, 1) = 216;
  EXPECT_THROW(solve_paper_operator(broken, problem), InputError);
  broken = grid.graph;
  broken.weights(5, 2) = std::nan("");
  EXPECT_THROW(solve_paper_operator(broken, problem), InputError);
  EXPECT_THROW(solve_paper_operator(PolygridGraph{}, problem), InputError);
}

}  // namespace
}  // namespace shellgrid
