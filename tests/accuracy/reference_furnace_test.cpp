// SPDX-License-Identifier: AGPL-3.0-or-later
// The reference in the white furnace, and how its errors fall. SG_LONG follows more paths.
#include <gtest/gtest.h>

#include <cmath>
#include <cstdio>
#include <cstdlib>
#include <numbers>

#include "meshing/core/random.h"
#include "solvers/transport/camera_paths.h"
#include "solvers/transport/light_tracing.h"
#include "tests/support/closed_shapes.h"
#include "tests/support/shell_shapes.h"

namespace shellgrid {
namespace {

double paths(double short_form) { return std::getenv("SG_LONG") ? 50 * short_form : short_form; }

std::vector<Light> even_sky() {
  EnvironmentLight sky;
  sky.zenith = sky.horizon = sky.ground = Rgb::Ones();
  return {sky};
}

// White; each voxel of its own extinction, over three decades, and anisotropy.
Material white(const Vec3& p) {
  const std::uint64_t place = hash64(static_cast<std::uint64_t>(std::llround(1e3 * p.x() + 1e6)),
                                     static_cast<std::uint64_t>(std::llround(1e3 * p.y() + 1e6)),
                                     static_cast<std::uint64_t>(std::llround(1e3 * p.z() + 1e6)));
  Material m;
  m.extinction = Rgb::Constant(static_cast<float>(0.02 * std::pow(1000.0, to_unit(place))));
  m.albedo = Rgb::Ones();
  m.anisotropy = Rgb::Constant(static_cast<float>(1.6 * to_unit(hash64(place)) - 0.8));
  return m;
}

struct Furnace {
  double traced;     // |leaving − entering| over incoming
  double radiance;   // of the picture, the pixel farthest from 1
  double deviation;  // of the vertices' exitance from what it should be, in standard errors, root mean square
};

Furnace measure(const TransportObject& object) {
  const LightTracing tracing(object, even_sky(), {});
  const PathKind kind = tracing.kind();
  PathState state(kind.scalars, kind.field_size);
  PathLimits limits;
  limits.paths = paths(6000);
  follow_paths(kind, limits, state);
  const LightTracingResult r = tracing.result(state);
  Furnace f{};
  for (int c = 0; c < 3; ++c)
    f.traced = std::max(
        f.traced, std::abs(r.leaving.channel[c].value - r.entering.channel[c].value) / r.incoming.channel[c].value);
  double squares = 0, count = 0;
  for (std::size_t v = 0; v < r.exitance.size(); ++v) {
    const double error = std::hypot<double>(r.exitance_error[v][0], r.irradiance_error[v][0]);
    if (!(error > 0)) continue;
    squares += std::pow((r.exitance[v][0] - r.irradiance[v][0]) / error, 2);
    ++count;
  }
  f.deviation = std::sqrt(squares / count);
  Camera camera;
  camera.position = Vec3(9, 7, 30);
  camera.fov = 24;
  camera.width = camera.height = 24;
  const CameraPaths pictures(object, even_sky(), camera, {});
  const PathKind picture_kind = pictures.kind();
  PathState picture_state(picture_kind.scalars, picture_kind.field_size);
  limits.paths = paths(4.0 * 24 * 24);
  follow_paths(picture_kind, limits, picture_state);
  const Image image = pictures.picture(picture_state);
  for (const char* name : {"R", "G", "B"})
    for (const float value : image.find(name)->values) f.radiance = std::max(f.radiance, std::abs(value - 1.0));
  return f;
}

TEST(ReferenceFurnace, WhiteObjectsOfAnyShapeIndexAndMatter) {
  const TriangleMesh ball = shapes::sphere(5, 4), box = shapes::rotated(shapes::box(Vec3(7, 5, 6)), 3),
                     ring = shapes::torus(3.5, 1.4, 60, 30);
  const auto to_ball = [](const Vec3& p) { return p.norm() - 5; };
  const auto to_ring = [](const Vec3& p) { return std::hypot(std::hypot(p.x(), p.y()) - 3.5, p.z()) - 1.4; };
  const auto voxel = [](const Vec3& p, double) { return test::ShellVoxel{white(p)}; };
  const auto pitted = [](const Vec3& p, double depth) {
    return test::ShellVoxel{white(p),
                            depth < 1.5 * std::sin(2 * p.x()) * std::sin(2 * p.y()) * std::sin(2 * p.z()) ? 0 : 1};
  };
  const Material core = white(Vec3::Zero());
  const ShellVolume ball_shell = test::shell_of(to_ball, 5, 0.4, 2, core, voxel),
                    ring_shell = test::shell_of(to_ring, 5, 0.3, 1, core, voxel),
                    pits = test::shell_of(to_ball, 5, 0.25, 2, core, pitted);
  for (const double ior : {1.0, 1.33, 1.5, 2.4}) {
    const std::pair<const char*, TransportObject> objects[] = {
        {"homogeneous ball", TransportObject(ball, core, ior)},
        {"homogeneous box", TransportObject(box, core, ior)},
        {"homogeneous ring", TransportObject(ring, core, ior)},
        {"ball with a rough shell", TransportObject(ball, ball_shell, ior)},
        {"ring with a rough shell", TransportObject(ring, ring_shell, ior)},
        {"ball with pits", TransportObject(ball, pits, ior)}};
    for (const auto& [name, object] : objects) {
      const Furnace f = measure(object);
      std::printf(
          "index %.2f, %-24s |M - q| %.1e of the light, radiance within %.1e, vertices' deviation %.2f errors\n", ior,
          name, f.traced, f.radiance, f.deviation);
      EXPECT_LE(f.traced, 1e-3) << name;
      EXPECT_LE(f.radiance, 1e-3) << name;
      EXPECT_LT(f.deviation, 1.3) << name;
    }
  }
}

// White, of other extinction and anisotropy in each channel. Paths that carry all three move light between them, in the
// mean none; paths of their own return each exactly.
TEST(ReferenceFurnace, WhiteObjectsWhoseChannelsDiffer) {
  Material core;
  core.extinction = Rgb(0.5f, 1, 4);
  core.albedo = Rgb::Ones();
  core.anisotropy = Rgb(0, 0.4f, 0.8f);
  const TriangleMesh ball = shapes::sphere(5, 4);
  const auto voxel = [](const Vec3& p, double) {
    Material m = white(p);
    m.extinction *= Rgb(1, 0.3f, 3);
    m.anisotropy[1] *= -1;
    return test::ShellVoxel{m};
  };
  const ShellVolume shell = test::shell_of([](const Vec3& p) { return p.norm() - 5; }, 5, 0.4, 2, core, voxel);
  const std::pair<const char*, TransportObject> objects[] = {
      {"homogeneous ball", TransportObject(ball, core, 1.5)},
      {"ball with a rough shell", TransportObject(ball, shell, 1.5)}};
  for (const auto& [name, object] : objects)
    for (const bool apart : {false, true}) {
      LightTracingOptions options;
      options.channels_apart = apart;
      const LightTracing tracing(object, even_sky(), options);
      const PathKind kind = tracing.kind();
      PathState state(kind.scalars, kind.field_size);
      PathLimits limits;
      limits.paths = paths(6000);
      follow_paths(kind, limits, state);
      const LightTracingResult r = tracing.result(state);
      for (int c = 0; c < 3; ++c) {
        const double incoming = r.incoming.channel[c].value;
        const double off = std::abs(r.leaving.channel[c].value - r.entering.channel[c].value) / incoming;
        const double error = r.exchange.channel[c].standard_error / incoming;
        std::printf("%-24s %s, channel %d: |M - q| %.1e of the light, standard error %.1e\n", name,
                    apart ? "paths apart" : "one path   ", c, off, error);
        EXPECT_LE(off, apart ? 1e-12 : 4 * error) << name;
        EXPECT_EQ(error > 1e-9, !apart);
      }
    }
}

// Root mean square error of a lit ball's exitance, against a run of many more paths with another seed.
TEST(ReferenceConvergence, ErrorsFallWithTheSquareRootOfThePaths) {
  const TriangleMesh ball = shapes::sphere(3, 3);
  const TransportObject object(
      ball, Material::from_absorption_scattering(Rgb(0.01f, 0.05f, 0.2f), Rgb(3, 2, 1), Rgb(0, 0.4f, 0.8f)), 1.4);
  const std::vector<Light> sun = {DirectionalLight{Vec3(0.2, -1, 0.3).normalized(), Rgb::Ones()}};
  const auto trace = [&](double count, std::uint64_t seed) {
    LightTracingOptions options;
    options.seed = seed;
    const LightTracing tracing(object, sun, options);
    const PathKind kind = tracing.kind();
    PathState state(kind.scalars, kind.field_size);
    PathLimits limits;
    limits.paths = count;
    follow_paths(kind, limits, state);
    return tracing.result(state);
  };
  const double most = paths(64000);
  const LightTracingResult exact = trace(8 * most, 99);
  double errors[4], claimed[4];
  for (int k = 0; k < 4; ++k) {
    const double count = most / std::pow(4.0, 3 - k);
    const LightTracingResult r = trace(count, static_cast<std::uint64_t>(k));
    double squares = 0, sum = 0;
    for (std::size_t v = 0; v < r.exitance.size(); ++v) {
      squares += (r.exitance[v] - exact.exitance[v]).matrix().squaredNorm();
      sum += exact.exitance[v].matrix().squaredNorm();
    }
    errors[k] = std::sqrt(squares / sum);
    claimed[k] = r.relative_error.value();
    std::printf("%9.0f paths: relative error %.4f, claimed (worst channel) %.4f\n", count, errors[k], claimed[k]);
  }
  const double slope = std::log(errors[3] / errors[0]) / std::log(64.0);
  std::printf("slope %.3f\n", slope);
  EXPECT_NEAR(slope, -0.5, 0.06);
  EXPECT_NEAR(std::log(claimed[3] / claimed[0]) / std::log(64.0), -0.5, 0.06);
}

}  // namespace
}  // namespace shellgrid
