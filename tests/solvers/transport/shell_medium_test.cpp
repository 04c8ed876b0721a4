// SPDX-License-Identifier: AGPL-3.0-or-later
#include "solvers/transport/shell_medium.h"

#include <gtest/gtest.h>

#include <cmath>
#include <limits>
#include <numbers>

#include "meshing/core/error.h"
#include "meshing/core/random.h"
#include "solvers/transport/light_tracing.h"
#include "tests/support/chi_square.h"
#include "tests/support/closed_shapes.h"
#include "tests/support/shell_shapes.h"

namespace shellgrid {
namespace {

constexpr double pi = std::numbers::pi;

Material grey(double absorption, double scattering, double anisotropy = 0) {
  return Material::from_absorption_scattering(Rgb::Constant(static_cast<float>(absorption)),
                                              Rgb::Constant(static_cast<float>(scattering)),
                                              Rgb::Constant(static_cast<float>(anisotropy)));
}

double to_ball(const Vec3& p) { return p.norm() - 5; }

// Coefficients drawn anew for each voxel, over a factor of `contrast`, of each channel its own.
Material drawn(const Vec3& p, double scale, double contrast, bool white) {
  const std::uint64_t place = hash64(static_cast<std::uint64_t>(std::llround(1e3 * p.x() + 1e6)),
                                     static_cast<std::uint64_t>(std::llround(1e3 * p.y() + 1e6)),
                                     static_cast<std::uint64_t>(std::llround(1e3 * p.z() + 1e6)));
  RandomStream random(place);
  Material m;
  for (int c = 0; c < 3; ++c) {
    m.extinction[c] = static_cast<float>(scale * std::pow(contrast, random.next()));
    m.albedo[c] = white ? 1.0f : static_cast<float>(random.next());
    m.anisotropy[c] = static_cast<float>(1.6 * random.next() - 0.8);
  }
  return m;
}

LightTracingResult trace(const TransportObject& object, const std::vector<Light>& lights, double paths,
                         PathState* gathered = nullptr) {
  const LightTracing tracing(object, lights, {});
  const PathKind kind = tracing.kind();
  PathState state(kind.scalars, kind.field_size);
  PathLimits limits;
  limits.paths = paths;
  follow_paths(kind, limits, state);
  if (gathered) *gathered = state;
  return tracing.result(state);
}

std::vector<Light> even_sky() {
  EnvironmentLight sky;
  sky.zenith = sky.horizon = sky.ground = Rgb::Ones();
  return {sky};
}

// Collisions along a line through voxels of many kinds, against e^{−∫σ}, in each channel by itself.
void expect_free_paths(const ShellVolume& shell, const LeafMethod* method) {
  const Vec3 from(-4.6, 0.7, -0.4), direction = Vec3(1, 0.11, 0.23).normalized();
  constexpr double length = 9;
  constexpr int bins = 45, samples = 60000, steps = 200000;
  const auto extinction = [&](const Vec3& p, int c) {
    const Vec3 index = shell.frame.to_index(p);
    const Vec3i v = (index + Vec3::Constant(0.5)).array().floor().matrix().cast<int>();
    return shell.extinction.is_active(v.x(), v.y(), v.z()) ? shell.extinction.value(v.x(), v.y(), v.z())[c]
                                                           : shell.core.extinction[c];
  };
  const ShellMedium medium(
      shell, [](const Vec3& p) { return to_ball(p) < 0; }, nullptr, method);
  EXPECT_EQ(medium.methods().one_majorant, method == nullptr);
  for (int channel = 0; channel < 3; ++channel) {
    // All weight in one channel: then collisions are drawn by it alone.
    std::vector<double> expected(bins + 1, 0.0), counts(bins + 1, 0.0);
    double passed = 1;
    for (int s = 0; s < steps; ++s) {
      const double t = length * (s + 0.5) / steps,
                   kept = passed * std::exp(-extinction(from + t * direction, channel) * length / steps);
      expected[static_cast<int>(t / length * bins)] += samples * (passed - kept);
      passed = kept;
    }
    expected[bins] = samples * passed;
    ChunkTally tally;
    for (int n = 0; n < samples; ++n) {
      LightPath path{PathRandom(11, n)};
      path.point = from;
      path.direction = direction;
      path.weight[channel] = 1;
      // The surface is 9 mm away; half of the paths know beforehand that it is 2.5.
      const auto ahead = [&](double limit) {
        return limit < length ? std::numeric_limits<double>::infinity() : length;
      };
      const bool collides = medium.fly(path, n % 2 ? 2.5 : 0, ahead, tally);
      ++counts[collides ? std::min(bins - 1, static_cast<int>((path.point - from).norm() / length * bins)) : bins];
      ASSERT_NEAR(path.weight[channel], 1, 1e-9);
    }
    EXPECT_LT(std::abs(test::chi_square_deviate(counts, expected)), 4) << channel;
  }
}

TEST(ShellMedium, FreePathsFollowTheirDensityInEveryChannel) {
  const ShellVolume shell = test::shell_of(to_ball, 5, 0.4, 3, grey(0, 0.3), [](const Vec3& p, double) {
    return test::ShellVoxel{drawn(p, 0.02, 40, true)};
  });
  for (const LeafMethod method : {LeafMethod::uniform, LeafMethod::voxels, LeafMethod::delta})
    expect_free_paths(shell, &method);
  expect_free_paths(test::shell_of(to_ball, 5, 0.4, 3, grey(0, 0.15),
                                   [](const Vec3& p, double) { return test::ShellVoxel{drawn(p, 0.1, 1.9, true)}; }),
                    nullptr);
}

// One path carries three channels: what each is worth where it collides, and where it gets through, is what its own
// extinction says.
TEST(ShellMedium, ChannelsOfOnePathEachFollowTheirOwnDensity) {
  const ShellVolume shell = test::shell_of(to_ball, 5, 0.4, 3, grey(0, 0.3), [](const Vec3& p, double) {
    return test::ShellVoxel{drawn(p, 0.02, 40, true)};
  });
  const Vec3 from(-4.6, 0.7, -0.4), direction = Vec3(1, 0.11, 0.23).normalized();
  constexpr double length = 9;
  constexpr int samples = 100000, steps = 100000;
  for (const LeafMethod method : {LeafMethod::voxels, LeafMethod::delta}) {
    const ShellMedium medium(
        shell, [](const Vec3& p) { return to_ball(p) < 0; }, nullptr, &method);
    Eigen::Array3d through = Eigen::Array3d::Zero(), square = through;
    ChunkTally tally;
    for (int n = 0; n < samples; ++n) {
      LightPath path{PathRandom(12, n)};
      path.point = from;
      path.direction = direction;
      path.weight = Double4{0.2, 0.3, 0.5, 0};
      const bool collides = medium.fly(
          path, 0, [&](double) { return length; }, tally);
      ASSERT_NEAR(lane_sum(path.weight), 1, 1e-9);
      if (collides) continue;
      const Eigen::Array3d w(path.weight[0], path.weight[1], path.weight[2]);
      through += w / samples;
      square += w * w / samples;
    }
    for (int c = 0; c < 3; ++c) {
      double depth = 0;
      for (int s = 0; s < steps; ++s) {
        const Vec3 index = shell.frame.to_index(from + length * (s + 0.5) / steps * direction);
        const Vec3i v = (index + Vec3::Constant(0.5)).array().floor().matrix().cast<int>();
        depth +=
            length / steps *
            (shell.extinction.is_active(v.x(), v.y(), v.z()) ? shell.extinction.value(v.x(), v.y(), v.z())[c] : 0.3);
      }
      const double expected = std::exp(-depth) * (c == 0 ? 0.2 : c == 1 ? 0.3 : 0.5);
      EXPECT_NEAR(through[c], expected, 4 * std::sqrt((square[c] - through[c] * through[c]) / samples)) << c;
    }
  }
}

// A shell of the core's own matter changes nothing.
TEST(ShellMedium, AShellOfTheCoresMatterIsAHomogeneousObject) {
  const Material matter =
      Material::from_absorption_scattering(Rgb(0.02f, 0.1f, 0.3f), Rgb(2, 1, 0.5f), Rgb(0, 0.4f, 0.8f));
  const TriangleMesh ball = shapes::sphere(5, 4);
  const ShellVolume shell =
      test::shell_of(to_ball, 5, 0.5, 2, matter, [&](const Vec3&, double) { return test::ShellVoxel{matter}; });
  const std::vector<Light> sun = {DirectionalLight{Vec3(0, 0.5, -1).normalized(), Rgb::Ones()}};
  const TransportObject homogeneous(ball, matter, 1.4), voxels(ball, shell, 1.4);
  EXPECT_EQ(voxels.free_space().face_count(), 0);
  const LightTracingResult a = trace(homogeneous, sun, 40000), b = trace(voxels, sun, 40000);
  for (int c = 0; c < 3; ++c) {
    const auto near = [&](const Estimate& x, const Estimate& y) {
      EXPECT_NEAR(x.value, y.value, 4 * std::hypot(x.standard_error, y.standard_error)) << c;
    };
    near(a.leaving.channel[c], b.leaving.channel[c]);
    const Estimate shell_part = b.absorbed_shell.channel[c], core_part = b.absorbed_core.channel[c];
    EXPECT_GT(shell_part.value, 0);
    EXPECT_GT(core_part.value, 0);
    near(a.absorbed_core.channel[c],
         {shell_part.value + core_part.value, std::hypot(shell_part.standard_error, core_part.standard_error)});
  }
}

// Voxels of hundreds of mean free paths are leapt through, alone and where others like them are about.
TEST(ShellMedium, ThickVoxelsAreLeaptThrough) {
  const Material matter =
      Material::from_absorption_scattering(Rgb(0, 0.002f, 0.1f), Rgb::Constant(1000), Rgb::Constant(0.3f));
  Material other = matter;
  other.anisotropy = Rgb::Constant(0.3001f);
  const TriangleMesh ball = shapes::sphere(5, 4);
  const std::vector<Light> sun = {DirectionalLight{Vec3(0, 0.5, -1).normalized(), Rgb::Ones()}};
  PathState gathered;
  const LightTracingResult a = trace(TransportObject(ball, matter, 1.4), sun, 3000);
  for (const bool mixed : {false, true}) {
    // Of two kinds that differ by next to nothing: no voxel has its like all about it.
    const ShellVolume shell = test::shell_of(to_ball, 5, 0.25, 2, matter, [&](const Vec3& p, double) {
      return test::ShellVoxel{mixed && (std::llround(p.sum() / 0.25) & 1) ? other : matter};
    });
    const LightTracingResult b = trace(TransportObject(ball, shell, 1.4), sun, 2000, &gathered);
    EXPECT_GT(gathered.count(PathEvent::leaps), 1000u);
    EXPECT_LE(gathered.count(PathEvent::limit_roulette), mixed ? 4u : 0u);
    for (int c = 0; c < 3; ++c) {
      const auto near = [&](const Estimate& x, const Estimate& y) {
        EXPECT_NEAR(x.value, y.value, 4 * std::hypot(x.standard_error, y.standard_error) + 1e-3 * x.value) << c;
      };
      near(a.leaving.channel[c], b.leaving.channel[c]);
      const Estimate shell_part = b.absorbed_shell.channel[c], core_part = b.absorbed_core.channel[c];
      near(a.absorbed_core.channel[c],
           {shell_part.value + core_part.value, std::hypot(shell_part.standard_error, core_part.standard_error)});
    }
  }
}

TEST(ShellMedium, AllMethodsAgree) {
  const TriangleMesh ball = shapes::sphere(5, 4);
  const ShellVolume shell = test::shell_of(to_ball, 5, 0.4, 2, grey(0.01, 1, 0.3), [](const Vec3& p, double) {
    return test::ShellVoxel{drawn(p, 0.1, 30, false)};
  });
  const std::vector<Light> sun = {DirectionalLight{Vec3(0, 0.5, -1).normalized(), Rgb::Ones()}};
  const LeafMethod methods[2] = {LeafMethod::voxels, LeafMethod::delta};
  const LightTracingResult a = trace(TransportObject(ball, shell, 1.3, &methods[0]), sun, 40000),
                           b = trace(TransportObject(ball, shell, 1.3, &methods[1]), sun, 40000);
  for (int c = 0; c < 3; ++c)
    for (const auto& [x, y] : {std::pair{a.leaving.channel[c], b.leaving.channel[c]},
                               {a.absorbed_core.channel[c], b.absorbed_core.channel[c]},
                               {a.absorbed_shell.channel[c], b.absorbed_shell.channel[c]}})
      EXPECT_NEAR(x.value, y.value, 4 * std::hypot(x.standard_error, y.standard_error)) << c;
}

TEST(ShellMedium, LeavesTakeTheMethodThatFitsThem) {
  const auto counts = [](const std::function<Material(const Vec3&)>& matter) {
    const ShellVolume shell = test::shell_of(to_ball, 5, 0.25, 4, matter(Vec3::Zero()),
                                             [&](const Vec3& p, double) { return test::ShellVoxel{matter(p)}; });
    return ShellMedium(shell, [](const Vec3& p) { return to_ball(p) < 0; }).methods();
  };
  const LeafMethodCounts even = counts([](const Vec3&) { return grey(0, 1); });
  EXPECT_EQ(even.voxels, 0u);
  EXPECT_GT(even.uniform, 20u);  // all but those that hold some of the core, too
  EXPECT_FALSE(even.one_majorant);
  const LeafMethodCounts rough = counts([](const Vec3& p) { return drawn(p, 1, 100, true); });
  EXPECT_EQ(rough.delta, 0u);
  EXPECT_GT(rough.voxels, 50u);
  const LeafMethodCounts thin = counts([](const Vec3& p) { return drawn(p, 0.1, 1.5, true); });
  EXPECT_EQ(thin.voxels, 0u);
  EXPECT_GT(thin.delta, 50u);
  EXPECT_TRUE(thin.one_majorant);
}

// White matter of every kind in bumps and pits: nothing is lost, and as much leaves as enters.
TEST(ShellMedium, WhiteFurnaceWithFreeSpace) {
  const TriangleMesh ball = shapes::sphere(5, 4);
  const auto pitted = [](const Vec3& p, double depth) {
    const double wave = std::sin(2.1 * p.x()) * std::sin(1.9 * p.y()) * std::sin(2.3 * p.z());
    test::ShellVoxel voxel{drawn(p, 0.3, 30, true)};
    voxel.kind = depth < 1.6 * wave + 0.2 ? 0 : 1;
    // One channel for all: then each path's account closes.
    voxel.material.extinction = Rgb::Constant(voxel.material.extinction[0]);
    voxel.material.anisotropy = Rgb::Constant(voxel.material.anisotropy[0]);
    return voxel;
  };
  const ShellVolume shell = test::shell_of(to_ball, 5, 0.25, 2, grey(0, 1), pitted);
  for (const double ior : {1.0, 1.5}) {
    const TransportObject object(ball, shell, ior);
    EXPECT_GT(object.free_space().face_count(), 1000);
    PathState state;
    const LightTracingResult r = trace(object, even_sky(), 30000, &state);
    for (int c = 0; c < 3; ++c) {
      const double in = r.incoming.channel[c].value;
      EXPECT_NEAR(r.leaving.channel[c].value, r.entering.channel[c].value, 1e-3 * in);
      EXPECT_NEAR(r.entering.channel[c].value + r.mirrored.channel[c].value, in, 1e-3 * in);
      EXPECT_LE(r.lost.channel[c].value, 2e-4 * in);
    }
    EXPECT_LE(static_cast<double>(state.count(PathEvent::lost)), 2e-4 * static_cast<double>(state.paths));
    // Pits take light as the even surface would, but for what their walls mirror to one another.
    double squares = 0;
    for (int v = 0; v < ball.vertex_count(); ++v)
      squares += std::pow((r.exitance[v][0] - r.irradiance[v][0]) /
                              std::max(1e-9, std::hypot<double>(r.exitance_error[v][0], r.irradiance_error[v][0])),
                          2);
    EXPECT_LT(squares / ball.vertex_count(), 1 + 4 * std::sqrt(2.0 / ball.vertex_count()));
  }
}

// A shell that is free space throughout is not there: light meets the core below it, and leaves through where it was.
TEST(ShellMedium, AShellOfNothingLaysTheCoreBare) {
  const TriangleMesh ball = shapes::sphere(5, 4);
  const ShellVolume shell = test::shell_of(to_ball, 5, 0.2, 2, grey(0.1, 2), [](const Vec3&, double) {
    return test::ShellVoxel{Material(), 0};
  });
  const TransportObject object(ball, shell, 1.4), small(shapes::sphere(3, 4), grey(0.1, 2), 1.4);
  const LightTracingResult bare = trace(object, even_sky(), 40000), alone = trace(small, even_sky(), 20000);
  for (const auto& [x, y] : {std::pair{bare.entering.channel[0], alone.entering.channel[0]},
                             {bare.leaving.channel[0], alone.leaving.channel[0]},
                             {bare.absorbed_core.channel[0], alone.absorbed_core.channel[0]}})
    EXPECT_NEAR(x.value, y.value, 4 * std::hypot(x.standard_error, y.standard_error) + 0.03 * y.value);
  EXPECT_NEAR(bare.incoming.channel[0].value, 4 * pi * pi * 25, 0.03 * 4 * pi * pi * 25);
}

TEST(ShellMedium, VoxelsAtTheSurfaceBelongToTheShell) {
  // An absorbing core must not show where the surface cuts voxels whose samples lie outside.
  const TriangleMesh ball = shapes::sphere(5, 5);
  const ShellVolume shell = test::shell_of(to_ball, 5, 0.5, 2, grey(50, 0),
                                           [](const Vec3&, double) { return test::ShellVoxel{grey(0, 60)}; });
  const LightTracingResult r = trace(TransportObject(ball, shell, 1), even_sky(), 4000);
  EXPECT_LT(r.absorbed_core.channel[0].value, 0.03 * r.entering.channel[0].value);
}

TEST(ShellMedium, NonsenseIsRefused) {
  const TriangleMesh ball = shapes::sphere(5, 3);
  ShellVolume shell =
      test::shell_of(to_ball, 5, 0.5, 2, grey(0, 1), [](const Vec3&, double) { return test::ShellVoxel{grey(0, 1)}; });
  shell.extinction.leaf_values(0)[0] = Vec3f::Constant(-1);
  for (int n = 0; n < 512; ++n) shell.extinction.leaf_values(0)[n] = Vec3f::Constant(-1);
  EXPECT_THROW(TransportObject(ball, shell, 1), InputError);
}

}  // namespace
}  // namespace shellgrid
