// SPDX-License-Identifier: AGPL-3.0-or-later
// The solver's estimate of the exitance's error against the true one, over shapes, materials and lights, after one cold
// cycle and after a warm one: printed case by case, and as quantiles.
#include <gtest/gtest.h>

#include <algorithm>
#include <cmath>
#include <cstdio>
#include <string>

#include "meshing/core/random.h"
#include "tests/support/diffusion_problem.h"

namespace shellgrid {
namespace {

// σ_t' of so many mean free paths across, in cells that differ by random powers of the contrast.
CellCoefficients material(const Polygrid& grid, double paths, double lost, double contrast) {
  const double size = (grid.points.colwise().maxCoeff() - grid.points.colwise().minCoeff()).maxCoeff();
  CellCoefficients coefficients =
      homogeneous_coefficients(grid, test::grey_material({lost * paths / size, (1 - lost) * paths / size}));
  for (std::size_t k = 0; k < coefficients.absorption.size(); ++k) {
    const auto factor = static_cast<float>(std::pow(contrast, to_unit(hash64(5, k / 8)) - 0.5));
    coefficients.absorption[k] *= factor;
    coefficients.reduced_extinction[k] *= factor;
  }
  return coefficients;
}

// The channels: half lit, everywhere lit, a small spot.
DiffusionLight lamp(const DiffusionSolver& solver, const Polygrid& grid, double turn) {
  const Vec3 centre = grid.points.colwise().mean().transpose();
  const Vec3 direction = Vec3(std::sin(turn), 0.3, std::cos(turn)).normalized();
  return test::light_of(solver, grid, [&](const Vec3& p) {
    const double cosine = std::max(0.0, (p - centre).normalized().dot(direction));
    return Double4{cosine, 1, cosine > 0.9 ? 1.0 : 0.0, 0};
  });
}

TEST(ErrorEstimate, IsHonestAndNotTooCareful) {
  std::vector<double> cold, warm;
  const std::vector<std::pair<std::string, Polygrid>> grids = {{"ball 20³", test::ball_grid(20, 10, 0.1)},
                                                               {"ball 32³, layer .01", test::ball_grid(32, 10, 0.01)},
                                                               {"cube 24³", test::cube_grid(24, 20, 0.1)}};
  for (const auto& [name, grid] : grids) {
    DiffusionSolver solver(grid);
    for (const double paths : {10.0, 100.0, 1000.0})
      for (const double lost : {1e-4, 0.01, 0.1})
        for (const double contrast : {1.0, 30.0, 1e4}) {
          solver.set_material(material(grid, paths, lost, contrast), 1.5, 1e-9);
          const DiffusionLight light = lamp(solver, grid, 0.3), turned = lamp(solver, grid, 0.38);
          solver.solve(turned, 1e-7);
          const std::vector<Double4> exact_turned = solver.exitance(turned);
          solver.solve(light, 1e-7);
          const std::vector<Double4> exact = solver.exitance(light);
          const SolveReport first = solver.solve(light, 0.9);
          cold.push_back(first.estimated_error / test::exitance_difference(solver, solver.exitance(light), exact));
          const SolveReport second = solver.solve(turned, 0.9, true);
          warm.push_back(second.estimated_error /
                         test::exitance_difference(solver, solver.exitance(turned), exact_turned));
          std::printf(
              "%-20s %5g mean free paths, 1 - albedo %5g, contrast %5g: estimate / error cold %.2f, warm %.2f\n",
              name.c_str(), paths, lost, contrast, cold.back(), warm.back());
        }
  }
  for (std::vector<double>* ratios : {&cold, &warm}) {
    std::sort(ratios->begin(), ratios->end());
    const auto quantile = [&](double q) { return (*ratios)[static_cast<std::size_t>(q * (ratios->size() - 1))]; };
    std::printf("%s: least %.2f, a twentieth below %.2f, median %.2f, nine tenths below %.2f, greatest %.2f\n",
                ratios == &cold ? "cold" : "warm", quantile(0), quantile(0.05), quantile(0.5), quantile(0.9),
                quantile(1));
    EXPECT_GE(quantile(0), 0.7);
    EXPECT_GE(quantile(0.1), 1.0);
    // In rough materials, a third of the cases, the first correction counts twice: there are shells where it must.
    EXPECT_LE(quantile(0.5), 4.0);
    EXPECT_LE(quantile(0.9), 6.0);
  }
}

// Layers of up to half a cell, as sg-polygrid --layer makes them: the cycle leaves more there than its changes tell.
TEST(ErrorEstimate, HoldsUnderThickLayers) {
  for (const double layer : {0.15, 0.3, 0.5})
    for (const double paths : {10.0, 300.0})
      for (const double tolerance : {0.01, 5e-4}) {
        const Polygrid grid = test::ball_grid(24, 10, layer * 20 / 24);
        DiffusionSolver solver(grid);
        solver.set_material(material(grid, paths, 0.01, 1), 1.5, 1e-9);
        const DiffusionLight light = lamp(solver, grid, 0.3);
        solver.solve(light, 1e-7);
        const std::vector<Double4> exact = solver.exitance(light);
        const SolveReport report = solver.solve(light, tolerance);
        const double error = test::exitance_difference(solver, solver.exitance(light), exact);
        std::printf("layer %.2f, %g mean free paths, asked %g: estimated %.1e, true %.1e\n", layer, paths, tolerance,
                    report.estimated_error, error);
        EXPECT_LE(report.estimated_error, tolerance);
        EXPECT_LE(error, 1.3 * report.estimated_error);
      }
}

}  // namespace
}  // namespace shellgrid
