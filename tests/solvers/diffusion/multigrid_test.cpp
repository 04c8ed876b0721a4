// SPDX-License-Identifier: AGPL-3.0-or-later
#include "solvers/diffusion/multigrid.h"

#include <gtest/gtest.h>

#include <limits>

#include "meshing/core/error.h"
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

TEST(Multigrid, IterationsStayFewAsTheGridGrows) {
  for (int n : {8, 16, 32}) EXPECT_LE(iterations(n, 0.1, {0.01, 1}, 1), 7) << n;
}

TEST(Multigrid, IterationsStayFewForAnyLayerThickness) {
  for (double layer : {1.0, 0.3, 0.1, 0.01, 0.001}) EXPECT_LE(iterations(16, layer, {0.01, 1}, 1), 8) << layer;
}

TEST(Multigrid, ConvergesWithoutAbsorptionAndWithStrong) {
  for (double absorption : {0.0, 1e-6, 1.0, 100.0}) EXPECT_LE(iterations(16, 0.1, {absorption, 1}, 1), 8) << absorption;
}

TEST(Multigrid, ConvergesAtContrastsToAMillion) {
  for (double contrast : {1e2, 1e4, 1e6}) EXPECT_LE(iterations(16, 0.1, {0.01, 1}, contrast), 18) << contrast;
}

TEST(Multigrid, PartsThatNearlyTouchDoNotSlowIt) {
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

TEST(Multigrid, TheEstimatedErrorBoundsTheTrueOne) {
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
    EXPECT_EQ(p.report.residual_history.size(), static_cast<std::size_t>(p.report.iterations) + 1);
  }
}

TEST(Multigrid, TinyAndHugeUnitsMakeNoDifference) {
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

TEST(Multigrid, DarknessNeedsNoIterations) {
  const Polygrid grid = test::ball_grid(6, 10, 0.1);
  const auto p = test::solve_problem(grid, homogeneous_coefficients(grid, test::grey_material({0.01, 1})), 1.5,
                                     [](const Vec3&) { return Double4{}; });
  EXPECT_EQ(p.report.iterations, 0);
  for (const Double4& phi : p.fluence) ASSERT_EQ(phi[0], 0);
}

TEST(Multigrid, AStartAtTheSolutionNeedsNoIterations) {
  const Polygrid grid = test::ball_grid(10, 10, 0.1);
  auto p =
      test::solve_problem(grid, homogeneous_coefficients(grid, test::grey_material({0.01, 1})), 1.5, [](const Vec3& x) {
        return Double4{x.z() > 0 ? 1.0 : 0.0, 1, 0, 0};
      });
  Multigrid multigrid(p.system);
  const SolveReport again = solve_conjugate_gradients(p.system, multigrid, boundary_source(p.system, p.irradiance),
                                                      p.irradiance, 1e-6, 100, p.fluence);
  EXPECT_EQ(again.iterations, 0);
}

TEST(Multigrid, SaysWhatHappenedInsteadOfReturningAWrongPicture) {
  const Polygrid grid = test::ball_grid(8, 10, 0.1);
  PolygridSystem system =
      assemble_polygrid_system(grid, homogeneous_coefficients(grid, test::grey_material({0.01, 1})), 1.5);
  std::vector<Double4> q(system.key.size(), Double4{1, 1, 1, 0}), fluence;
  Multigrid multigrid(system);
  const auto source = boundary_source(system, q);
  try {
    solve_conjugate_gradients(system, multigrid, source, q, 1e-9, 2, fluence);
    FAIL() << "two iterations were enough";
  } catch (const NumericalError& error) {
    EXPECT_NE(std::string(error.what()).find("after 2 iterations; relative residuals 1.00e+00"), std::string::npos)
        << error.what();
  }
  fluence.clear();
  EXPECT_THROW(solve_conjugate_gradients(system, multigrid, source, q, 1e-30, 500, fluence), NumericalError);
  fluence.clear();
  EXPECT_LT(solve_conjugate_gradients(system, multigrid, source, q, 1e-12, 100, fluence).estimated_error, 1e-12);
  auto broken = source;
  broken[5][0] = std::numeric_limits<double>::quiet_NaN();
  fluence.clear();
  EXPECT_THROW(solve_conjugate_gradients(system, multigrid, broken, q, 1e-3, 50, fluence), NumericalError);
  PolygridSystem indefinite = system;
  for (Double4& reaction : indefinite.matrix.reaction) reaction -= Double4{1, 1, 1, 0};
  fluence.clear();
  EXPECT_THROW(solve_conjugate_gradients(indefinite, multigrid, source, q, 1e-9, 50, fluence), NumericalError);
}

}  // namespace
}  // namespace shellgrid
