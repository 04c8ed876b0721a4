// SPDX-License-Identifier: AGPL-3.0-or-later
#include "solvers/diffusion/composite_grid.h"

#include <gtest/gtest.h>

#include "tests/support/diffusion_problem.h"

namespace shellgrid {
namespace {

Double4 lamp(const Vec3& p) { return Double4{p.z() > 0 ? p.z() : 0.0, 1, p.x() > 2 ? 1.0 : 0.0, 0}; }

SolverParameters at_depth(int depth) {
  SolverParameters parameters;
  parameters.depth = depth;
  return parameters;
}

TEST(CompositeGrid, CellsStandForTheirChildrenOnlyAsDeepAsAsked) {
  const Polygrid grid = test::ball_grid(40, 10, 0.1);
  std::vector<char> near(grid.points.rows(), 0);
  for (Eigen::Index p = 0; p < grid.points.rows(); ++p)
    if (grid.outer_twin[p] >= 0) near[p] = near[grid.outer_twin[p]] = 1;
  std::size_t last = static_cast<std::size_t>(grid.points.rows());
  for (int depth = 1; depth <= 4; ++depth) {
    const LevelHierarchy hierarchy = build_levels(grid, 400, depth);
    EXPECT_GT(hierarchy.skipped, 0u);
    EXPECT_LT(hierarchy.skipped, last);
    last = hierarchy.skipped;
    EXPECT_EQ(hierarchy.levels[0].size() + hierarchy.skipped, static_cast<std::size_t>(grid.points.rows()));
    // Grow from the surface by 2 depth layers of cells: all of these points are unknowns.
    std::vector<char> reached = near;
    for (int layer = 0; layer < 2 * depth; ++layer) {
      const std::vector<char> before = reached;
      for (Eigen::Index c = 0; c < grid.cells.rows(); ++c) {
        bool touches = false;
        for (int a = 0; a < 8; ++a) touches = touches || before[grid.cells(c, a)];
        for (int a = 0; a < 8 && touches; ++a) reached[grid.cells(c, a)] = 1;
      }
    }
    for (Eigen::Index p = 0; p < grid.points.rows(); ++p) {
      if (reached[p] && grid.outer_twin[p] < 0) {
        EXPECT_GE(hierarchy.levels[0].layout.unknown_of[p], 0);
      }
    }
  }
  EXPECT_EQ(build_levels(grid, 400, 0).skipped, 0u);
}

TEST(CompositeGrid, TheExitanceStaysWithinItsEstimate) {
  const Polygrid grid = test::ball_grid(40, 10, 0.1);
  for (double absorption : {0.0, 0.01, 0.3})
    for (double contrast : {1.0, 10.0}) {
      if (contrast > 1 && absorption > 0.1) continue;
      CellCoefficients coefficients = homogeneous_coefficients(grid, test::grey_material({absorption, 1}));
      if (contrast > 1) test::add_contrast(coefficients, contrast);
      DiffusionSolver whole(grid);
      whole.set_material(coefficients, 1.5, 1e-9);
      const DiffusionLight light = test::light_of(whole, grid, lamp);
      whole.solve(light, 1e-9);
      const std::vector<Double4> exact = whole.exitance(light);
      double last = 1;
      for (int depth = 1; depth <= 3; ++depth) {
        DiffusionSolver deep(grid, at_depth(depth));
        deep.set_material(coefficients, 1.5, 0.005);
        const SolveReport report = deep.solve(light, 0.03);
        EXPECT_GT(report.skipped, 0u);
        EXPECT_LE(test::exitance_difference(whole, deep.exitance(light), exact), report.estimated_error) << depth;
        EXPECT_LT(report.deep_error, last);
        last = report.deep_error;
        for (int c = 0; c < 3; ++c) EXPECT_LT(deep.energy(light).relative_defect[c], 1e-12);
      }
    }
}

TEST(CompositeGrid, TheWholeFluenceComesOut) {
  const Polygrid grid = test::ball_grid(32, 10, 0.1);
  const CellCoefficients coefficients = homogeneous_coefficients(grid, test::grey_material({0.002, 1}));
  DiffusionSolver whole(grid), deep(grid, at_depth(2));
  std::vector<Double4> fluence[2];
  for (DiffusionSolver* solver : {&whole, &deep}) {
    solver->set_material(coefficients, 1.5, 0.001);
    solver->solve(test::light_of(*solver, grid, lamp), 0.001);
    fluence[solver == &deep] = solver->fluence();
  }
  // Where the ball's cells are bent, deep points lie off the places that their leaves interpolate.
  for (int c = 0; c < 3; ++c) {
    double size = 0;
    for (const Double4& phi : fluence[0]) size = std::max(size, phi[c]);
    for (std::size_t p = 0; p < fluence[0].size(); ++p) ASSERT_NEAR(fluence[1][p][c], fluence[0][p][c], 0.015 * size);
  }
}

TEST(CompositeGrid, AWhiteObjectInUniformLightIsUniform) {
  const Polygrid grid = test::ball_grid(32, 10, 0.1);
  DiffusionSolver solver(grid, at_depth(1));
  solver.set_material(homogeneous_coefficients(grid, test::grey_material({0, 1})), 1.5, 0.001);
  const DiffusionLight light = test::light_of(solver, grid, test::uniform_light);
  solver.solve(light, 0.001);
  const std::vector<Double4> fluence = solver.fluence();
  for (const Double4& phi : fluence) ASSERT_NEAR(phi[0], fluence[0][0], 1e-3 * fluence[0][0]);
  for (const Double4& exitance : solver.exitance(light)) ASSERT_NEAR(exitance[0], 1, 2e-3);
}

// Light from within, from all points: also from those that are no unknowns.
TEST(CompositeGrid, TakesSourcesInSkippedCells) {
  const Polygrid grid = test::ball_grid(40, 10, 0.1);
  const CellCoefficients coefficients = homogeneous_coefficients(grid, test::grey_material({0.01, 1}));
  std::vector<Double4> source(grid.points.rows());
  for (Eigen::Index p = 0; p < grid.points.rows(); ++p) {
    const double r = grid.points.row(p).norm();
    source[p] = Double4{1, std::exp(r - 10), r < 3 ? 1.0 : 0.0, 0};
  }
  DiffusionSolver whole(grid), deep(grid, at_depth(2));
  whole.set_material(coefficients, 1.5, 1e-8);
  deep.set_material(coefficients, 1.5, 0.002);
  const DiffusionLight light = whole.source_light(source), deep_light = deep.source_light(source);
  whole.solve(light, 1e-8);
  const SolveReport report = deep.solve(deep_light, 0.002);
  EXPECT_LE(test::exitance_difference(whole, deep.exitance(deep_light), whole.exitance(light)), report.estimated_error);
  for (int c = 0; c < 3; ++c) {
    const EnergyBalance own = deep.energy(deep_light), other = whole.energy(light);
    EXPECT_NEAR(own.absorbed[c] + own.leaving[c], other.absorbed[c] + other.leaving[c], 1e-6 * other.leaving[c]);
  }
}

TEST(CompositeGrid, StartsWarmFromItsOwnSolutionAndFromAFile) {
  const Polygrid grid = test::ball_grid(40, 10, 0.1);
  const CellCoefficients coefficients = homogeneous_coefficients(grid, test::grey_material({0.01, 1}));
  DiffusionSolver whole(grid), deep(grid, at_depth(2)), other(grid, at_depth(2));
  whole.set_material(coefficients, 1.5, 1e-8);
  deep.set_material(coefficients, 1.5, 0.005);
  other.set_material(coefficients, 1.5, 0.005);
  const auto turned = [](const Vec3& p) { return lamp(Vec3(p.x() + 0.1 * p.z(), p.y(), p.z() - 0.1 * p.x())); };
  const DiffusionLight first = test::light_of(deep, grid, lamp), second = test::light_of(deep, grid, turned);
  whole.solve(second, 1e-8);
  const std::vector<Double4> exact = whole.exitance(second);
  deep.solve(first, 0.005);
  std::vector<Rgb> fluence;
  for (const Double4& phi : deep.fluence()) fluence.push_back(to_rgb(phi));
  for (DiffusionSolver* solver : {&deep, &other}) {
    if (solver == &other) other.set_initial(fluence);
    const SolveReport report = solver->solve(second, 0.005, true);
    EXPECT_LE(report.estimated_error, 0.005);
    EXPECT_LE(test::exitance_difference(whole, solver->exitance(second), exact), 0.005);
    for (int c = 0; c < 3; ++c) EXPECT_LT(solver->energy(second).relative_defect[c], 1e-12);
  }
}

}  // namespace
}  // namespace shellgrid
