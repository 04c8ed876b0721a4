// SPDX-License-Identifier: AGPL-3.0-or-later
// Order of convergence of the polygrid solver against closed forms. SG_LONG adds finer grids.
#include <gtest/gtest.h>

#include <cmath>
#include <cstdio>
#include <cstdlib>

#include "tests/support/diffusion_problem.h"

namespace shellgrid {
namespace {

constexpr double ior = 1.4;

// The two grids that the order is read from, the finer one twice as fine.
int coarse_cells() { return std::getenv("SG_LONG") ? 32 : 16; }

double order(double coarse_error, double fine_error, const char* what) {
  const double result = std::log2(coarse_error / fine_error);
  std::printf("%s: %.3e -> %.3e, order %.2f\n", what, coarse_error, fine_error, result);
  return result;
}

TEST(DiffusionConvergence, SlabIsSecondOrderInFluenceAndExitance) {
  const DiffusionCoefficients material{0.05, 1.0};
  const double thickness = 8;
  const SlabSolution exact(material, thickness, ior, 1, 0);
  for (double layer : {1.0, 0.1, 0.01}) {
    double fluence[2], exitance[2];
    for (int k = 0; k < 2; ++k) {
      const Polygrid grid = test::slab_grid(2 * coarse_cells() << k, 2, thickness, layer);
      const auto p = test::solve_problem(grid, homogeneous_coefficients(grid, test::grey_material(material)), ior,
                                         [](const Vec3& x) {
                                           return Double4{x.z() == 0 ? 1.0 : 0.0, 1, 1, 0};
                                         });
      fluence[k] = test::fluence_error(p, [&](const Vec3& x) { return exact.fluence(x.z()); });
      exitance[k] = test::exitance_error(
          p, [&](const Vec3& x) { return x.z() == 0 ? exact.exitance_at_zero : exact.exitance_at_thickness; });
    }
    EXPECT_GE(order(fluence[0], fluence[1], "slab, fluence"), 1.9);
    EXPECT_GE(order(exitance[0], exitance[1], "slab, exitance"), 1.9);
    EXPECT_LT(exitance[1], 2e-3);
  }
}

TEST(DiffusionConvergence, BallIsSecondOrderInExitance) {
  for (double absorption : {0.0008, 0.002}) {
    const DiffusionCoefficients material{absorption, 1.0};
    const SphereSolution exact(material, 10, ior, 1);
    double error[2];
    for (int k = 0; k < 2; ++k) {
      const Polygrid grid = test::ball_grid(coarse_cells() << k, 10, 0.1);
      const auto p = test::solve_problem(grid, homogeneous_coefficients(grid, test::grey_material(material)), ior,
                                         test::uniform_light);
      error[k] = test::exitance_error(p, [&](const Vec3&) { return exact.exitance; });
    }
    EXPECT_GE(order(error[0], error[1], "ball, exitance"), 1.9);
    EXPECT_LT(error[1], 5e-3);
  }
}

TEST(DiffusionConvergence, TwoLayerBallIsSecondOrderInExitanceAndFluence) {
  const DiffusionCoefficients inner{0.002, 1.5}, outer{0.05, 0.5};
  const double radius = 10, interface = 5;
  double fluence[2], exitance[2];
  for (int k = 0; k < 2; ++k) {
    const int n = coarse_cells() << k;
    const double layer = 0.1, h = 2 * radius / n;
    const Polygrid grid = test::ball_grid(n, radius, layer, true);
    CellCoefficients coefficients = homogeneous_coefficients(grid, test::grey_material(outer));
    for (int cell = 0; cell < grid.cells.rows(); ++cell)
      for (int corner = 0; corner < 8; ++corner) {
        const Vec3i low = grid.cell_lattice.row(cell).transpose();
        const Vec3 centre = 2.0 / n * (low.cast<double>() + Vec3::Constant(0.5)) - Vec3::Ones();
        if (centre.cwiseAbs().maxCoeff() > interface / radius) continue;
        coefficients.absorption[8 * cell + corner] = static_cast<float>(inner.absorption);
        coefficients.reduced_extinction[8 * cell + corner] =
            static_cast<float>(inner.absorption + inner.reduced_scattering);
      }
    const TwoLayerSphereSolution exact(inner, outer, interface, radius + layer * h, ior, 1);
    const auto p = test::solve_problem(grid, coefficients, ior, test::uniform_light);
    fluence[k] = test::fluence_error(p, [&](const Vec3& x) { return exact.fluence(x.norm()); });
    exitance[k] = test::exitance_error(p, [&](const Vec3&) { return exact.exitance; });
  }
  EXPECT_GE(order(exitance[0], exitance[1], "two-layer ball, exitance"), 1.9);
  EXPECT_GE(order(fluence[0], fluence[1], "two-layer ball, fluence"), 1.9);
}

}  // namespace
}  // namespace shellgrid
