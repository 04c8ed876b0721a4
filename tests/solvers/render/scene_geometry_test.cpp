// SPDX-License-Identifier: AGPL-3.0-or-later
#include "solvers/render/scene_geometry.h"

#include <gtest/gtest.h>

#include <array>
#include <cmath>
#include <limits>

#include "meshing/core/error.h"
#include "meshing/core/parallel.h"
#include "tests/support/closed_shapes.h"

namespace shellgrid {
namespace {

// The box [-1, 1]³ scaled by `half` and moved.
TriangleMesh box(double half, const Vec3& centre) {
  TriangleMesh mesh;
  mesh.vertices.resize(8, 3);
  for (int i = 0; i < 8; ++i)
    mesh.vertices.row(i) = (centre + half * Vec3(i & 1 ? 1 : -1, i & 2 ? 1 : -1, i & 4 ? 1 : -1)).transpose();
  mesh.faces.resize(12, 3);
  mesh.faces << 0, 2, 3, 0, 3, 1, 4, 5, 7, 4, 7, 6, 0, 1, 5, 0, 5, 4, 2, 6, 7, 2, 7, 3, 0, 4, 6, 0, 6, 2, 1, 3, 7, 1, 7,
      5;
  return mesh;
}

TEST(SceneGeometry, HitsABoxWhereTheClosedFormSays) {
  for (const double half : {1e-3, 1.0, 40.0, 1e6}) {
    const Vec3 centre = half * Vec3(100, -50, 30);
    const SceneGeometry geometry(box(half, centre));
    const Vec3 origin = centre + half * Vec3(0.3, -0.2, 5);
    const auto hit = geometry.intersect(origin, Vec3(0, 0, -1));
    ASSERT_TRUE(hit);
    EXPECT_NEAR(hit->distance, 4 * half, 1e-5 * half);
    EXPECT_NEAR((hit->normal - Vec3(0, 0, 1)).norm(), 0, 1e-12);
    EXPECT_NEAR(hit->barycentric.sum(), 1, 1e-12);
    EXPECT_NEAR((hit->point - (centre + half * Vec3(0.3, -0.2, 1))).norm(), 0, 1e-5 * half);
    EXPECT_FALSE(geometry.intersect(origin, Vec3(0, 0, 1)));
  }
}

TEST(SceneGeometry, OcclusionEndsAtTheGivenDistanceAndStartsOffTheSurface) {
  const SceneGeometry geometry(box(1, Vec3::Zero()));
  EXPECT_TRUE(geometry.occluded(Vec3(0, 0, 5), Vec3(0, 0, -1)));
  EXPECT_TRUE(geometry.occluded(Vec3(0, 0, 5), Vec3(0, 0, -1), 4.1));
  EXPECT_FALSE(geometry.occluded(Vec3(0, 0, 5), Vec3(0, 0, -1), 3.9));
  EXPECT_FALSE(geometry.occluded(Vec3(0.1, 0.2, 1), Vec3(0, 0, 1)));
  EXPECT_TRUE(geometry.occluded(Vec3(0.1, 0.2, 1), Vec3(0, 0, -1)));
  EXPECT_FALSE(geometry.occluded(Vec3(0.1, 0.2, 1), Vec3(0, 0, -1), 0));
}

TEST(SceneGeometry, AnswersForRaysTogetherAsForEach) {
  const SceneGeometry geometry(shapes::joined(box(1, Vec3::Zero()), box(0.5, Vec3(2, 1, 3))));
  int hidden = 0, open = 0;
  for (int n = 0; n < 400; ++n) {
    const Vec3 origin(2.5 * std::sin(n), 2.5 * std::cos(1.7 * n), 2.5 * std::sin(2.3 * n + 1));
    const int count = n % SceneGeometry::most_rays + 1;
    std::array<Vec3, SceneGeometry::most_rays> directions;
    std::array<double, SceneGeometry::most_rays> distances;
    std::uint32_t expected = 0;
    for (int k = 0; k < count; ++k) {
      directions[k] = Vec3(std::sin(5.1 * n + 2.9 * k), std::cos(3.3 * k + n), std::sin(k - 0.7 * n)).normalized();
      distances[k] = k % 3 == 0 ? std::numeric_limits<double>::infinity() : k % 3 == 1 ? 0.3 * (n % 13) : 0;
      if (geometry.occluded(origin, directions[k], distances[k]))
        expected |= 1u << k, ++hidden;
      else
        ++open;
    }
    EXPECT_EQ(geometry.occluded(origin, directions.data(), distances.data(), count), expected) << n;
  }
  EXPECT_GT(hidden, 100);
  EXPECT_GT(open, 200);
}

TEST(SceneGeometry, KnowsInsideFromOutside) {
  const SceneGeometry geometry(box(1, Vec3(3, 0, 0)));
  EXPECT_TRUE(geometry.contains(Vec3(3, 0, 0)));
  EXPECT_TRUE(geometry.contains(Vec3(3.99, 0.9, -0.9)));
  EXPECT_FALSE(geometry.contains(Vec3(4.01, 0, 0)));
  EXPECT_FALSE(geometry.contains(Vec3(0, 0, 0)));
}

TEST(SceneGeometry, RefusesNothingAndNonsense) {
  EXPECT_THROW(SceneGeometry(TriangleMesh{}), InputError);
  TriangleMesh mesh = box(1, Vec3::Zero());
  mesh.vertices(3, 1) = std::numeric_limits<double>::quiet_NaN();
  EXPECT_THROW(SceneGeometry{mesh}, InputError);
}

// Run alone, for what TBB's workers do is settled by their first task.
TEST(SceneGeometry, LeavesTheArithmeticOfLaterParallelWorkAsItIs) {
  const TriangleMesh mesh = shapes::sphere(10, 4);
  const SceneGeometry geometry(mesh);
  const int flushed = parallel_sum(
      1000, 0,
      [](std::size_t) {
        volatile float small = 1e-20f;
        return small * small == 0 ? 1 : 0;
      },
      1);
  EXPECT_EQ(flushed, 0);
}

}  // namespace
}  // namespace shellgrid
