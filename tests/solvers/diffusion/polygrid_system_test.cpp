// SPDX-License-Identifier: AGPL-3.0-or-later
#include "solvers/diffusion/polygrid_system.h"

#include <gtest/gtest.h>
#include <oneapi/tbb/global_control.h>

#include <cstring>

#include "meshing/core/error.h"
#include "tests/support/diffusion_problem.h"

namespace shellgrid {
namespace {

const DiffusionCoefficients marble{0.002, 2.0};

Double4 side_light(const Vec3& p) { return Double4{std::max(0.0, p.z()), 0.5 * std::max(0.0, p.x()), 0, 0}; }

TEST(PolygridSystem, BalancesEnergyToRoundingAtAnyTolerance) {
  const Polygrid grid = test::ball_grid(12, 10, 0.1);
  CellCoefficients coefficients = homogeneous_coefficients(grid, test::grey_material(marble));
  test::add_contrast(coefficients, 1e3);
  for (double tolerance : {0.05, 0.005, 1e-9}) {
    const auto p = test::solve_problem(grid, coefficients, 1.5, side_light, tolerance);
    for (int c = 0; c < 2; ++c) {
      EXPECT_GT(p.energy.entering[c], 0);
      EXPECT_GT(p.energy.absorbed[c], 0);
      EXPECT_LT(p.energy.relative_defect[c], 1e-12) << tolerance;
    }
    EXPECT_EQ(p.energy.leaving[2], 0);  // no light, no exitance
  }
}

TEST(PolygridSystem, AWhiteObjectReturnsAllLightWhateverItsHeterogeneity) {
  const Polygrid grid = test::ball_grid(10, 5, 0.1);
  CellCoefficients coefficients = homogeneous_coefficients(grid, test::grey_material({0, 1}));
  test::add_contrast(coefficients, 1e4);
  const auto p = test::solve_problem(grid, coefficients, 1.3, side_light);
  for (int c = 0; c < 2; ++c) EXPECT_NEAR(p.energy.leaving[c] / p.energy.entering[c], 1, 1e-12);
}

TEST(PolygridSystem, UniformLightFillsAWhiteObjectWithConstantFluence) {
  const Polygrid grid = test::ball_grid(10, 5, 0.1);
  CellCoefficients coefficients = homogeneous_coefficients(grid, test::grey_material({0, 1}));
  test::add_contrast(coefficients, 1e6);
  const auto p = test::solve_problem(grid, coefficients, 1.5, test::uniform_light, 1e-10);
  // φ = 4 q / (1 − R_φ), and M = q.
  const double level = 4 * p.system.boundary_factor / (1 + p.system.current_reflectance);
  for (std::size_t u = 0; u < p.fluence.size(); ++u) {
    ASSERT_NEAR(p.fluence[u][0], level, 1e-6 * level);
    if (p.system.boundary_area[u] > 0) {
      ASSERT_NEAR(p.exitance[u][0], 1, 1e-6);
    }
  }
}

TEST(PolygridSystem, IsSymmetricBitByBit) {
  const Polygrid grid = test::ball_grid(6, 5, 0.1);
  CellCoefficients coefficients = homogeneous_coefficients(grid, test::grey_material(marble));
  test::add_contrast(coefficients, 100);
  const PolygridSystem system = assemble_polygrid_system(grid, coefficients, 1.5);
  const CouplingOperator& a = system.matrix;
  int seen = 0;
  for (std::size_t i = 0; i < a.size(); ++i)
    for (std::int64_t k = a.row_start[i]; k < a.row_start[i + 1]; ++k)
      for (std::int64_t m = a.row_start[a.column[k]]; m < a.row_start[a.column[k] + 1]; ++m)
        if (a.column[m] == static_cast<std::int32_t>(i)) {
          ++seen;
          ASSERT_EQ(std::memcmp(&a.coupling[k], &a.coupling[m], sizeof(Float4)), 0);
        }
  EXPECT_EQ(seen, static_cast<int>(a.column.size()));
}

TEST(PolygridSystem, MeasuresVolumeAndSurfaceOfTheBall) {
  const Polygrid grid = test::ball_grid(24, 5, 0.1);
  const PolygridSystem system =
      assemble_polygrid_system(grid, homogeneous_coefficients(grid, test::grey_material(marble)), 1.5);
  EXPECT_NEAR(system.volume, 4.0 / 3 * M_PI * 125, 0.01 * 523.6);
  EXPECT_NEAR(system.surface_area, 4 * M_PI * 25, 0.01 * 314.2);
}

TEST(PolygridSystem, GivesTheSameBytesAtOneAndTwoThreads) {
  const Polygrid grid = test::ball_grid(16, 5, 0.1);
  CellCoefficients coefficients = homogeneous_coefficients(grid, test::grey_material(marble));
  test::add_contrast(coefficients, 1e3);
  std::vector<Double4> first;
  for (int threads : {1, 2, 4}) {
    oneapi::tbb::global_control control(oneapi::tbb::global_control::max_allowed_parallelism, threads);
    const auto p = test::solve_problem(grid, coefficients, 1.5, side_light, 0.005);
    if (first.empty()) first = p.fluence;
    ASSERT_EQ(first.size(), p.fluence.size());
    EXPECT_EQ(std::memcmp(first.data(), p.fluence.data(), first.size() * sizeof(Double4)), 0) << threads;
  }
}

TEST(PolygridSystem, RefusesInvertedAndFlatCellsAndSaysWhere) {
  Polygrid grid = test::ball_grid(6, 5, 0.1);
  const CellCoefficients coefficients = homogeneous_coefficients(grid, test::grey_material(marble));
  Polygrid flat = grid;
  flat.points.row(flat.cells(20, 1)) = flat.points.row(flat.cells(20, 0));
  Polygrid inverted = grid;
  std::swap(inverted.cells(20, 0), inverted.cells(20, 6));
  for (const Polygrid& bad : {flat, inverted}) {
    try {
      assemble_polygrid_system(bad, coefficients, 1.5);
      FAIL() << "accepted";
    } catch (const InputError& error) {
      EXPECT_NE(std::string(error.what()).find("inverted or flat"), std::string::npos);
      EXPECT_NE(std::string(error.what()).find("mm"), std::string::npos);
    }
  }
}

TEST(PolygridSystem, RefusesIndicesOutOfRangeNaNAndMissingQuads) {
  const Polygrid grid = test::ball_grid(4, 5, 0.1);
  const CellCoefficients coefficients = homogeneous_coefficients(grid, test::grey_material(marble));
  Polygrid bad = grid;
  bad.cells(3, 3) = static_cast<std::int32_t>(grid.points.rows());
  EXPECT_THROW(assemble_polygrid_system(bad, coefficients, 1.5), InputError);
  bad = grid;
  bad.points(7, 1) = std::nan("");
  EXPECT_THROW(assemble_polygrid_system(bad, coefficients, 1.5), InputError);
  bad = grid;
  bad.boundary_quads.resize(0, 4);
  EXPECT_THROW(assemble_polygrid_system(bad, coefficients, 1.5), InputError);
  bad = grid;
  bad.outer_twin.pop_back();
  EXPECT_THROW(assemble_polygrid_system(bad, coefficients, 1.5), InputError);
  EXPECT_THROW(assemble_polygrid_system(grid, coefficients, 0.5), InputError);
  EXPECT_THROW(assemble_polygrid_system(test::ball_grid(5, 5, 0.1), coefficients, 1.5), InputError);
}

TEST(CellCoefficients, RefusesMaterialsThatNoObjectHas) {
  const Polygrid grid = test::ball_grid(4, 5, 0.1);
  Material negative = test::grey_material(marble), empty, mirror = negative, nan = negative;
  negative.extinction[1] = -1;
  mirror.anisotropy[0] = 1;
  nan.albedo[2] = std::nanf("");
  for (const Material& bad : {negative, empty, mirror, nan})
    EXPECT_THROW(homogeneous_coefficients(grid, bad), InputError);
}

TEST(CellCoefficients, ReadsShellWhereActiveAndCoreElsewhere) {
  const Polygrid grid = test::ball_grid(8, 4, 0.1);
  ShellVolume shell;
  shell.frame = {Vec3::Constant(-6), 0.5};
  const Vec3i leaves = Vec3i::Constant(4);
  for (auto* field : {&shell.extinction, &shell.albedo, &shell.anisotropy})
    *field = TwoLevelGrid<Vec3f>(Vec3i::Zero(), leaves, Vec3f::Zero());
  for (int i = 0; i < 25; ++i)
    for (int j = 0; j < 25; ++j)
      for (int k = 13; k < 25; ++k) {  // the upper half, z ≥ 0.5
        shell.extinction.set(i, j, k, Vec3f(2, 4, 6));
        shell.albedo.set(i, j, k, Vec3f::Constant(0.75f));
        shell.anisotropy.set(i, j, k, Vec3f::Constant(0.5f));
      }
  shell.core = test::grey_material({0.5, 1.0});
  const CellCoefficients c = sample_coefficients(grid, shell);
  int above = 0, below = 0;
  for (int cell = 0; cell < grid.cells.rows(); ++cell)
    for (int corner = 0; corner < 8; ++corner) {
      const double z = gauss_point(grid, cell, corner).z();
      const std::size_t at = 8 * static_cast<std::size_t>(cell) + corner;
      if (z > 0.01) {
        ++above;
        ASSERT_FLOAT_EQ(c.absorption[at][1], 1.0f);                 // 4 (1 − .75)
        ASSERT_FLOAT_EQ(c.reduced_extinction[at][1], 1.0f + 1.5f);  // + 4 · .75 · .5
      } else if (z < -0.01) {
        ++below;
        ASSERT_FLOAT_EQ(c.absorption[at][1], 0.5f);
        ASSERT_FLOAT_EQ(c.reduced_extinction[at][1], 1.5f);
      }
    }
  EXPECT_GT(above, 1000);
  EXPECT_GT(below, 1000);
  EXPECT_EQ(c.floored, 0);
}

}  // namespace
}  // namespace shellgrid
