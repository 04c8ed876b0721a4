// SPDX-License-Identifier: AGPL-3.0-or-later
#include "solvers/diffusion/polygrid_diffusion.h"

#include <gtest/gtest.h>

#include <cmath>

#include "meshing/core/error.h"
#include "solvers/diffusion/boundary_irradiance.h"
#include "solvers/diffusion/surface_transfer.h"
#include "solvers/scattering/fresnel.h"
#include "tests/support/closed_shapes.h"
#include "tests/support/diffusion_problem.h"

namespace shellgrid {
namespace {

constexpr double radius = 10;

std::vector<Light> sun() { return {DirectionalLight{Vec3(0, 0, -1), Rgb(1, 2, 3)}}; }

// Everything about a ball in one light.
struct Ball {
  Polygrid grid = test::ball_grid(16, radius, 0.1);
  TriangleMesh surface = shapes::sphere(radius, 5);

  DiffusionResult solve(const DiffusionCoefficients& c, const std::vector<Light>& lights,
                        const DiffusionOptions& options = {}, double ior = 1.5) const {
    return solve_polygrid_diffusion(grid, surface, test::grey_material(c), ior, lights, options);
  }
};

TEST(BoundaryIrradiance, FollowsCosineAndTransmittanceOnASphere) {
  const TriangleMesh mesh = shapes::sphere(radius, 4);
  const SurfaceIrradiance light = surface_irradiance(mesh, SceneGeometry(mesh), sun(), 1.5, 64);
  int lit = 0;
  for (int v = 0; v < mesh.vertex_count(); ++v) {
    const double cosine = mesh.vertex(v).z() / radius;
    if (cosine > 0.05) {
      ++lit;
      ASSERT_NEAR(light.values[v][1], 2 * cosine * fresnel_transmittance(cosine, 1.5), 0.02);
    }
    if (cosine < -0.05) {
      ASSERT_EQ(light.values[v][1], 0);
    }
  }
  EXPECT_GT(lit, 400);
  EXPECT_NEAR(static_cast<double>(light.facing_away) / static_cast<double>(light.directions), 0.5, 0.03);
  EXPECT_LT(light.occluded, light.directions / 50);
}

TEST(BoundaryIrradiance, APointLightFallsOffWithTheSquare) {
  const TriangleMesh mesh = shapes::sphere(radius, 3);
  const auto top = [&](double distance) {
    const SurfaceIrradiance light = surface_irradiance(
        mesh, SceneGeometry(mesh), {PointLight{Vec3(0, 0, radius + distance), Rgb::Constant(5)}}, 1.0, 64);
    float most = 0;
    for (const Rgb& value : light.values) most = std::max(most, value[0]);
    return most;
  };
  EXPECT_NEAR(top(20), 5.0 / 400, 0.01 * 5.0 / 400);
  EXPECT_NEAR(top(40), 5.0 / 1600, 0.01 * 5.0 / 1600);
}

TEST(BoundaryIrradiance, OneBallShadesTheOther) {
  TriangleMesh near = shapes::sphere(radius, 4), both = near;
  const Eigen::Index n = near.vertices.rows(), m = near.faces.rows();
  both.vertices.conservativeResize(2 * n, 3);
  both.vertices.bottomRows(n) = near.vertices.rowwise() + Eigen::RowVector3d(0, 0, 50);
  both.faces.conservativeResize(2 * m, 3);
  both.faces.bottomRows(m) = near.faces.array() + static_cast<std::int32_t>(n);
  const SurfaceIrradiance light = surface_irradiance(both, SceneGeometry(both), sun(), 1.5, 64);
  double lower = 0, upper = 0;
  for (Eigen::Index v = 0; v < n; ++v) {
    lower += light.values[v][0];
    upper += light.values[n + v][0];
  }
  EXPECT_GT(upper, 100);
  EXPECT_LT(lower, 0.02 * upper);
  EXPECT_GT(light.occluded, n / 3);
}

TEST(SurfaceTransfer, KeepsConstantsAndCarriesSmoothFieldsToSecondOrder) {
  const TriangleMesh mesh = shapes::sphere(radius, 5);
  double error[2];
  for (int k = 0; k < 2; ++k) {
    const Polygrid grid = test::ball_grid(8 << k, radius, 0.1);
    const SurfaceTransfer transfer(grid, mesh);
    for (const Rgb& value :
         transfer.to_vertices(transfer.to_points(std::vector<Rgb>(mesh.vertex_count(), Rgb(1, 2, 3)))))
      ASSERT_NEAR(value[2], 3, 1e-5);
    std::vector<Rgb> field;
    for (int v = 0; v < mesh.vertex_count(); ++v)
      field.push_back(Rgb::Constant(static_cast<float>(mesh.vertex(v).z())));
    const std::vector<Rgb> back = transfer.to_vertices(transfer.to_points(field));
    error[k] = 0;
    for (int v = 0; v < mesh.vertex_count(); ++v)
      error[k] = std::max<double>(error[k], std::abs(back[v][0] - field[v][0]));
  }
  EXPECT_LT(error[1], 0.05 * radius);
  EXPECT_LT(error[1], 0.45 * error[0]);
}

TEST(PolygridDiffusion, BalancesEnergyOnTheGridAndNearlyOnTheMesh) {
  const DiffusionResult r = Ball().solve({0.005, 1}, sun());
  for (int c = 0; c < 3; ++c) {
    EXPECT_LT(r.energy.relative_defect[c], 1e-10);
    EXPECT_NEAR(r.surface_entering[c], r.energy.entering[c], 0.02 * r.energy.entering[c]);
    EXPECT_NEAR(r.surface_leaving[c], r.energy.leaving[c], 0.02 * r.energy.leaving[c]);
  }
  EXPECT_LE(r.solve.estimated_error, 0.005);
  EXPECT_EQ(r.negative_vertices, 0);
}

TEST(PolygridDiffusion, TheWhiteFurnaceIsWhite) {
  EnvironmentLight sky;
  sky.zenith = sky.horizon = sky.ground = Rgb::Ones();
  DiffusionOptions options;
  options.environment_samples = 1024;
  const double ior = 1.5;
  const DiffusionResult r = Ball().solve({0, 1}, {sky}, options, ior);
  // M = q = π ∫ 2μ F_t dμ: radiance M F_t / (π ∫ 2μ F_t dμ) = F_t, and what the surface mirrors makes it 1.
  const double expected = M_PI * diffuse_fresnel(ior).exit_normalization;
  for (const Rgb& value : r.exitance) ASSERT_NEAR(value[0], expected, 0.02 * expected);
}

TEST(PolygridDiffusion, RefusesAPointLightInsideTheObject) {
  const Ball ball;
  EXPECT_THROW(ball.solve({0.01, 1}, {PointLight{Vec3(1, 2, 3), Rgb::Ones()}}), InputError);
}

TEST(PolygridDiffusion, LightIsLinear) {
  const Ball ball;
  DiffusionOptions options;
  options.tolerance = 1e-6;
  const PointLight lamp{Vec3(30, 5, 0), Rgb(500, 300, 100)};
  const DiffusionResult a = ball.solve({0.01, 1}, sun(), options), b = ball.solve({0.01, 1}, {lamp}, options);
  std::vector<Light> all = sun();
  all.push_back(lamp);
  const DiffusionResult both = ball.solve({0.01, 1}, all, options);
  for (std::size_t v = 0; v < both.exitance.size(); ++v)
    ASSERT_NEAR(both.exitance[v][0], a.exitance[v][0] + b.exitance[v][0], 1e-4);
}

TEST(PolygridDiffusion, WarnsOfLampsNearerThanItsCells) {
  struct Listener : Progress {
    std::string heard;
    void warn(const std::string& message) override { heard += message + "\n"; }
  };
  const Ball ball;
  const double radius = ball.surface.vertices.rowwise().norm().maxCoeff();
  const auto heard = [&](const Light& light) {
    Listener listener;
    solve_polygrid_diffusion(ball.grid, ball.surface, test::grey_material({0.01, 1}), 1.5, {light}, {}, listener);
    return listener.heard.find("stands") != std::string::npos;
  };
  const auto area = [](double x) { return AreaLight{Vec3(x, 0, 0), Vec3(-1, 0, 0), Vec3(0, 1, 0), 4, 4, Rgb::Ones()}; };
  EXPECT_TRUE(heard(PointLight{Vec3(radius + 0.5 * ball.grid.spacing, 0, 0), Rgb::Ones()}));
  EXPECT_TRUE(heard(area(radius + 0.5 * ball.grid.spacing)));
  EXPECT_FALSE(heard(PointLight{Vec3(radius + 4 * ball.grid.spacing, 0, 0), Rgb::Ones()}));
  EXPECT_FALSE(heard(area(radius + 4 * ball.grid.spacing)));
}

TEST(PolygridDiffusion, WarnsOfCoarseGridsAndDarkMaterials) {
  struct Listener : Progress {
    std::string heard;
    void warn(const std::string& message) override { heard += message + "\n"; }
  };
  const Ball ball;
  Listener dark, coarse, fine;
  // More would be absorbed than enters: no picture of anything.
  EXPECT_THROW(solve_polygrid_diffusion(ball.grid, ball.surface, test::grey_material({2, 1}), 1.5, sun(), {}, dark),
               NumericalError);
  EXPECT_NE(dark.heard.find("reduced albedo"), std::string::npos);
  const DiffusionResult r =
      solve_polygrid_diffusion(ball.grid, ball.surface, test::grey_material({0.45, 1}), 1.5, sun(), {}, coarse);
  EXPECT_NE(coarse.heard.find("mean free path"), std::string::npos);
  EXPECT_NE(coarse.heard.find("negative"), std::string::npos);
  EXPECT_GT(r.negative_vertices, 0);
  // Counted and kept: clamped values would not add up to the energy's.
  std::int64_t negative = 0;
  for (const Rgb& value : r.exitance) negative += (value < 0).any();
  EXPECT_EQ(r.negative_vertices, negative);
  EXPECT_LT(r.least_exitance, 0);
  solve_polygrid_diffusion(ball.grid, ball.surface, test::grey_material({0.001, 1}), 1.5, sun(), {}, fine);
  EXPECT_EQ(fine.heard, "");
}

TEST(PolygridDiffusion, ThePapersOperatorLosesTheLightOfAWhiteObjectInUniformLight) {
  Ball ball;
  ball.grid = test::cube_grid(12, 14, 0.1);
  ball.grid.points.rowwise() -= Eigen::RowVector3d::Constant(7);
  test::add_cube_graph(ball.grid, 12, 14);
  EnvironmentLight sky;
  sky.zenith = sky.horizon = sky.ground = Rgb::Ones();
  DiffusionOptions options;
  options.operator_name = "paper";
  const DiffusionResult r = ball.solve({0, 1}, {sky}, options);
  EXPECT_LT(std::abs(r.energy.leaving[0]), 0.02 * r.energy.entering[0]);
  EXPECT_GT(r.energy.relative_defect[0], 0.9);
}

TEST(PolygridDiffusion, WithoutLightAllIsBlackAndNothingIsSaid) {
  const Ball ball;
  DiffusionOptions options;
  for (const char* source : {"boundary", "first-collision"}) {
    options.source = source;
    for (const std::vector<Light>& dark : {std::vector<Light>{}, {DirectionalLight{}}}) {
      const DiffusionResult r = ball.solve({0.5, 0.1}, dark, options);
      for (const Rgb& value : r.exitance) EXPECT_TRUE((value == 0).all());
      EXPECT_EQ(r.energy.relative_defect[1], 0);
    }
  }
}

// In deep shadow at low albedo next to no light leaves: less than the error that the tolerance leaves open.
TEST(PolygridDiffusion, ExitanceFallsBelowZeroByLessThanTheTolerance) {
  const Ball ball;
  DiffusionOptions options;
  options.source = "first-collision";
  options.adaptive = false;
  for (const double coefficient : {0.2, 0.6, 0.9})
    for (const double tolerance : {5e-3, 1e-4, 1e-8}) {
      options.tolerance = tolerance;
      const DiffusionResult r = ball.solve({coefficient, coefficient}, sun(), options);
      float largest = 0;
      for (const Rgb& value : r.exitance) largest = std::max(largest, value.maxCoeff());
      EXPECT_GT(r.least_exitance, -0.1 * tolerance * largest) << coefficient << " " << tolerance;
      if (coefficient == 0.6) {
        EXPECT_EQ(r.negative_vertices > 0, tolerance > 1e-8) << tolerance;
      }
    }
}

TEST(PolygridDiffusion, RefusesWhatItCannotSolve) {
  const Ball ball;
  DiffusionOptions options;
  options.tolerance = 0;
  EXPECT_THROW(ball.solve({0.01, 1}, sun(), options), InputError);
  options.tolerance = std::nan("");
  EXPECT_THROW(ball.solve({0.01, 1}, sun(), options), InputError);
  options = {};
  options.operator_name = "finite volumes";
  EXPECT_THROW(ball.solve({0.01, 1}, sun(), options), InputError);
  options.operator_name = "paper";  // the ball has no graph
  EXPECT_THROW(ball.solve({0.01, 1}, sun(), options), InputError);
  EXPECT_THROW(ball.solve({0.01, 1}, sun(), {}, 0.8), InputError);
  EXPECT_THROW(ball.solve({0, 0}, sun()), InputError);
}

}  // namespace
}  // namespace shellgrid
