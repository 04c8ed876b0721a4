// SPDX-License-Identifier: AGPL-3.0-or-later
#include "solvers/transport/camera_paths.h"

#include <gtest/gtest.h>

#include <cmath>
#include <numbers>

#include "meshing/core/error.h"
#include "solvers/transport/light_tracing.h"
#include "tests/support/closed_shapes.h"

namespace shellgrid {
namespace {

constexpr double pi = std::numbers::pi;

Material grey(float absorption, float scattering, float anisotropy = 0) {
  return Material::from_absorption_scattering(Rgb::Constant(absorption), Rgb::Constant(scattering),
                                              Rgb::Constant(anisotropy));
}

EnvironmentLight sky(const Rgb& radiance) {
  EnvironmentLight light;
  light.zenith = light.horizon = light.ground = radiance;
  return light;
}

// Far away, the ball of radius 1 fills most of the picture.
Camera far_camera(int edge) {
  Camera camera;
  camera.position = Vec3(0, 0, 1000);
  camera.fov = 2 * std::atan(1.25 / 1000) * 180 / pi;
  camera.width = camera.height = edge;
  return camera;
}

Image picture(const TransportObject& object, const std::vector<Light>& lights, const Camera& camera, double samples,
              const CameraPathOptions& options = {}) {
  const CameraPaths paths(object, lights, camera, options);
  const PathKind kind = paths.kind();
  PathState state(kind.scalars, kind.field_size);
  PathLimits limits;
  limits.paths = samples * static_cast<double>(paths.pixel_count());
  follow_paths(kind, limits, state);
  return paths.picture(state);
}

double mean(const Image& image, const char* name) {
  double sum = 0;
  for (const float value : image.find(name)->values) sum += value;
  return sum / static_cast<double>(image.find(name)->values.size());
}

TEST(CameraPaths, WhiteFurnaceIsInvisible) {
  const TriangleMesh ball = shapes::sphere(1, 3), cone = shapes::double_cone(17, 1, 0.9, 0.3);
  for (const TriangleMesh* mesh : {&ball, &cone})
    for (const double ior : {1.0, 1.5}) {
      const TransportObject object(*mesh, grey(0, 3, 0.5f), ior);
      const Image image = picture(object, {sky(Rgb(1, 2, 3))}, far_camera(24), 4);
      for (int c = 0; c < 3; ++c)
        for (const float value : image.find(c == 0 ? "R" : c == 1 ? "G" : "B")->values) ASSERT_NEAR(value, 1 + c, 1e-3);
      EXPECT_GT(mean(image, "A"), 0.1);
      EXPECT_GT(mean(image, "exitance.R"), 0.05);
    }
}

// Reciprocity. Under an even sky a ball looks alike from everywhere: the mean radiance of its disc times π is what
// leaves and is mirrored, per area, as light tracing has it.
TEST(CameraPaths, AgreeWithLightTracing) {
  const TriangleMesh ball = shapes::sphere(1, 5);
  const Material matter = Material::from_absorption_scattering(Rgb(0.05f, 0.3f, 1), Rgb(4, 2, 1), Rgb(0, 0.5f, 0.8f));
  const TransportObject object(ball, matter, 1.4);
  const Image image = picture(object, {sky(Rgb::Ones())}, far_camera(40), 30, {0, Rgb(Rgb::Zero())});
  const LightTracing tracing(object, {sky(Rgb::Ones())}, {});
  const PathKind kind = tracing.kind();
  PathState state(kind.scalars, kind.field_size);
  PathLimits limits;
  limits.paths = 40000;
  follow_paths(kind, limits, state);
  const LightTracingResult traced = tracing.result(state);
  const double area = 4 * pi;
  for (int c = 0; c < 3; ++c) {
    const char* names[3] = {"R", "G", "B"};
    const char* diffuse_names[3] = {"exitance.R", "exitance.G", "exitance.B"};
    const double radiance = mean(image, names[c]) / mean(image, "A"),
                 diffuse = mean(image, diffuse_names[c]) / mean(image, "A");
    const Estimate out = traced.leaving.channel[c];
    EXPECT_NEAR(pi * diffuse * area, out.value, 5 * out.standard_error + 0.02 * out.value) << c;
    EXPECT_NEAR(pi * (radiance - diffuse) * area, traced.mirrored.channel[c].value,
                5 * traced.mirrored.channel[c].standard_error + 0.03 * traced.mirrored.channel[c].value)
        << c;
  }
}

TEST(CameraPaths, StandardErrorsAreTrue) {
  const TriangleMesh ball = shapes::sphere(1, 3);
  const TransportObject object(ball, grey(0.5f, 2), 1.4);
  EnvironmentLight light;
  light.lamps.push_back({Vec3(0.3, 1, 0.5).normalized(), 0.8, 0, Rgb::Ones()});
  CameraPathOptions other;
  other.seed = 1;
  const Image few = picture(object, {light}, far_camera(20), 40, other),
              many = picture(object, {light}, far_camera(20), 640);
  double squares = 0;
  int count = 0;
  for (std::size_t p = 0; p < 400; ++p) {
    const double error = many.find("error.G")->values[p];
    if (many.find("A")->values[p] < 1 || !(error > 0)) continue;
    squares += std::pow((few.find("G")->values[p] - many.find("G")->values[p]) / error, 2) / (16 + 1);
    ++count;
  }
  EXPECT_GT(count, 100);
  EXPECT_NEAR(squares / count, 1, 0.35);
}

TEST(CameraPaths, SeeAreaLightsFromTheirFront) {
  const TriangleMesh ball = shapes::sphere(1, 3);
  const TransportObject object(ball, grey(1, 1), 1.3);
  // Beside the ball, filling the upper right of the picture.
  const AreaLight facing{Vec3(1.4, 1.4, -50), Vec3(0, 0, 1), Vec3(0, 1, 0), 1.4, 1.4, Rgb(5, 6, 7)};
  AreaLight averted = facing;
  averted.direction = Vec3(0, 0, -1);
  const Camera camera = far_camera(10);
  const Image image = picture(object, {facing}, camera, 16);
  EXPECT_NEAR(image.find("G")->values[9], 6, 0.1);
  EXPECT_EQ(image.find("G")->values[5 * 10 + 9], 0);
  EXPECT_LT(mean(picture(object, {averted}, camera, 4), "G"), 1e-3);
}

TEST(CameraPaths, WithoutLightThePictureIsBlack) {
  const TransportObject object(shapes::sphere(1, 2), grey(1, 1), 1.3);
  for (const std::vector<Light>& dark : {std::vector<Light>{}, {sky(Rgb::Zero())}, {DirectionalLight{}, PointLight{}}})
    for (const char* channel : {"R", "G", "B"}) EXPECT_EQ(mean(picture(object, dark, far_camera(4), 4), channel), 0);
}

TEST(CameraPaths, NonsenseIsRefused) {
  const TriangleMesh ball = shapes::sphere(1, 2);
  const TransportObject object(ball, grey(1, 1), 1.3);
  const Camera camera = far_camera(4);
  EXPECT_THROW(CameraPaths(object, {DirectionalLight{Vec3(0, 0, -1), Rgb::Ones()}}, camera, {}), InputError);
  EXPECT_THROW(CameraPaths(object, {PointLight{Vec3(9, 9, 9), Rgb::Ones()}}, camera, {}), InputError);
  Camera inside = camera;
  inside.position = Vec3(0.1, 0, 0.1);
  EXPECT_THROW(CameraPaths(object, {sky(Rgb::Ones())}, inside, {}), InputError);
}

}  // namespace
}  // namespace shellgrid
