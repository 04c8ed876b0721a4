// SPDX-License-Identifier: AGPL-3.0-or-later
#include "solvers/transport/core_voxels.h"

#include <gtest/gtest.h>

#include <cmath>

#include "meshing/core/error.h"
#include "meshing/core/random.h"
#include "solvers/transport/light_tracing.h"
#include "tests/support/closed_shapes.h"
#include "tests/support/shell_shapes.h"

namespace shellgrid {
namespace {

constexpr double radius = 5, voxel = 0.4, thickness = 1.6;

double to_ball(const Vec3& p) { return p.norm() - radius; }
bool in_ball(const Vec3& p) { return p.norm() < radius; }

ShellVolume ball_shell(const std::function<Material(const Vec3&)>& material, const Material& core = {}) {
  ShellVolume shell = test::shell_of(to_ball, radius, voxel, thickness, core,
                                     [&](const Vec3& p, double) { return test::ShellVoxel{material(p)}; });
  shell.core_interpolated = true;
  return shell;
}

Material matter(double absorption, double scattering, double anisotropy) {
  return Material::from_absorption_scattering(Rgb::Constant(static_cast<float>(absorption)),
                                              Rgb(1, 2, 3) * static_cast<float>(scattering),
                                              Rgb::Constant(static_cast<float>(anisotropy)));
}

// Calls visit(point, its material) for the voxels below the shell; checks that they are all there, and no others.
void visit_core(const ShellVolume& filled, const std::function<void(const Vec3&, const Material&)>& visit) {
  std::size_t inner = 0;
  const Vec3i low = 8 * filled.extinction.lower_leaf(), size = 8 * filled.extinction.leaf_counts();
  for (int i = low.x(); i < low.x() + size.x(); ++i)
    for (int j = low.y(); j < low.y() + size.y(); ++j)
      for (int k = low.z(); k < low.z() + size.z(); ++k) {
        const Vec3 p = filled.frame.to_world({i, j, k});
        ASSERT_EQ(filled.extinction.is_active(i, j, k), p.norm() <= radius) << p.transpose();
        if (p.norm() >= radius - thickness) continue;
        ASSERT_EQ(filled.kind.value(i, j, k), core_voxel_kind);
        ++inner;
        visit(p, {filled.extinction.value(i, j, k).array(), filled.albedo.value(i, j, k).array(),
                  filled.anisotropy.value(i, j, k).array()});
      }
  EXPECT_GT(inner, 1000u);
}

TEST(CoreVoxels, AConstantBottomLayerGivesAConstantCore) {
  visit_core(with_core_voxels(ball_shell([](const Vec3&) { return matter(0.1, 2, 0.5); }), in_ball),
             [](const Vec3&, const Material& m) {
               ASSERT_NEAR(m.absorption()[0], 0.1, 1e-4);
               ASSERT_NEAR(m.scattering()[2], 6, 1e-3);
               ASSERT_NEAR(m.anisotropy[1], 0.5, 1e-4);
             });
}

// Linear functions are harmonic.
TEST(CoreVoxels, ALinearBottomLayerIsContinuedLinearly) {
  const auto linear = [](const Vec3& p) { return 1 + 0.1 * p.x() - 0.05 * p.z(); };
  double worst = 0;
  visit_core(
      with_core_voxels(ball_shell([&](const Vec3& p) { return matter(0.2 * linear(p), 2 * linear(p), 0.3); }), in_ball),
      [&](const Vec3& p, const Material& m) {
        worst = std::max(worst, std::abs(m.absorption()[0] / 0.2 - linear(p)));
        ASSERT_NEAR(m.anisotropy[0], 0.3, 1e-3);
      });
  EXPECT_LT(worst, 0.11 * 1.5 * voxel);  // blocks are two voxels wide
}

TEST(CoreVoxels, NoValueLeavesTheRangeOfTheBottomLayer) {
  const auto random = [](const Vec3& p) {
    const std::uint64_t place = hash64(static_cast<std::uint64_t>(std::llround(1e3 * (p.x() + 100))),
                                       static_cast<std::uint64_t>(std::llround(1e6 * (p.y() + 100) + 1e3 * p.z())));
    return to_unit(place);
  };
  double least = 1e9, most = 0;
  visit_core(
      with_core_voxels(ball_shell([&](const Vec3& p) { return matter(random(p), 1 + 9 * random(p), 0); }), in_ball),
      [&](const Vec3&, const Material& m) {
        least = std::min<double>(least, m.scattering()[0]);
        most = std::max<double>(most, m.scattering()[0]);
        ASSERT_LE(m.albedo.maxCoeff(), 1);
      });
  EXPECT_GE(least, 1);
  EXPECT_LE(most, 10);
  EXPECT_GT(most - least, 1);
}

TEST(CoreVoxels, TransportMeetsThemAsItDoesAHomogeneousCore) {
  const TriangleMesh ball = shapes::sphere(radius, 3);
  const Material bottom = matter(0.05, 0.5, 0.2), top = matter(0.5, 0.2, 0);
  const auto material = [&](const Vec3& p) { return p.norm() < radius - thickness + 0.8 ? bottom : top; };
  ShellVolume plain = ball_shell(material, bottom), interpolated = ball_shell(material);
  plain.core_interpolated = false;
  const auto trace = [&](const ShellVolume& shell, std::uint64_t seed) {
    const TransportObject object(ball, shell, 1.4);
    LightTracingOptions options;
    options.seed = seed;
    const LightTracing tracing(object, {DirectionalLight{Vec3(0, 0, -1), Rgb::Ones()}}, options);
    const PathKind kind = tracing.kind();
    PathState state(kind.scalars, kind.field_size);
    PathLimits limits;
    limits.paths = 20000;
    follow_paths(kind, limits, state);
    return tracing.result(state);
  };
  const LightTracingResult a = trace(plain, 1), b = trace(interpolated, 2);
  for (int c = 0; c < 3; ++c) {
    const auto near = [c](const PowerEstimate& x, const PowerEstimate& y) {
      EXPECT_NEAR(x.channel[c].value, y.channel[c].value,
                  4 * std::hypot(x.channel[c].standard_error, y.channel[c].standard_error));
    };
    near(a.leaving, b.leaving);
    near(a.absorbed_core, b.absorbed_core);
    near(a.absorbed_shell, b.absorbed_shell);
    EXPECT_GT(b.absorbed_core.channel[c].value, 10 * b.absorbed_core.channel[c].standard_error);
  }
}

TEST(CoreVoxels, NonsenseIsRefused) {
  ShellVolume shell = ball_shell([](const Vec3&) { return matter(0.1, 2, 0.5); });
  // A shaft through the shell.
  ShellVolume open =
      test::shell_of([](const Vec3& p) { return p.head<2>().norm() < 1 && p.z() > 0 ? 1.0 : to_ball(p); }, radius,
                     voxel, thickness, {}, [](const Vec3&, double) { return test::ShellVoxel{matter(0.1, 2, 0.5)}; });
  open.core_interpolated = true;
  EXPECT_THROW(with_core_voxels(open, in_ball), InputError);
  for (int leaf = 0; leaf < shell.albedo.leaf_count(); ++leaf)
    for (int n = 0; n < 512; ++n) shell.albedo.leaf_values(leaf)[n] = Vec3f::Constant(-1);
  EXPECT_THROW(with_core_voxels(shell, in_ball), InputError);
}

}  // namespace
}  // namespace shellgrid
