// SPDX-License-Identifier: AGPL-3.0-or-later
#include "meshing/surface/prepare_surface.h"

#include <gtest/gtest.h>
#include <oneapi/tbb/global_control.h>

#include <string>

#include "meshing/core/error.h"
#include "meshing/surface/retile.h"
#include "tests/support/closed_shapes.h"

namespace shellgrid {
namespace {

void expect_sound(const TriangleMesh& mesh) {
  EXPECT_NO_THROW(require_closed_surface(mesh));
  EXPECT_EQ(find_self_intersections(mesh, {}, folded_flat).pairs, 0);
}

class PrepareShapes : public testing::TestWithParam<std::pair<const char*, TriangleMesh>> {};

TEST_P(PrepareShapes, KeepsGenusVolumeAndDistanceAndMeetsTheSpacing) {
  const TriangleMesh& shape = GetParam().second;
  const PreparedSurface result = prepare_surface(shape, {.size = 20, .spacing = 0.4});
  expect_sound(result.mesh);
  EXPECT_EQ(result.genus, genus(shape));
  EXPECT_NEAR(result.edges.mean, 0.4, 0.012);
  EXPECT_LT(result.edges.variation(), 0.17);
  EXPECT_GT(result.edges.least, 0.1);
  EXPECT_LT(result.edges.greatest, 0.8);
  EXPECT_LT(result.to_input, 0.5 * 0.4);
  EXPECT_LT(result.from_input, 0.5 * 0.4);
  const double volume = enclosed_volume(shape) * std::pow(result.scale, 3);
  EXPECT_NEAR(result.volume, volume, 0.01 * volume);
  const Eigen::RowVector3d lower = result.mesh.vertices.colwise().minCoeff(),
                           upper = result.mesh.vertices.colwise().maxCoeff();
  EXPECT_NEAR((upper - lower).maxCoeff(), 20, 1e-9);
  EXPECT_LT((upper + lower).norm(), 1e-9);
  EXPECT_FALSE(result.kept_triangles);
}

INSTANTIATE_TEST_SUITE_P(Shapes, PrepareShapes,
                         testing::Values(std::pair("sphere", shapes::sphere(1, 4)),
                                         std::pair("coarse_sphere", shapes::sphere(1, 1)),
                                         std::pair("torus", shapes::rotated(shapes::torus(2, 0.7, 60, 30), 1)),
                                         std::pair("box", shapes::rotated(shapes::box({3, 2, 1}), 2)),
                                         std::pair("double_cone", shapes::double_cone(30, 1, 1, 0.6))),
                         [](const auto& info) { return info.param.first; });

TEST(Prepare, KeepsSharpEdgesAndCorners) {
  const PreparedSurface result = prepare_surface(shapes::box({20, 12, 8}), {.size = 0, .spacing = 0.5});
  // Exactly the box: every vertex on it, every corner and edge kept.
  EXPECT_LT(result.to_input, 1e-9);
  EXPECT_LT(result.from_input, 1e-9);
  EXPECT_NEAR(result.volume, 20 * 12 * 8, 1e-6);
}

// A ball with a pointed horn.
TriangleMesh finger() {
  TriangleMesh mesh = shapes::sphere(1, 5);
  for (int v = 0; v < mesh.vertex_count(); ++v) {
    const Vec3 p = mesh.vertex(v);
    const double off = std::hypot(p.y(), p.z());
    if (p.x() > 0) mesh.vertices(v, 0) += 1.5 * std::exp(-40 * off * off);
  }
  return mesh;
}

TEST(Prepare, KeepsExtremitiesFinerThanTheSpacing) {
  for (const double spacing : {1.0, 0.7, 0.5, 0.3}) {
    const PreparedSurface result = prepare_surface(finger(), {.size = 20, .spacing = spacing});
    expect_sound(result.mesh);
    EXPECT_LT(result.from_input, 0.3 * spacing) << spacing;
    EXPECT_LT(result.to_input, 0.3 * spacing) << spacing;
    EXPECT_NEAR(result.edges.mean, spacing, 0.03 * spacing) << spacing;
    EXPECT_LT(result.edges.variation(), 0.15) << spacing;
  }
}

// A ball with twelve thorns as thin as the spacing.
TEST(Prepare, RetilesFinerWhereOnceIsNotNearEnough) {
  TriangleMesh ball = shapes::sphere(1, 6);
  const TriangleMesh thorns = shapes::sphere(1, 0);
  for (int v = 0; v < ball.vertex_count(); ++v) {
    double radius = 1;
    for (int t = 0; t < thorns.vertex_count(); ++t) {
      const double angle = std::acos(std::clamp(ball.vertex(v).dot(thorns.vertex(t)), -1.0, 1.0));
      radius += 0.6 * std::exp(-std::pow(angle / 0.1, 2));
    }
    ball.vertices.row(v) *= radius;
  }
  ball = shapes::rotated(ball, 3);
  const double spacing = 0.3;
  RetileOptions options;
  options.spacing = spacing;
  const TriangleMesh once = retile_surface(ball, options);
  EXPECT_GT(sampled_distance(ball, once, spacing), 0.3 * spacing);
  const PreparedSurface result = prepare_surface(ball, {.size = 0, .spacing = spacing});
  expect_sound(result.mesh);
  EXPECT_LE(result.farthest(), 0.3 * spacing);
  EXPECT_GT(result.retiling_attempts, 1);
  EXPECT_NEAR(result.refined_edge, 0.6 * spacing, 1e-12);
  EXPECT_NEAR(result.edges.mean, spacing, 0.05 * spacing);
}

TEST(Prepare, KeepsCreasesWhereTheyAre) {
  // Creases straight and round, with corners and without.
  TriangleMesh prism = shapes::double_cone(48, 6, 4, 4);
  for (const TriangleMesh& shape : {shapes::rotated(shapes::box({20, 12, 8}), 3), shapes::rotated(prism, 5)}) {
    const PreparedSurface result = prepare_surface(shape, {.size = 0, .spacing = 0.5});
    EXPECT_GT(result.creases.length, 30);
    EXPECT_EQ(result.creases.kept, 1);
    EXPECT_LT(result.creases.distance, 0.1 * 0.5);
    const PreparedSurface blunt = prepare_surface(shape, {.size = 0, .spacing = 0.5, .feature_angle = 180});
    const CreaseFigures lost = compare_creases(shape, blunt.mesh, 45, 0.5);
    EXPECT_GT(lost.distance, result.creases.distance);
  }
}

TEST(Prepare, WithoutSizeKeepsUnits) {
  const PreparedSurface result =
      prepare_surface(shapes::moved(shapes::sphere(3, 4), {10, 20, 30}), {.size = 0, .spacing = 0.3});
  EXPECT_EQ(result.scale, 1);
  EXPECT_NEAR(result.volume, 4.0 / 3 * std::numbers::pi * 27, 1.5);
}

TEST(Prepare, WithoutRetilingKeepsTheTriangles) {
  const TriangleMesh sphere = shapes::sphere(1, 3);
  const PreparedSurface result = prepare_surface(sphere, {.size = 10, .retile = false});
  EXPECT_EQ(result.mesh.faces, sphere.faces);
  EXPECT_EQ(result.retiling_attempts, 0);
}

TEST(Prepare, IsTheSameOnOneAndTwoThreads) {
  const TriangleMesh shape = shapes::rotated(shapes::torus(2, 0.7, 60, 30), 3);
  TriangleMesh results[2];
  for (int i = 0; i < 2; ++i) {
    const oneapi::tbb::global_control limit(oneapi::tbb::global_control::max_allowed_parallelism, i + 1);
    results[i] = prepare_surface(shape, {.size = 20, .spacing = 0.3}).mesh;
  }
  EXPECT_EQ(results[0].vertices, results[1].vertices);
  EXPECT_EQ(results[0].faces, results[1].faces);
}

TEST(Prepare, IsTheSameAtEverySize) {
  for (const TriangleMesh& shape : {finger(), shapes::rotated(shapes::box({2, 1.2, 0.8}), 3)}) {
    const PreparedSurface one = prepare_surface(shape, {.size = 0, .spacing = 0.1});
    for (const int power : {-12, 20}) {
      const double size = std::ldexp(1.0, power);
      TriangleMesh scaled = shape;
      scaled.vertices *= size;
      const PreparedSurface result = prepare_surface(scaled, {.size = 0, .spacing = 0.1 * size});
      ASSERT_EQ(result.mesh.faces, one.mesh.faces);
      EXPECT_EQ(result.mesh.vertices, (one.mesh.vertices * size).eval());
    }
  }
}

TEST(Prepare, OfASlabThinnerThanTheSpacingStaysSound) {
  const PreparedSurface result =
      prepare_surface(shapes::rotated(shapes::box({20, 10, 0.15}), 4), {.size = 0, .spacing = 0.5});
  expect_sound(result.mesh);
  EXPECT_EQ(result.genus, 0);
  EXPECT_LT(result.from_input, 0.5);
}

TEST(Prepare, RefusesASpacingLargerThanTheObject) {
  EXPECT_THROW(prepare_surface(shapes::sphere(1, 3), {.size = 1, .spacing = 5}), InputError);
}

TEST(Subdivision, LeavesTheSurfaceWhereItIs) {
  const TriangleMesh box = shapes::box({4, 3, 2});
  const TriangleMesh fine = subdivide_long_edges(box, 0.5);
  expect_sound(fine);
  EXPECT_LE(measure_edges(fine).greatest, 0.5);
  EXPECT_NEAR(enclosed_volume(fine), 24, 1e-10);
}

TEST(SampledDistance, TellsWhichSamplesAreBeyondALimit) {
  TriangleMesh ball = shapes::sphere(1, 3);
  const TriangleMesh round = ball;
  ball.vertices.row(5) *= 1.5;
  const std::vector<Vec3> far = samples_beyond(ball, round, 0.1, 0.1);
  ASSERT_FALSE(far.empty());
  for (const Vec3& p : far) EXPECT_GT(p.norm(), 1.09);
  EXPECT_NEAR(sampled_distance(ball, round, 0.1), 0.5, 0.01);
  EXPECT_TRUE(samples_beyond(ball, round, 0.1, 0.6).empty());
}

TEST(SampledDistance, BetweenConcentricSpheresIsTheDifferenceOfRadii) {
  const TriangleMesh outer = shapes::sphere(2, 5), inner = shapes::sphere(1.9, 5);
  EXPECT_NEAR(sampled_distance(outer, inner, 0.05), 0.1, 0.002);
  EXPECT_NEAR(sampled_distance(inner, outer, 0.05), 0.1, 0.002);
}

}  // namespace
}  // namespace shellgrid
