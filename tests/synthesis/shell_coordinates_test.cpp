// SPDX-License-Identifier: AGPL-3.0-or-later
#include "synthesis/shell_coordinates.h"

#include <gtest/gtest.h>

#include <limits>

#include "meshing/core/error.h"
#include "synthesis/sample_check.h"
#include "synthesis/shell_resampling.h"
#include "tests/synthesis/unrolled_shapes.h"

namespace shellgrid {
namespace {

constexpr double flat = std::numeric_limits<double>::infinity();

TEST(ShellCoordinates, OnAPlaneInterpolationIsExactWhateverTheTriangles) {
  const testing::UnrolledStrip strip(flat, 0.45, 0.4, 40);
  const SurfacePlaces places(strip.mesh, {{64, 64}}, strip.voxel);
  double nearest_error = 0;
  for (int i = 0; i < 2000; ++i) {
    const Vec3 p(2 + 14 * to_unit(hash64(i, 3)), 2 + 14 * to_unit(hash64(i, 4)), 0);
    const int vertex = strip.nearest_vertex(p);
    const SurfacePlace place = places.interpolated(vertex, p);
    EXPECT_TRUE(place.coherent);
    EXPECT_LT((place.coordinate.cast<double>() - strip.exact(p)).norm(), 1e-4);
    nearest_error = std::max(nearest_error, (places.nearest(vertex).coordinate.cast<double>() - strip.exact(p)).norm());
  }
  EXPECT_GT(nearest_error, 0.5);
}

TEST(ShellCoordinates, OnACylinderItsErrorFallsWithTheCubeOfTheSpacing) {
  const auto errors = [](double step) {
    const testing::UnrolledStrip strip(6, step, step, static_cast<int>(8 / step));
    const SurfacePlaces places(strip.mesh, {{1000, 1000}}, strip.voxel);
    Vec2 square = Vec2::Zero();
    const int count = 2000;
    for (int i = 0; i < count; ++i) {
      const Vec3 on = strip.rolled({2.5 + 3 * to_unit(hash64(i, 3)), 2.5 + 3 * to_unit(hash64(i, 4))});
      const int vertex = strip.nearest_vertex(on);
      const auto millimetres = [&](const SurfacePlace& place) {
        return ((place.coordinate.cast<double>() - strip.exact(on)) * step).squaredNorm();
      };
      square += Vec2(millimetres(places.nearest(vertex)), millimetres(places.interpolated(vertex, on))) / count;
    }
    return Vec2(square.cwiseSqrt());
  };
  const Vec2 coarse = errors(0.8), fine = errors(0.4);
  EXPECT_NEAR(coarse.x() / fine.x(), 2, 0.4);  // nearest: with the spacing
  EXPECT_GT(coarse.y() / fine.y(), 5);
  EXPECT_LT(fine.y(), 0.01 * fine.x());
}

TEST(ShellCoordinates, PatchesMeetWithoutMixture) {
  testing::UnrolledStrip strip(flat, 0.4, 0.4, 20);
  // Right of the middle another patch, turned by a quarter.
  for (int v = 0; v < strip.mesh.mesh.vertex_count(); ++v)
    if (strip.mesh.mesh.vertices(v, 0) > strip.middle()) {
      const Vec2f c = strip.mesh.coordinate[v];
      strip.mesh.coordinate[v] = Vec2f(20 + c.y(), 9 - c.x());
      strip.mesh.directions.row(v) << 0, 1, 0;
    }
  const SurfacePlaces places(strip.mesh, {{32, 32}}, strip.voxel);
  int mixed = 0;
  for (int i = 0; i < 2000; ++i) {
    const Vec3 p(3 + 2 * to_unit(hash64(i, 3)), 2 + 4 * to_unit(hash64(i, 4)), 0);
    const SurfacePlace place = places.interpolated(strip.nearest_vertex(p), p);
    const Vec2 left = strip.exact(p), right(20 + left.y(), 9 - left.x());
    const Vec2 c = place.coordinate.cast<double>();
    EXPECT_LT(std::min((c - left).norm(), (c - right).norm()), 1e-4);
    mixed += !place.coherent;
  }
  EXPECT_GT(mixed, 100);
  EXPECT_LT(mixed, 1000);
}

TEST(ShellCoordinates, ThePatchGoesOnAcrossTheSamplesBorder) {
  testing::UnrolledStrip strip(flat, 0.4, 0.4, 20);
  for (Vec2f& c : strip.mesh.coordinate)
    c = Vec2f(c.x() - 8 * std::floor(c.x() / 8), c.y() - 8 * std::floor(c.y() / 8));
  const SurfacePlaces places(strip.mesh, {{8, 8}}, strip.voxel);
  for (int i = 0; i < 500; ++i) {
    const Vec3 p(2 + 4 * to_unit(hash64(i, 3)), 2 + 4 * to_unit(hash64(i, 4)), 0);
    Vec2 d = places.interpolated(strip.nearest_vertex(p), p).coordinate.cast<double>() - strip.exact(p);
    d -= 8 * (d / 8).array().round().matrix();
    EXPECT_LT(d.norm(), 1e-4);
  }
}

TEST(ShellCoordinates, LargerTexelsRunSlower) {
  testing::UnrolledStrip strip(flat, 0.4, 0.4, 20);
  strip.mesh.scale.assign(strip.mesh.coordinate.size(), 2.5f);
  for (Vec2f& c : strip.mesh.coordinate) c /= 2.5f;
  const SurfacePlaces places(strip.mesh, {{32, 32}}, strip.voxel);
  for (int i = 0; i < 500; ++i) {
    const Vec3 p(2 + 4 * to_unit(hash64(i, 3)), 2 + 4 * to_unit(hash64(i, 4)), 0);
    const SurfacePlace place = places.interpolated(strip.nearest_vertex(p), p);
    EXPECT_TRUE(place.coherent);
    EXPECT_LT((place.coordinate.cast<double>() - strip.exact(p) / 2.5).norm(), 1e-4);
  }
}

TEST(ShellCoordinates, TwoSamplesMeetWithoutMixture) {
  testing::UnrolledStrip strip(flat, 0.4, 0.4, 20);
  for (int v = 0; v < strip.mesh.mesh.vertex_count(); ++v)
    strip.mesh.sample.push_back(strip.mesh.mesh.vertices(v, 0) > strip.middle() ? 1 : 0);
  SampleDefinition definition = testing::marble(20);
  definition.voxel = 0.4;
  const MaterialSample first = make_procedural_sample(definition);
  MaterialSample second = first;
  for (Vec3f& extinction : second.extinction) extinction = Vec3f::Constant(9);
  const DistanceField field = strip.field(1.2);
  long of_second = 0;
  for (const ShellCoordinates choice : {ShellCoordinates::nearest, ShellCoordinates::interpolated}) {
    const ShellVolume shell =
        resample_shell(strip.mesh, field, {&first, &second}, bottom_layer_mean(first), 1.2, choice);
    shell.extinction.for_each_active([&](int i, int j, int k, const Vec3f& extinction) {
      const Vec3 p = field.frame.to_world(Vec3i(i, j, k));
      const bool is_second = extinction == Vec3f(Vec3f::Constant(9));
      of_second += is_second;
      // One side of the border or the other, within a triangle.
      if (std::abs(p.x() - strip.middle()) > 0.8) {
        EXPECT_EQ(is_second, p.x() > strip.middle());
      }
    });
  }
  EXPECT_GT(of_second, 500);
  EXPECT_THROW(resample_shell(strip.mesh, field, {&first}, bottom_layer_mean(first), 1.2, ShellCoordinates::nearest),
               InputError);
  second.voxel = 0.5;
  EXPECT_THROW(
      resample_shell(strip.mesh, field, {&first, &second}, bottom_layer_mean(first), 1.2, ShellCoordinates::nearest),
      InputError);
}

// The shell over an identity tiling against the sample itself, at falling voxel sizes.
TEST(ShellCoordinates, InterpolatedShellsAreTheSampleAndNearestOnesAreNot) {
  for (const double radius : {flat, 6.0}) {
    for (const int n : {16, 32}) {
      const double voxel = 6.4 / n;
      const testing::UnrolledStrip strip(radius, voxel, voxel, n);
      SampleDefinition definition = testing::marble(n);
      definition.voxel = voxel;
      definition.thickness = 1.6;
      const MaterialSample sample = make_procedural_sample(definition);
      const DistanceField field = strip.field(1.2);
      ShellStatistics statistics;
      const ShellVolume shell = resample_shell(strip.mesh, field, {&sample}, bottom_layer_mean(sample), 1.2,
                                               ShellCoordinates::interpolated, &statistics);
      long voxels = 0, wrong = 0;
      shell.texture_coordinate.for_each_active([&](int i, int j, int k, const Vec3f& t) {
        const Vec3 p = field.frame.to_world(Vec3i(i, j, k));
        const Vec2f exact = strip.exact(p).cast<float>();
        ++voxels;
        wrong += sample_voxel(sample, t) != sample_voxel(sample, Vec3f(exact.x(), exact.y(), t.z()));
      });
      ASSERT_GT(voxels, 200);
      // On the curved one a rare voxel lies within rounding of the next texel.
      EXPECT_LT(static_cast<double>(wrong), 0.01 * static_cast<double>(voxels));
      EXPECT_EQ(statistics.incoherent_share, 0);
      EXPECT_GT(statistics.changed_share, 0.3);
      EXPECT_GT(statistics.extinction_rms, 0.05 * statistics.extinction_deviation);
    }
  }
}

}  // namespace
}  // namespace shellgrid
