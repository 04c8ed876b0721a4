// SPDX-License-Identifier: AGPL-3.0-or-later
#include "solvers/diffusion/near_lamps.h"

#include <gtest/gtest.h>

#include <cmath>
#include <cstdio>
#include <numbers>

#include "solvers/diffusion/boundary_irradiance.h"
#include "solvers/diffusion/polygrid_diffusion.h"
#include "solvers/scattering/fresnel.h"
#include "tests/support/closed_shapes.h"
#include "tests/support/polygrid_shapes.h"

namespace shellgrid {
namespace {

constexpr double pi = std::numbers::pi;

Material wax() { return Material::from_absorption_scattering(Rgb::Constant(0.01f), Rgb::Constant(1.0f), Rgb::Zero()); }

// Of a point light of intensity one at a height over a ball, what passes into it: ∫ 2π sin α T(i) dα over its disc.
double into_ball(double radius, double height, double ior) {
  const double out = radius + height, most = std::asin(radius / out);
  constexpr int steps = 200000;
  double sum = 0;
  for (int k = 0; k < steps; ++k) {
    // Finer towards the rim, where the angle of incidence turns fast.
    const double u = (k + 0.5) / steps, angle = most * (1 - (1 - u) * (1 - u)), width = most * 2 * (1 - u) / steps;
    const double sine = out * std::sin(angle) / radius;
    sum += 2 * pi * std::sin(angle) * width * fresnel_transmittance(std::sqrt(std::max(0.0, 1 - sine * sine)), ior);
  }
  return sum;
}

struct Entering {
  double grid, surface;  // W
};

Entering entering(const Polygrid& grid, const TriangleMesh& surface, const Light& light, double ior,
                  const std::string& source) {
  DiffusionOptions options;
  options.source = source;
  options.tolerance = 0.01;
  const DiffusionResult r = solve_polygrid_diffusion(grid, surface, wax(), ior, {light}, options);
  EXPECT_LT(r.energy.relative_defect[1], 1e-9);
  return {r.energy.entering[1], r.surface_entering[1]};
}

TEST(NearLamps, AllOfALampsLightEntersAPlane) {
  // Over the middle of a cell, of a cell's side, and elsewhere. Of index 1 all that meets the face enters: the solid
  // angle of a rectangle seen from over it.
  const double edge = 20;
  const Polygrid grid = test::cube_grid(16, edge, 0.1);
  const TriangleMesh surface = shapes::moved(shapes::box(Vec3::Constant(edge)), Vec3::Constant(edge / 2));
  const auto solid_angle = [](double a, double b, double h) {
    return std::atan2(a * b, h * std::sqrt(a * a + b * b + h * h));
  };
  for (const std::string& source : {std::string("boundary"), std::string("first-collision")})
    for (const Vec2& place : {Vec2(10, 10), Vec2(10.625, 10), Vec2(9.3, 11.47)})
      for (const double cells : {3.0, 2.0, 0.5, 0.1, 0.02, 1e-4}) {
        const double h = cells * grid.spacing;
        double expected = 0;
        for (const double a : {place.x(), edge - place.x()})
          for (const double b : {place.y(), edge - place.y()}) expected += solid_angle(a, b, h);
        const Entering found =
            entering(grid, surface, PointLight{Vec3(place.x(), place.y(), edge + h), Rgb::Ones()}, 1, source);
        EXPECT_NEAR(found.grid / expected, 1, 0.01) << source << ", " << cells << " cells";
        EXPECT_NEAR(found.surface / expected, 1, 0.01) << source << ", " << cells << " cells";
      }
}

TEST(NearLamps, AllOfALampsLightEntersABall) {
  const double radius = 8;
  const Polygrid grid = test::ball_grid(16, radius, 0.1);
  const TriangleMesh surface = shapes::sphere(radius, 6);
  for (const std::string& source : {std::string("boundary"), std::string("first-collision")})
    for (const double cells : {2.0, 0.5, 0.1, 0.02}) {
      const double h = cells * grid.spacing, expected = into_ball(radius, h, 1.4);
      const Vec3 way = Vec3(0.3, -0.5, 0.8).normalized();
      const Entering found = entering(grid, surface, PointLight{(radius + h) * way, Rgb::Ones()}, 1.4, source);
      EXPECT_NEAR(found.grid / expected, 1, 0.01) << source << ", " << cells << " cells";
      EXPECT_NEAR(found.surface / expected, 1, 0.01) << source << ", " << cells << " cells";
    }
}

// A rectangle of a cell's size that faces the plane: nearly all of its π A L enters when it is close.
TEST(NearLamps, AreaLights) {
  const double edge = 20;
  const Polygrid grid = test::cube_grid(16, edge, 0.1);
  const TriangleMesh surface = shapes::moved(shapes::box(Vec3::Constant(edge)), Vec3::Constant(edge / 2));
  const double size = 0.5 * grid.spacing;
  for (const std::string& source : {std::string("boundary"), std::string("first-collision")})
    for (const double cells : {0.5, 0.1}) {
      const AreaLight light{
          Vec3(10.2, 9.9, edge + cells * grid.spacing), Vec3(0, 0, -1), Vec3(0, 1, 0), size, size, Rgb::Ones()};
      const Entering found = entering(grid, surface, light, 1, source);
      EXPECT_NEAR(found.grid / (pi * size * size), 1, 0.015) << source;
      EXPECT_NEAR(found.surface / (pi * size * size), 1, 0.015) << source;
    }
}

// What wide panels and long tubes send to a ball: of a place whose plane has the whole ball before it, π (R/r)² cos θ.
TEST(NearLamps, WidePanelsAndLongTubes) {
  const double radius = 10;
  const Polygrid grid = test::ball_grid(16, radius, 0.1);
  const TriangleMesh ball = shapes::sphere(radius, 5);
  const struct {
    double width, height, gap;
  } panels[] = {{300, 300, 20}, {1000, 1000, 20}, {200, 200, 1}, {1, 2000, 2}, {40, 40, 1}, {7, 3, 0.5}};
  for (const auto& panel : panels) {
    double expected = 0;
    const int rows = std::max(8, static_cast<int>(4 * panel.height)),
              columns = std::max(8, static_cast<int>(4 * panel.width));
    for (int i = 0; i < rows; ++i)
      for (int j = 0; j < columns; ++j) {
        const double x = ((j + 0.5) / columns - 0.5) * panel.width, y = ((i + 0.5) / rows - 0.5) * panel.height,
                     z = radius + panel.gap, r = std::sqrt(x * x + y * y + z * z);
        expected += pi * radius * radius * z / (r * r * r) * panel.width * panel.height / (rows * columns);
      }
    const AreaLight light{
        Vec3(0, 0, radius + panel.gap), Vec3(0, 0, -1), Vec3(0, 1, 0), panel.width, panel.height, Rgb::Ones()};
    for (const std::string& source : {std::string("boundary"), std::string("first-collision")}) {
      if (source == "first-collision" && panel.width > 50) continue;
      const Entering found = entering(grid, ball, light, 1, source);
      std::printf("%g x %g mm, %g mm away, %s: on the grid %.4f, on the mesh %.4f of what falls\n", panel.width,
                  panel.height, panel.gap, source.c_str(), found.grid / expected, found.surface / expected);
      EXPECT_NEAR(found.grid / expected, 1, 0.025);
      EXPECT_NEAR(found.surface / expected, 1, 0.025);
    }
  }
}

// No place sees more of a panel than half of all directions: its irradiance stays below π L.
TEST(NearLamps, NoPlaceIsBrighterThanThePanel) {
  const double radius = 10;
  const Polygrid grid = test::ball_grid(24, radius, 0.1);
  const TriangleMesh ball = shapes::sphere(radius, 5);
  const AreaLight panel{Vec3(0, 0, radius + 1), Vec3(0, 0, -1), Vec3(0, 1, 0), 40, 40, Rgb::Ones()};
  const ClosestPointQuery query(ball);
  const std::vector<Light> parts = divide_rectangles({panel}, query, grid.spacing, 256);
  const DividedLights divided = divide_lights(parts, query, grid.spacing, 256);
  const SceneGeometry geometry(ball);
  const std::vector<Rgb> far = surface_irradiance(ball, geometry, divided.far, 1, 256).values;
  const NearLampLight near = near_lamp_light(grid, ball, query, geometry, divided.near, 1);
  double most = 0;
  for (std::size_t v = 0; v < far.size(); ++v) most = std::max<double>(most, far[v][0] + near.at_vertices[v][0]);
  std::printf("%zu parts, brightest vertex %.4f π\n", parts.size(), most / pi);
  EXPECT_LE(most, 1.03 * pi);
  EXPECT_GE(most, 0.9 * pi);
}

TEST(NearLamps, LightsFarAwayAreSampledAsBefore) {
  const TriangleMesh ball = shapes::sphere(5, 4);
  const ClosestPointQuery query(ball);
  const std::vector<Light> lights = {DirectionalLight{}, PointLight{Vec3(0, 0, 9.5), Rgb::Ones()},
                                     PointLight{Vec3(0, 0, 8.5), Rgb::Ones()}, EnvironmentLight{}};
  const DividedLights divided = divide_lights(lights, query, 1, 64);
  EXPECT_EQ(divided.far.size(), 3u);
  ASSERT_EQ(divided.near.size(), 1u);
  EXPECT_EQ(lamp_position(divided.near[0])->z(), 8.5);
}

}  // namespace
}  // namespace shellgrid
