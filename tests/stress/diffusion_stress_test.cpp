// SPDX-License-Identifier: AGPL-3.0-or-later
// The diffusion solve at the ends of its ranges: each case ends in a solution that balances energy and is finite and
// (nearly) positive, or in a clear refusal. The long form, SG_LONG=1, takes finer grids and more combinations.
#include <gtest/gtest.h>

#include <cstdlib>
#include <string>

#include "meshing/core/error.h"
#include "meshing/core/random.h"
#include "tests/support/diffusion_problem.h"

namespace shellgrid {
namespace {

bool long_form() { return std::getenv("SG_LONG") != nullptr; }

// Each cell's coefficients times a random power of the contrast, the same over a cell.
void scatter_coefficients(CellCoefficients& coefficients, double contrast, std::uint64_t seed) {
  for (std::size_t i = 0; i < coefficients.absorption.size(); ++i) {
    const double share = to_unit(hash64(seed, i / 8));
    const auto factor = static_cast<float>(std::pow(contrast, share - 0.5));
    coefficients.absorption[i] *= factor;
    coefficients.reduced_extinction[i] *= factor;
  }
}

// Solves and checks what every solution must fulfil.
void expect_sound(const Polygrid& grid, const CellCoefficients& coefficients, double ior,
                  const std::function<Double4(const Vec3&)>& light, double least_share, const std::string& what) {
  SCOPED_TRACE(what);
  try {
    const auto p = test::solve_problem(grid, coefficients, ior, light, 1e-6);
    for (int c = 0; c < 3; ++c) {
      double greatest = 0, least = 0;
      for (const Double4& value : p.fluence) {
        ASSERT_TRUE(std::isfinite(value[c]));
        greatest = std::max(greatest, value[c]);
        least = std::min(least, value[c]);
      }
      EXPECT_LT(p.energy.relative_defect[c], 1e-9) << "channel " << c;
      EXPECT_GE(least, -least_share * greatest) << "channel " << c;
    }
  } catch (const NumericalError& refusal) {
    EXPECT_GT(std::string(refusal.what()).size(), 20u);
    EXPECT_GT(least_share, 1e-3) << "a case that must be solved was refused: " << refusal.what();
  }
}

Double4 lamp(const Vec3& p) { return Double4{p.z() > 0 ? p.z() : 0.0, 1, p.x() > 0 ? 1.0 : 0.0, 0}; }

TEST(DiffusionStress, RandomContrasts) {
  for (int n : long_form() ? std::vector<int>{8, 16, 32} : std::vector<int>{8}) {
    const Polygrid grid = test::ball_grid(n, 10, 0.1);
    for (double contrast : {1.0, 1e3, 1e6, 1e9}) {
      CellCoefficients coefficients = homogeneous_coefficients(grid, test::grey_material({0.01, 1}));
      scatter_coefficients(coefficients, contrast, 7);
      expect_sound(grid, coefficients, 1.5, lamp, contrast > 1e6 ? 1e-2 : 1e-3, "contrast " + std::to_string(contrast));
    }
  }
}

TEST(DiffusionStress, RefractiveIndicesAndAlbedos) {
  const Polygrid grid = test::ball_grid(long_form() ? 24 : 8, 10, 0.1);
  for (double ior : {1.0, 1.3, 1.5, 2.0, 2.5})
    for (double lost : {0.0, 1e-12, 1e-6, 1e-3, 0.1, 0.5, 1.0})
      expect_sound(grid, homogeneous_coefficients(grid, test::grey_material({lost, 1 - lost})), ior, lamp, 1e-3,
                   "ior " + std::to_string(ior) + ", one minus albedo " + std::to_string(lost));
}

TEST(DiffusionStress, Sizes) {
  for (double radius : {1e-3, 1.0, 1e3, 1e6}) {
    const Polygrid grid = test::ball_grid(8, radius, 0.1);
    for (double optical_radius : {0.1, 1.0, 10.0})
      expect_sound(
          grid,
          homogeneous_coefficients(grid,
                                   test::grey_material({0.01 * optical_radius / radius, optical_radius / radius})),
          1.5, [&](const Vec3& p) { return lamp(p / radius); }, 1e-3,
          "radius " + std::to_string(radius) + ", mean free paths " + std::to_string(optical_radius));
  }
}

TEST(DiffusionStress, ThinLayers) {
  for (double layer : {1.0, 0.1, 0.01, 1e-3, 1e-4}) {
    const Polygrid grid = test::ball_grid(long_form() ? 24 : 8, 10, layer);
    CellCoefficients coefficients = homogeneous_coefficients(grid, test::grey_material({0.01, 1}));
    scatter_coefficients(coefficients, 1e3, 3);
    expect_sound(grid, coefficients, 1.5, lamp, 1e-3, "layer " + std::to_string(layer));
  }
}

// Trilinear elements promise no M-matrix: in cells sheared by more than 80° fluence undershoots by up to 2 % of its
// greatest value where light stops sharply. Nothing worse is allowed.
TEST(DiffusionStress, ShearedCells) {
  for (double shear : {0.0, 1.0, 3.0, 10.0, 20.0}) {
    Polygrid grid = test::cube_grid(long_form() ? 16 : 8, 10, 0.1);
    grid.points.col(0) += shear * grid.points.col(2);
    expect_sound(grid, homogeneous_coefficients(grid, test::grey_material({0.01, 1})), 1.5, lamp,
                 shear > 5 ? 0.03 : 1e-2, "shear " + std::to_string(shear));
  }
}

TEST(DiffusionStress, LightOnOnePoint) {
  const Polygrid grid = test::ball_grid(12, 10, 0.1);
  const CellCoefficients coefficients = homogeneous_coefficients(grid, test::grey_material({0.01, 1}));
  int lit = 0;
  const Vec3 top = grid.points.row(grid.points.rows() - 1).transpose();
  expect_sound(
      grid, coefficients, 1.5,
      [&](const Vec3& p) {
        const double on = (p - top).norm() < 1e-9;
        lit += on > 0;
        return Double4{on, on, on, 0};
      },
      1e-3, "one point");
  EXPECT_EQ(lit, 1);
}

}  // namespace
}  // namespace shellgrid
