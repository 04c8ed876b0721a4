// SPDX-License-Identifier: AGPL-3.0-or-later
// Transport at its extremes: every path ends, no power is lost but by counted cracks, nothing becomes NaN. SG_LONG
// follows a hundred times as many paths.
#include <gtest/gtest.h>

#include <cmath>
#include <cstdio>
#include <cstdlib>
#include <numbers>

#include "meshing/core/random.h"
#include "solvers/transport/light_tracing.h"
#include "tests/support/closed_shapes.h"
#include "tests/support/shell_shapes.h"

namespace shellgrid {
namespace {

double paths(double short_form) { return std::getenv("SG_LONG") ? 100 * short_form : short_form; }

Material matter(double extinction, double albedo, double anisotropy) {
  Material m;
  m.extinction = Rgb::Constant(static_cast<float>(extinction));
  m.albedo = Rgb::Constant(static_cast<float>(albedo));
  m.anisotropy = Rgb::Constant(static_cast<float>(anisotropy));
  return m;
}

std::vector<Light> even_sky() {
  EnvironmentLight sky;
  sky.zenith = sky.horizon = sky.ground = Rgb::Ones();
  return {sky};
}

// Traces, and holds the account to its sum. Returns the share of paths that were lost.
double trace(const TransportObject& object, const std::vector<Light>& lights, double count, const char* what) {
  const LightTracing tracing(object, lights, {});
  const PathKind kind = tracing.kind();
  PathState state(kind.scalars, kind.field_size);
  PathLimits limits;
  limits.paths = count;
  follow_paths(kind, limits, state);
  const LightTracingResult r = tracing.result(state);
  for (int c = 0; c < 3; ++c) {
    const double in = r.entering.channel[c].value, given = r.roulette.channel[c].value + r.exchange.channel[c].value;
    const double out = r.leaving.channel[c].value + r.absorbed_core.channel[c].value +
                       r.absorbed_shell.channel[c].value + r.lost.channel[c].value;
    EXPECT_TRUE(std::isfinite(in) && std::isfinite(out)) << what;
    EXPECT_NEAR(in + given, out, 1e-9 * (in + out)) << what;
    EXPECT_LE(r.lost.channel[c].value, 1e-4 * in + 1e-300) << what;
  }
  for (const Rgb& value : r.exitance) EXPECT_TRUE(value.isFinite().all() && (value >= 0).all()) << what;
  EXPECT_EQ(state.count(PathEvent::cut_off), 0u) << what;
  const auto lost =
      static_cast<double>(state.count(PathEvent::lost)) / static_cast<double>(state.count(PathEvent::object_met) + 1);
  std::printf("%-28s met %8llu, collisions %10llu, lost %llu, ended by the limit's roulette %llu\n", what,
              static_cast<unsigned long long>(state.count(PathEvent::object_met)),
              static_cast<unsigned long long>(state.count(PathEvent::collisions)),
              static_cast<unsigned long long>(state.count(PathEvent::lost)),
              static_cast<unsigned long long>(state.count(PathEvent::limit_roulette)));
  return lost;
}

TEST(TransportStress, ShapesWithoutMercy) {
  const TriangleMesh needle = shapes::double_cone(5, 0.01, 3, 3), disc = shapes::double_cone(100, 1, 1e-4, 1e-4),
                     spike = shapes::double_cone(3, 1, 30, 0.5), cube = shapes::rotated(shapes::box(Vec3(1, 1, 1)), 4),
                     plate = shapes::box(Vec3(1, 1, 1e-3)), ring = shapes::torus(1, 0.3, 30, 15),
                     twins =
                         shapes::joined(shapes::sphere(1, 3), shapes::moved(shapes::sphere(1, 3), Vec3(2.0001, 0, 0)));
  const std::pair<const char*, const TriangleMesh*> meshes[] = {
      {"needle", &needle}, {"disc", &disc}, {"spike", &spike},          {"cube", &cube},
      {"plate", &plate},   {"ring", &ring}, {"nearly touching", &twins}};
  for (const auto& [name, mesh] : meshes)
    for (const double ior : {1.0, 1.5, 4.0})
      EXPECT_LE(trace(TransportObject(*mesh, matter(3, 0.999, 0.5), ior), even_sky(), paths(2000), name), 1e-3);
}

// Light that is led along edges and through vertices, straight at them and nearly along faces.
TEST(TransportStress, EdgesVerticesAndGrazingLight) {
  const TriangleMesh cube = shapes::box(Vec3(2, 2, 2));
  const TransportObject object(cube, matter(0.5, 1, 0), 1.5);
  for (const Vec3& direction : {Vec3(1, 0, 0), Vec3(1, 1, 0), Vec3(1, 1, 1), Vec3(1, 1e-9, 0), Vec3(1, 1e-5, 1e-7)})
    trace(object, {DirectionalLight{direction.normalized(), Rgb::Ones()}}, paths(2000), "cube along its faces");
  // All light on one vertex, and from a hair above a face.
  trace(object,
        {AreaLight{Vec3(3, 3, 3), Vec3(-1, -1, -1).normalized(), Vec3(0, 1, 0), 1e-6, 1e-6, Rgb::Constant(1e12)}},
        paths(2000), "point-like area light");
  trace(object, {PointLight{Vec3(0.3, 0.2, 1 + 1e-5), Rgb::Ones()}}, paths(2000), "touching light");
  trace(object, {PointLight{Vec3(1e6, 2e6, -1e6), Rgb::Constant(1e12)}}, paths(2000), "light far away");
}

TEST(TransportStress, ScalesAndCoefficients) {
  for (const double size : {1e-3, 1.0, 1e6})
    for (const double depth : {1e-9, 1e-3, 1.0, 1e3})  // mean free paths in the size
      for (const double albedo : {0.0, 0.5, 1 - 1e-7, 1.0}) {
        const TransportObject object(shapes::sphere(size, 3), matter(depth / size, albedo, 0), 1.5);
        trace(object, even_sky(), std::min(paths(300), 3000.0), "ball");
      }
  for (const double g : {-0.999, 0.999})
    trace(TransportObject(shapes::sphere(1, 3), matter(100, 0.9, g), 2.5), even_sky(), paths(500),
          "one-sided scattering");
  const TransportObject channels(
      shapes::sphere(1, 3),
      Material::from_absorption_scattering(Rgb(0, 1, 1e-6f), Rgb(1e3f, 1e-6f, 0), Rgb(0.9f, -0.9f, 0)), 1.4);
  trace(channels, even_sky(), paths(1000), "channels unlike each other");
}

// Clear white matter of high index, in shapes that mirror light inside: paths end by leaving or by a fair roulette.
TEST(TransportStress, TotalInternalReflectionEnds) {
  const TriangleMesh cube = shapes::box(Vec3(1, 1, 1)), cone = shapes::double_cone(7, 1, 2, 0.7);
  for (const TriangleMesh* mesh : {&cube, &cone})
    for (const double extinction : {0.0, 1e-4, 1e-2})
      trace(TransportObject(*mesh, matter(extinction, 1, 0), 2.5), even_sky(),
            extinction > 0 && extinction < 1e-3 ? 40 : 400, "clear white matter");
}

TEST(TransportStress, ShellsOfOneVoxelAndOfHugeContrast) {
  const auto distance = [](const Vec3& p) { return p.norm() - 5; };
  const TriangleMesh ball = shapes::sphere(5, 4);
  const auto rough = [](const Vec3& p, double) {
    const std::uint64_t place = hash64(static_cast<std::uint64_t>(std::llround(1e3 * p.sum() + 1e6)));
    test::ShellVoxel voxel{matter(std::pow(10.0, 9 * to_unit(place) - 6), 0.9, 0.3)};
    voxel.kind = place % 5 == 0 ? 0 : 1;
    return voxel;
  };
  for (const auto& [voxel, thickness] : {std::pair{0.5, 0.5}, {0.5, 2.0}, {2.0, 2.0}, {0.3, 0.9}}) {
    const ShellVolume shell = test::shell_of(distance, 5, voxel, thickness, matter(1, 0.99, 0), rough);
    EXPECT_LE(trace(TransportObject(ball, shell, 1.4), even_sky(), paths(1500), "rough shell with holes"), 1e-3);
  }
}

}  // namespace
}  // namespace shellgrid
