// SPDX-License-Identifier: AGPL-3.0-or-later
#include "solvers/diffusion/core_extension.h"

#include <gtest/gtest.h>

#include <cmath>
#include <functional>

#include "meshing/core/error.h"
#include "solvers/diffusion/cell_coefficients.h"
#include "tests/support/diffusion_problem.h"

namespace shellgrid {
namespace {

constexpr double edge = 12, thickness = 2.4;

// A shell of the cube [0, 12]³ whose material depends on the place; its homogeneous core is something else.
ShellVolume cube_shell(const std::function<Material(const Vec3&, double)>& material) {
  ShellVolume shell;
  shell.frame.voxel = 0.4;
  const TwoLevelGrid<Vec3f> empty(Vec3i::Zero(), Vec3i::Constant(4), Vec3f::Zero());
  shell.texture_coordinate = shell.extinction = shell.albedo = shell.anisotropy = shell.normal = empty;
  shell.kind = TwoLevelGrid<std::int32_t>(Vec3i::Zero(), Vec3i::Constant(4), 1);
  for (int i = 0; i <= 30; ++i)
    for (int j = 0; j <= 30; ++j)
      for (int k = 0; k <= 30; ++k) {
        const Vec3 at = shell.frame.to_world({i, j, k});
        const double depth = std::min(at.minCoeff(), edge - at.maxCoeff());
        if (depth > thickness) continue;
        const Material m = material(at, depth);
        shell.texture_coordinate.set(i, j, k, Vec3f(0, 0, static_cast<float>(depth / shell.frame.voxel)));
        shell.extinction.set(i, j, k, m.extinction.matrix());
        shell.albedo.set(i, j, k, m.albedo.matrix());
        shell.anisotropy.set(i, j, k, m.anisotropy.matrix());
        shell.kind.set(i, j, k, 1);
      }
  shell.core = test::grey_material({0.7, 9});
  shell.core_interpolated = true;
  shell.thickness = thickness;
  shell.ior = 1.5;
  return shell;
}

const Polygrid& cube() {
  static const Polygrid grid = test::cube_grid(16, edge, 0.1);
  return grid;
}

// Calls visit(point, sample's number) for the Gauss points more than 0.7 mm below the shell.
void below_shell(const std::function<void(const Vec3&, std::size_t)>& visit) {
  int count = 0;
  for (int cell = 0; cell < cube().cells.rows(); ++cell)
    for (int corner = 0; corner < 8; ++corner) {
      const Vec3 x = gauss_point(cube(), cell, corner);
      if (std::min(x.minCoeff(), edge - x.maxCoeff()) < thickness + 0.7) continue;
      visit(x, 8 * static_cast<std::size_t>(cell) + corner);
      ++count;
    }
  ASSERT_GT(count, 1000);
}

TEST(CoreExtension, AConstantBottomLayerGivesAConstantCoreWhateverLiesAbove) {
  const ShellVolume shell = cube_shell([](const Vec3& at, double depth) {
    return depth > thickness - 0.41 ? test::grey_material({0.02, 1.5})
                                    : test::grey_material({0.3 + 0.05 * at.x(), 0.5});
  });
  const CellCoefficients c = sample_coefficients(cube(), shell);
  ASSERT_TRUE(c.core);
  EXPECT_GT(c.core->free_points, 500u);
  EXPECT_GT(c.core->boundary_points, 200u);
  EXPECT_LE(c.core->residual, c.core->tolerance);
  below_shell([&](const Vec3&, std::size_t k) {
    ASSERT_NEAR(c.absorption[k][1], 0.02, 1e-6);
    ASSERT_NEAR(c.reduced_extinction[k][1], 1.52, 1e-5);
  });
}

TEST(CoreExtension, NeverLeavesTheRangeOfTheBottomLayer) {
  // Differs from voxel to voxel by a factor of up to 50, and from channel to channel.
  const ShellVolume shell = cube_shell([](const Vec3& at, double) {
    const auto noise = static_cast<float>(std::fmod(std::abs(std::sin(at.dot(Vec3(12.9, 78.2, 37.7))) * 43758.5), 1.0));
    return Material::from_absorption_scattering(Rgb(0.01f, 0.02f, 0) + noise * Rgb(0.5f, 0.1f, 0),
                                                Rgb(1, 2, 3) + 4 * noise, Rgb::Zero());
  });
  const CellCoefficients c = sample_coefficients(cube(), shell);
  below_shell([&](const Vec3&, std::size_t k) {
    for (int channel = 0; channel < 3; ++channel) {
      const float low[3] = {0.01f, 0.02f, 0}, high[3] = {0.51f, 0.12f, 0};
      ASSERT_GE(c.absorption[k][channel], low[channel] * 0.99999f);
      ASSERT_LE(c.absorption[k][channel], high[channel] * 1.00001f);
    }
    ASSERT_GE(c.reduced_extinction[k][0], 1.0f);
    ASSERT_LE(c.reduced_extinction[k][0], 5.51f);
    ASSERT_LE(c.absorption[k][0], c.reduced_extinction[k][0]);
  });
}

TEST(CoreExtension, TwoHalvesMeetInAMonotoneTransition) {
  const ShellVolume shell = cube_shell([](const Vec3& at, double) {
    return at.x() < 0.5 * edge ? test::grey_material({0.01, 1}) : test::grey_material({0.05, 3});
  });
  const CellCoefficients c = sample_coefficients(cube(), shell);
  const CoreExtension& core = *c.core;
  // Along each lattice line in x through the core the absorption rises, and midway it is midway.
  const int n = 17;
  int steps = 0;
  for (int z = 4; z <= 12; ++z)
    for (int y = 4; y <= 12; ++y)
      for (int x = 4; x < 12; ++x) {
        const int point = (z * n + y) * n + x;
        if (core.absorption[point][0] == 0 || core.absorption[point + 1][0] == 0) continue;
        ++steps;
        ASSERT_GE(core.absorption[point + 1][0], core.absorption[point][0] - 1e-7);
        ASSERT_GE(core.reduced_extinction[point + 1][2], core.reduced_extinction[point][2] - 1e-5);
      }
  EXPECT_GT(steps, 400);
  const int centre = (8 * n + 8) * n + 8;
  EXPECT_NEAR(core.absorption[centre][0], 0.03, 0.002);
  // Smooth: no step between neighbours in the middle is more than a third of the whole.
  for (int x = 4; x < 12; ++x) {
    const int point = (8 * n + 8) * n + x;
    EXPECT_LT(core.absorption[point + 1][0] - core.absorption[point][0], 0.04 / 3);
  }
}

TEST(CoreExtension, AHomogeneousCoreStaysWhatTheFileSays) {
  ShellVolume shell = cube_shell([](const Vec3&, double) { return test::grey_material({0.02, 1.5}); });
  shell.core_interpolated = false;
  const CellCoefficients c = sample_coefficients(cube(), shell);
  EXPECT_FALSE(c.core);
  below_shell([&](const Vec3&, std::size_t k) { ASSERT_FLOAT_EQ(c.absorption[k][1], 0.7f); });
}

TEST(CoreExtension, WithoutABottomLayerTheHomogeneousCoreStands) {
  ShellVolume shell = cube_shell([](const Vec3&, double) { return test::grey_material({0.02, 1.5}); });
  shell.thickness = 100;
  const CellCoefficients c = sample_coefficients(cube(), shell);
  below_shell([&](const Vec3&, std::size_t k) { ASSERT_NEAR(c.absorption[k][1], 0.7, 1e-6); });
}

TEST(CoreExtension, RefusesABottomLayerThatIsNotFinite) {
  const ShellVolume shell = cube_shell([](const Vec3& at, double) {
    return test::grey_material({at.x() > 9 ? std::nan("") : 0.02, 1.5});
  });
  EXPECT_THROW(sample_coefficients(cube(), shell), InputError);
}

}  // namespace
}  // namespace shellgrid
