// SPDX-License-Identifier: AGPL-3.0-or-later
#include "solvers/diffusion/diffusion_solver.h"

#include <gtest/gtest.h>

#include <limits>

#include "meshing/core/error.h"
#include "meshing/core/random.h"
#include "tests/support/diffusion_problem.h"
#include "tests/support/lattice_polygrid.h"

namespace shellgrid {
namespace {

int iterations(int n, double layer, const DiffusionCoefficients& material, double contrast) {
  const Polygrid grid = test::ball_grid(n, 10, layer);
  CellCoefficients coefficients = homogeneous_coefficients(grid, test::grey_material(material));
  if (contrast > 1) test::add_contrast(coefficients, contrast);
  return test::solve_problem(
             grid, coefficients, 1.5,
             [](const Vec3& p) {
               return Double4{p.z() > 0 ? 1.0 : 0.0, 1, p.x() > 2 ? 1.0 : 0.0, 0};
             },
             1e-6)
      .report.iterations;
}

TEST(DiffusionSolver, IterationsStayFewAsTheGridGrows) {
  for (int n : {8, 16, 32}) EXPECT_LE(iterations(n, 0.1, {0.01, 1}, 1), 7) << n;
}

TEST(DiffusionSolver, IterationsStayFewForAnyLayerThickness) {
  for (double layer : {1.0, 0.3, 0.1, 0.01, 0.001}) EXPECT_LE(iterations(16, layer, {0.01, 1}, 1), 8) << layer;
}

TEST(DiffusionSolver, ConvergesWithoutAbsorptionAndWithStrong) {
  for (double absorption : {0.0, 1e-6, 1.0, 100.0}) EXPECT_LE(iterations(16, 0.1, {absorption, 1}, 1), 8) << absorption;
}

TEST(DiffusionSolver, ConvergesAtContrastsToAMillion) {
  for (double contrast : {1e2, 1e4, 1e6}) EXPECT_LE(iterations(16, 0.1, {0.01, 1}, contrast), 18) << contrast;
}

TEST(DiffusionSolver, PartsThatNearlyTouchDoNotSlowIt) {
  // Plates of two cells, a cell apart, of which every other one is lit.
  const Polygrid grid = test::lattice_polygrid(test::comb(8, 2, 32, 6), 1);
  const auto p = test::solve_problem(
      grid, homogeneous_coefficients(grid, test::grey_material({0.001, 1})), 1.5,
      [](const Vec3& at) {
        const bool lit = static_cast<int>(at.x() + 0.2) / 3 % 2 == 0;
        return Double4{lit ? 1.0 : 0.0, 1, 0, 0};
      },
      1e-6);
  EXPECT_LE(p.report.iterations, 7);
}

TEST(DiffusionSolver, TheEstimatedErrorBoundsTheTrueOne) {
  const Polygrid grid = test::ball_grid(16, 10, 0.1);
  CellCoefficients coefficients = homogeneous_coefficients(grid, test::grey_material({0.01, 1}));
  test::add_contrast(coefficients, 100);
  auto light = [](const Vec3& p) { return Double4{std::max(0.0, p.z()), 0, 0, 0}; };
  const auto exact = test::solve_problem(grid, coefficients, 1.5, light, 1e-11);
  for (double tolerance : {0.05, 0.005, 1e-4}) {
    const auto p = test::solve_problem(grid, coefficients, 1.5, light, tolerance);
    double error = 0, size = 0;
    for (std::size_t u = 0; u < p.exitance.size(); ++u) {
      const double e = p.exitance[u][0] - exact.exitance[u][0];
      error += p.system.boundary_area[u] * e * e;
      size += p.system.boundary_area[u] * exact.exitance[u][0] * exact.exitance[u][0];
    }
    EXPECT_LE(p.report.estimated_error, tolerance);
    EXPECT_LT(std::sqrt(error / size), tolerance);
    EXPECT_EQ(p.report.error_history.back(), p.report.estimated_error);
    EXPECT_GE(static_cast<int>(p.report.error_history.size()), p.report.cycles + p.report.iterations);
  }
}

TEST(DiffusionSolver, TinyAndHugeUnitsMakeNoDifference) {
  for (double scale : {1e-5, 1e5}) {
    const Polygrid grid = test::ball_grid(12, 10 * scale, 0.1);
    const auto p = test::solve_problem(
        grid, homogeneous_coefficients(grid, test::grey_material({0.01 / scale, 1 / scale})), 1.5,
        [&](const Vec3& x) {
          return Double4{1e-12 * (x.z() > 0), 1e12, 0, 0};
        },
        1e-6);
    EXPECT_LE(p.report.iterations, 7);
    EXPECT_LT(p.energy.relative_defect[0], 1e-12);
  }
}

TEST(DiffusionSolver, DarknessNeedsNoIterations) {
  const Polygrid grid = test::ball_grid(6, 10, 0.1);
  const auto p = test::solve_problem(grid, homogeneous_coefficients(grid, test::grey_material({0.01, 1})), 1.5,
                                     [](const Vec3&) { return Double4{}; });
  EXPECT_EQ(p.report.iterations, 0);
  for (const Double4& phi : p.fluence) ASSERT_EQ(phi[0], 0);
}

TEST(DiffusionSolver, SaysWhatHappenedInsteadOfReturningAWrongPicture) {
  const Polygrid grid = test::ball_grid(12, 10, 0.1);
  CellCoefficients coefficients = homogeneous_coefficients(grid, test::grey_material({0.01, 1}));
  SolverParameters parameters;
  parameters.most_iterations = 2;
  DiffusionSolver hasty(grid, parameters);
  hasty.set_material(coefficients, 1.5, 1e-9);
  const auto lamp = [](const Vec3& p) { return Double4{p.z() > 0 ? 1.0 : 0.0, 1, 1, 0}; };
  DiffusionLight light = test::light_of(hasty, grid, lamp);
  try {
    hasty.solve(light, 1e-9);
    FAIL() << "two iterations were enough";
  } catch (const NumericalError& error) {
    EXPECT_NE(std::string(error.what()).find("after 2 iterations; relative residuals"), std::string::npos)
        << error.what();
  }
  DiffusionSolver solver(grid);
  solver.set_material(coefficients, 1.5, 1e-12);
  EXPECT_THROW(solver.solve(light, 1e-30), NumericalError);
  EXPECT_LT(solver.solve(light, 1e-12).estimated_error, 1e-12);
  light.irradiance[5][0] = std::numeric_limits<float>::quiet_NaN();
  EXPECT_THROW(solver.solve(light, 1e-3), NumericalError);
  EXPECT_THROW(solver.solve(light, 1e-9), NumericalError);
  for (Rgb& absorption : coefficients.absorption) absorption = Rgb::Constant(-0.5f);
  EXPECT_THROW(solver.set_material(coefficients, 1.5, 1e-3), NumericalError);
}

TEST(DiffusionSolver, AWarmStartEndsWhereAColdOneDoes) {
  const Polygrid grid = test::ball_grid(20, 10, 0.1);
  CellCoefficients coefficients = homogeneous_coefficients(grid, test::grey_material({0.01, 1}));
  test::add_contrast(coefficients, 10);
  DiffusionSolver solver(grid);
  const auto lamp = [&](double angle, double power) {
    const Vec3 direction(std::sin(angle), 0, std::cos(angle));
    return test::light_of(solver, grid, [=](const Vec3& p) {
      const double cosine = power * std::max(0.0, direction.dot(p.normalized()));
      return Double4{cosine, cosine, 2 * cosine, 0};
    });
  };
  solver.set_material(coefficients, 1.5, 1e-10);
  // Turned a little; much brighter; much darker; dark and lit again.
  for (const double power : {1.0, 1e4, 1e-4, 0.0, 1.0}) {
    const DiffusionLight light = lamp(0.1, power);
    solver.solve(light, 1e-9);
    const std::vector<Double4> exact = solver.exitance(light);
    solver.solve(lamp(0, 1), 0.002);
    const SolveReport warm = solver.solve(light, 0.002, true);
    const std::vector<Double4> close = solver.exitance(light);
    EXPECT_LE(warm.cycles, 3);
    double error = 0, size = 0;
    for (std::size_t s = 0; s < exact.size(); ++s) {
      error += solver.surface().area[s] * std::pow(close[s][0] - exact[s][0], 2);
      size += solver.surface().area[s] * std::pow(exact[s][0], 2);
    }
    EXPECT_LE(std::sqrt(error), 0.002 * std::sqrt(size) + 1e-12) << power;
    EXPECT_LT(solver.energy(light).relative_defect[0], 1e-10);
    // The same from a file's fluence.
    std::vector<Rgb> fluence;
    for (const Double4& value : solver.fluence()) fluence.push_back(to_rgb(value));
    solver.set_initial(fluence);
    const SolveReport again = solver.solve(light, 1e-6, true);
    EXPECT_LE(again.iterations, 5);
    const std::vector<Double4> closer = solver.exitance(light);
    for (std::size_t s = 0; s < exact.size(); ++s) ASSERT_NEAR(closer[s][0], exact[s][0], 1e-4 * power);
  }
  EXPECT_THROW(solver.set_initial(std::vector<Rgb>(3)), InputError);
}

// The elements of 16 cells at a time against those of one at a time, through all couplings.
TEST(DiffusionSolver, ItsOperatorIsThatOfTheSystem) {
  for (const bool coloured : {false, true}) {
    const Polygrid grid = test::ball_grid(9, 10, coloured ? 1.0 : 0.1);
    CellCoefficients coefficients = homogeneous_coefficients(grid, test::grey_material({0.01, 1}));
    test::add_contrast(coefficients, 100);
    // Coloured alike everywhere, one copy of the couplings serves all channels; else three.
    for (std::size_t k = 0; k < coefficients.reduced_extinction.size(); ++k)
      coefficients.reduced_extinction[k] *= coloured && k % 16 > 8 ? Rgb(1, 3, 2) : Rgb(1, 2, 0.7f);
    const PolygridSystem system = assemble_polygrid_system(grid, coefficients, 1.5);
    DiffusionSolver solver(grid);
    solver.set_material(coefficients, 1.5, 1e-9);
    for (const bool rounded : {false, true}) {
      const RunLevel& level = solver.finest();
      EXPECT_EQ(level.half.copies, coloured ? 3 : 1);
      std::vector<Double4> at_points(system.key.size()), x(system.key.size()), expected;
      for (std::size_t p = 0; p < at_points.size(); ++p)
        for (int c = 0; c < 3; ++c) at_points[p][c] = to_unit(hash64(c, p));
      for (std::size_t u = 0; u < x.size(); ++u) x[u] = at_points[system.point_of_unknown[u]];
      system.matrix.apply(x, expected);
      LevelVector<double> mine(level.inner_size(), level.surface.size()),
          result = LevelVector<double>(level.inner_size(), level.surface.size());
      for (int c = 0; c < 3; ++c)
        for (std::size_t u = 0; u < level.inner_size(); ++u) mine.inner[c][u] = at_points[level.layout.point_of[u]][c];
      for (std::size_t s = 0; s < mine.outer.size(); ++s) mine.outer[s] = at_points[solver.grid().outer_point[s]];
      apply_level(level, mine, result, rounded);
      double error = 0, size = 0;
      const auto compare = [&](double a, std::int32_t point, int c) {
        const double b = expected[system.unknown_of_point[point]][c];
        error = std::max(error, std::abs(a - b));
        size = std::max(size, std::abs(b));
      };
      for (int c = 0; c < 3; ++c) {
        for (std::size_t u = 0; u < level.inner_size(); ++u) compare(result.inner[c][u], level.layout.point_of[u], c);
        for (std::size_t s = 0; s < mine.outer.size(); ++s)
          compare(result.outer[s][c], solver.grid().outer_point[s], c);
      }
      EXPECT_LT(error, (rounded ? 1e-3 : 1e-5) * size);
    }
  }
}

}  // namespace
}  // namespace shellgrid
