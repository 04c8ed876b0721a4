// SPDX-License-Identifier: AGPL-3.0-or-later
// The diffusion solve at the ends of its ranges: each case ends in a solution that balances energy and is finite and
// (nearly) positive, or in a clear refusal. The long form, SG_LONG=1, takes finer grids and more combinations.
#include <gtest/gtest.h>

#include <cmath>
#include <cstdio>
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

// σ_a and σ_t' by a smooth power of the contrast.
void wave_coefficients(const Polygrid& grid, CellCoefficients& coefficients, double contrast, double waves) {
  const Vec3 low = grid.points.colwise().minCoeff(), size = grid.points.colwise().maxCoeff().transpose() - low;
  for (std::size_t i = 0; i < coefficients.absorption.size(); ++i) {
    const Vec3 x = gauss_point(grid, static_cast<int>(i / 8), static_cast<int>(i % 8)) - low;
    const double phase = 2 * M_PI * waves * (x.array() / size.array()).sum();
    const auto factor = static_cast<float>(std::pow(contrast, 0.5 * std::sin(phase)));
    coefficients.absorption[i] *= factor;
    coefficients.reduced_extinction[i] *= factor;
  }
}

// Solves and checks what every solution must fulfil. A refusal says what happened, with its history.
void expect_sound(const Polygrid& grid, const CellCoefficients& coefficients, double ior,
                  const std::function<Double4(const Vec3&)>& light, double least_share, const std::string& what,
                  double tolerance) {
  SCOPED_TRACE(what + " to " + std::to_string(tolerance));
  try {
    const auto p = test::solve_problem(grid, coefficients, ior, light, tolerance);
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
    const std::string said = refusal.what();
    EXPECT_TRUE(said.find("relative residuals") != std::string::npos ||
                said.find("not positive definite") != std::string::npos)
        << said;
    std::printf("%s: refused: %s\n", what.c_str(), said.substr(0, 90).c_str());
    EXPECT_GT(least_share, 1e-3) << "a case that must be solved was refused: " << refusal.what();
  }
}

// With couplings in half and in single precision.
void expect_sound(const Polygrid& grid, const CellCoefficients& coefficients, double ior,
                  const std::function<Double4(const Vec3&)>& light, double least_share, const std::string& what) {
  for (const double tolerance : {0.002, 1e-6})
    expect_sound(grid, coefficients, ior, light, least_share, what, tolerance);
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

TEST(DiffusionStress, SmoothContrasts) {
  for (int n : long_form() ? std::vector<int>{8, 16, 32} : std::vector<int>{8}) {
    const Polygrid grid = test::ball_grid(n, 10, 0.1);
    for (double contrast : {1.0, 1e3, 1e6, 1e9}) {
      CellCoefficients coefficients = homogeneous_coefficients(grid, test::grey_material({0.01, 1}));
      wave_coefficients(grid, coefficients, contrast, 1);
      // No M-matrix: at contrasts of a million fluence undershoots by up to half a per cent of its greatest value.
      expect_sound(grid, coefficients, 1.5, lamp, contrast > 1e4 ? 1e-2 : 1e-3,
                   "smooth contrast " + std::to_string(contrast));
    }
  }
}

// A shell as thin as a cell over a core of quite another material, and cells that alternate.
TEST(DiffusionStress, OneVoxelShells) {
  const int n = long_form() ? 24 : 8;
  const Polygrid grid = test::ball_grid(n, 10, 0.1);
  for (double contrast : {1e-6, 1e-3, 1e3, 1e6})
    for (const bool alternating : {false, true}) {
      CellCoefficients coefficients = homogeneous_coefficients(grid, test::grey_material({0.01, 1}));
      for (std::size_t i = 0; i < coefficients.absorption.size(); ++i) {
        const Vec3i at = grid.cell_lattice.row(static_cast<Eigen::Index>(i / 8)).transpose();
        const bool shell = alternating ? at.sum() % 2 == 0 : at.minCoeff() == 0 || at.maxCoeff() == n - 1;
        if (!shell) continue;
        coefficients.absorption[i] *= static_cast<float>(contrast);
        coefficients.reduced_extinction[i] *= static_cast<float>(contrast);
      }
      expect_sound(grid, coefficients, 1.5, lamp, contrast > 1e4 || contrast < 1e-4 ? 1e-2 : 2e-3,
                   (alternating ? "alternating " : "shell ") + std::to_string(contrast));
    }
}

// One point of the cube drawn towards the opposite edges of its cells, down to a scaled Jacobian of about a twentieth.
TEST(DiffusionStress, FlattenedCells) {
  for (double share : {0.3, 0.45, 0.49}) {
    Polygrid grid = test::cube_grid(8, 10, 0.1);
    int moved = 0;
    for (Eigen::Index p = 0; p < grid.points.rows(); ++p) {
      const Vec3i at = grid.point_lattice.row(p).transpose();
      if (grid.outer_twin[p] >= 0 || at.minCoeff() < 1 || at.maxCoeff() > 7 || at.sum() % 5 != 0) continue;
      grid.points.row(p) += share * grid.spacing * Eigen::RowVector3d(1, 1, 0);
      ++moved;
    }
    EXPECT_GT(moved, 20);
    CellCoefficients coefficients = homogeneous_coefficients(grid, test::grey_material({0.01, 1}));
    scatter_coefficients(coefficients, 10, 5);
    expect_sound(grid, coefficients, 1.5, lamp, 1e-2, "flattened " + std::to_string(share));
  }
}

TEST(DiffusionStress, NoLight) {
  const Polygrid grid = test::ball_grid(10, 10, 0.1);
  CellCoefficients coefficients = homogeneous_coefficients(grid, test::grey_material({0, 1}));
  scatter_coefficients(coefficients, 1e6, 2);
  for (double tolerance : {0.005, 1e-9}) {
    const auto p = test::solve_problem(
        grid, coefficients, 1.5, [](const Vec3&) { return Double4{}; }, tolerance);
    for (const Double4& value : p.fluence)
      for (int c = 0; c < 3; ++c) ASSERT_EQ(value[c], 0);
  }
  // One channel dark.
  const auto p = test::solve_problem(
      grid, coefficients, 1.5,
      [](const Vec3&) {
        return Double4{0, 1, 1, 0};
      },
      1e-6);
  for (const Double4& value : p.fluence) ASSERT_EQ(value[0], 0);
  EXPECT_LT(p.energy.relative_defect[1], 1e-9);
}

TEST(DiffusionStress, RefractiveIndicesAndAlbedos) {
  const Polygrid grid = test::ball_grid(long_form() ? 24 : 8, 10, 0.1);
  for (double ior : {1.0, 1.3, 1.5, 2.0, 2.5})
    for (double lost : {0.0, 1e-12, 1e-6, 1e-3, 0.1, 0.5, 1.0})
      expect_sound(grid, homogeneous_coefficients(grid, test::grey_material({lost, 1 - lost})), ior, lamp, 1e-3,
                   "ior " + std::to_string(ior) + ", one minus albedo " + std::to_string(lost));
}

TEST(DiffusionStress, Sizes) {
  for (double radius : {1e-3, 0.1, 1.0, 1e3, 1e6}) {
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
  EXPECT_EQ(lit, 2);  // once a tolerance
}

}  // namespace
}  // namespace shellgrid
