// SPDX-License-Identifier: AGPL-3.0-or-later
#include "meshing/distance/distance_field.h"

#include <gtest/gtest.h>
#include <oneapi/tbb/global_control.h>

#include <Eigen/Geometry>
#include <algorithm>
#include <cstring>

#include "meshing/core/error.h"
#include "meshing/core/random.h"
#include "meshing/distance/winding_number.h"
#include "tests/meshing/distance/sides_of_mesh.h"
#include "tests/support/closed_shapes.h"

namespace shellgrid {
namespace {

// Nearest point by looking at the plane and the three edges in turn.
Vec3 nearest_on_triangle(const Vec3& p, const Vec3& a, const Vec3& b, const Vec3& c) {
  const Vec3 n = (b - a).cross(c - a);
  const Vec3 q = p - n.dot(p - a) / n.squaredNorm() * n;
  if ((b - a).cross(q - a).dot(n) >= 0 && (c - b).cross(q - b).dot(n) >= 0 && (a - c).cross(q - c).dot(n) >= 0)
    return q;
  Vec3 best = a;
  for (const auto& [s, t] : {std::pair(a, b), std::pair(b, c), std::pair(c, a)}) {
    const Vec3 r = s + std::clamp((p - s).dot(t - s) / (t - s).squaredNorm(), 0.0, 1.0) * (t - s);
    if ((r - p).squaredNorm() < (best - p).squaredNorm()) best = r;
  }
  return best;
}

// Turns around a point, by the solid angles of all triangles: 1 inside, 0 outside.
// Source: [VanOosteromStrackee1983 eq. 8].
double winding_number(const TriangleMesh& mesh, const Vec3& p) {
  double sum = 0;
  for (int f = 0; f < mesh.face_count(); ++f) {
    const Vec3 a = mesh.corner(f, 0) - p, b = mesh.corner(f, 1) - p, c = mesh.corner(f, 2) - p;
    const double la = a.norm(), lb = b.norm(), lc = c.norm();
    sum += 2 * std::atan2(a.dot(b.cross(c)), la * lb * lc + a.dot(b) * lc + b.dot(c) * la + c.dot(a) * lb);
  }
  return sum / (4 * std::numbers::pi);
}

// Compares every grid point around the object with brute force over all triangles and vertices.
void expect_equals_brute_force(const TriangleMesh& mesh, const DistanceOptions& options) {
  DistanceStatistics statistics;
  const DistanceField field = compute_distance_field(mesh, options, statistics);
  const double tolerance = 1e-5 * options.voxel;
  const Vec3 margin = Vec3::Constant(options.outside_band + 2 * options.voxel);
  const Vec3i lower =
      ((mesh.vertices.colwise().minCoeff().transpose() - margin) / options.voxel).array().floor().cast<int>();
  const Vec3i upper =
      ((mesh.vertices.colwise().maxCoeff().transpose() + margin) / options.voxel).array().ceil().cast<int>();
  std::int64_t within = 0;
  for (int i = lower.x(); i <= upper.x(); ++i)
    for (int j = lower.y(); j <= upper.y(); ++j)
      for (int k = lower.z(); k <= upper.z(); ++k) {
        const Vec3 p = options.voxel * Vec3(i, j, k);
        double least = std::numeric_limits<double>::infinity();
        for (int f = 0; f < mesh.face_count(); ++f)
          least = std::min(
              least, (nearest_on_triangle(p, mesh.corner(f, 0), mesh.corner(f, 1), mesh.corner(f, 2)) - p).norm());
        const bool on_surface = least < 1e-5 * options.voxel;
        const bool inside = on_surface ? field.distance.value(i, j, k) < 0 : winding_number(mesh, p) > 0.5;
        const double band = inside ? options.inside_band : options.outside_band;
        const bool active = field.distance.is_active(i, j, k);
        ASSERT_EQ(active, field.nearest_point.is_active(i, j, k));
        ASSERT_EQ(active, field.nearest_vertex.is_active(i, j, k));
        if (std::abs(least - band) > 1e-9) {
          ASSERT_EQ(active, least < band) << i << ' ' << j << ' ' << k << " at " << least;
        }
        within += active;
        if (!active) {
          if (field.distance.find_leaf(TwoLevelGrid<float>::leaf_of(i, j, k)) >= 0) {
            ASSERT_EQ(field.distance.value(i, j, k),
                      static_cast<float>(inside ? -options.inside_band : options.outside_band));
          }
          continue;
        }
        ASSERT_NEAR(field.distance.value(i, j, k), inside ? -least : least, tolerance) << i << ' ' << j << ' ' << k;
        const Vec3 nearest = field.nearest_point.value(i, j, k).cast<double>();
        ASSERT_NEAR((nearest - p).norm(), least, tolerance);
        double nearest_vertex = std::numeric_limits<double>::infinity();
        for (int v = 0; v < mesh.vertex_count(); ++v)
          nearest_vertex = std::min(nearest_vertex, (mesh.vertex(v) - nearest).norm());
        const int found = field.nearest_vertex.value(i, j, k);
        ASSERT_GE(found, 0);
        ASSERT_NEAR((mesh.vertex(found) - nearest).norm(), nearest_vertex, tolerance);
      }
  EXPECT_EQ(within, static_cast<std::int64_t>(field.distance.active_count()));
  EXPECT_EQ(within, statistics.active_samples);
  EXPECT_LE(statistics.active_samples, statistics.visited_samples);
  EXPECT_EQ(statistics.allocated_leaves, field.distance.leaf_count());
}

constexpr DistanceOptions wide{.voxel = 0.25, .inside_band = 1.1, .outside_band = 0.6};

TEST(DistanceField, OfABoxWithCornersOnGridPointsIsExact) { expect_equals_brute_force(shapes::box({4, 3, 2}), wide); }

TEST(DistanceField, OfRotatedBoxesIsExact) {
  for (int seed = 0; seed < 3; ++seed) expect_equals_brute_force(shapes::rotated(shapes::box({4, 3, 2}), seed), wide);
}

TEST(DistanceField, OfAThinSlabHasTheRightSign) {
  expect_equals_brute_force(shapes::box({4, 3, 1e-3}), wide);
  expect_equals_brute_force(shapes::moved(shapes::box({4, 3, 1e-4}), Vec3(0, 0, 0.1)), wide);
  expect_equals_brute_force(shapes::rotated(shapes::box({4, 3, 1e-3}), 5), wide);
  expect_equals_brute_force(shapes::rotated(shapes::box({4, 3, 0.3}), 6), wide);
}

TEST(DistanceField, AroundKnifeEdgesAndSpikesHasTheRightSign) {
  expect_equals_brute_force(shapes::rotated(shapes::double_cone(3, 2, 0.02, 0.02), 1), wide);
  expect_equals_brute_force(shapes::double_cone(40, 0.05, 3, 0.5), wide);
  expect_equals_brute_force(shapes::rotated(shapes::double_cone(64, 2, 1, -0.5), 3), wide);  // a dented cone
}

TEST(DistanceField, OfATorusAndASphereIsExact) {
  expect_equals_brute_force(shapes::rotated(shapes::torus(1.5, 0.6, 24, 12), 4), wide);
  expect_equals_brute_force(shapes::sphere(1.7, 3), {.voxel = 0.2, .inside_band = 3, .outside_band = 0.1});
}

TEST(DistanceField, OfAShellWithACavityIsNegativeInTheSolidOnly) {
  expect_equals_brute_force(shapes::joined(shapes::sphere(2, 2), shapes::turned_around(shapes::sphere(1, 2))), wide);
}

TEST(DistanceField, WithoutNeedOfEvenTrianglesFindsTheNearestVertexOfAll) {
  // Long needles: the nearest vertex is often none of the nearest face's corners.
  expect_equals_brute_force(shapes::rotated(shapes::torus(1.5, 0.6, 60, 4), 8), wide);
}

TEST(DistanceField, OfARoughBallWithWideBandsIsExact) {
  // Vertices of every kind: peaks, pits and saddles, seen from much farther than their distances.
  TriangleMesh mesh = shapes::sphere(1.5, 3);
  for (int v = 0; v < mesh.vertex_count(); ++v) mesh.vertices.row(v) *= 1 + 0.12 * (to_unit(hash64(3, 5, v)) - 0.5);
  expect_equals_brute_force(mesh, {.voxel = 0.15, .inside_band = 2, .outside_band = 1});
}

TEST(DistanceField, OfTrianglesMuchSmallerAndMuchLargerThanAVoxelIsExact) {
  expect_equals_brute_force(shapes::sphere(1, 4), {.voxel = 0.4, .inside_band = 1, .outside_band = 2});
  // Spans several blocks of the scan.
  expect_equals_brute_force(shapes::rotated(shapes::box({5, 4, 6}), 9),
                            {.voxel = 0.1, .inside_band = 0.3, .outside_band = 0.4});
}

TEST(DistanceField, OfAMeshWithAFlatTriangleIsExact) {
  // A point on an edge of the box belongs to the faces on one side only; a triangle without area fills the crack.
  TriangleMesh mesh = shapes::rotated(shapes::box({4, 3, 2}), 2);
  const int a = mesh.faces(0, 0), b = mesh.faces(0, 1), c = mesh.faces(0, 2), middle = mesh.vertex_count();
  mesh.vertices.conservativeResize(middle + 1, 3);
  mesh.vertices.row(middle) = 0.5 * (mesh.vertices.row(a) + mesh.vertices.row(b));
  const int faces = mesh.face_count();
  mesh.faces.conservativeResize(faces + 2, 3);
  mesh.faces.row(0) << a, middle, c;
  mesh.faces.row(faces) << middle, b, c;
  mesh.faces.row(faces + 1) << a, b, middle;
  expect_equals_brute_force(mesh, wide);
}

TEST(DistanceField, ByWindingNumberEqualsTheClosedRuleOnCleanMeshes) {
  DistanceOptions options = wide;
  options.sign = SignRule::winding_number;
  expect_equals_brute_force(shapes::rotated(shapes::box({4, 3, 2}), 1), options);
  expect_equals_brute_force(shapes::rotated(shapes::box({4, 3, 1e-3}), 5), options);
  expect_equals_brute_force(shapes::rotated(shapes::double_cone(3, 2, 0.02, 0.02), 1), options);
  expect_equals_brute_force(shapes::double_cone(40, 0.05, 3, 0.5), options);
  expect_equals_brute_force(shapes::joined(shapes::sphere(2, 2), shapes::turned_around(shapes::sphere(1, 2))), options);
}

TEST(DistanceField, ByWindingNumberTakesGapsAndCrossings) {
  DistanceOptions options = wide;
  options.sign = SignRule::winding_number;
  // Balls through each other.
  expect_equals_brute_force(shapes::joined(shapes::sphere(1.2, 2), shapes::moved(shapes::sphere(1, 2), {1, 0.3, 0})),
                            options);
  // A ball without some of its triangles, with a triple and a turned one.
  TriangleMesh ball = shapes::rotated(shapes::sphere(1.5, 2), 7);
  const Eigen::Index faces = ball.faces.rows();
  ball.faces.row(3) = ball.faces.row(10);
  ball.faces.row(17) = ball.faces.row(10);
  std::swap(ball.faces(40, 0), ball.faces(40, 1));
  ball.faces.conservativeResize(faces - 2, 3);
  expect_equals_brute_force(ball, options);
  DistanceStatistics statistics;
  EXPECT_THROW(compute_distance_field(ball, wide, statistics), InputError);
  EXPECT_THROW(compute_distance_field(shapes::turned_around(ball), options, statistics), InputError);
}

TEST(WindingNumber, ErrorsAreBounded) {
  const TriangleMesh mesh = shapes::rotated(shapes::torus(1.5, 0.6, 40, 20), 4);
  TriangleMesh open = mesh;
  open.faces.conservativeResize(mesh.faces.rows() / 3, 3);
  const WindingNumber winding(open);
  RandomStream random(3);
  double greatest = 0;
  for (int n = 0; n < 2000; ++n) {
    const Vec3 p(4 * random.next() - 2, 4 * random.next() - 2, 4 * random.next() - 2);
    const double exact = winding_number(open, p);
    for (const double tolerance : {0.1, 1e-2, 1e-3, 1e-5, 0.0}) {
      const WindingNumber::Estimate found = winding.estimate(p, tolerance);
      ASSERT_LE(std::abs(found.value - exact), found.error + 1e-12);
      if (tolerance == 1e-3) greatest = std::max(greatest, found.error);
    }
    ASSERT_EQ(winding.inside(p), exact >= 0.5);
  }
  EXPECT_LT(greatest, 0.2);
  EXPECT_GT(greatest, 0.001);
}

TEST(WindingNumber, AgreesWithSidesOfTheMesh) {
  // At points near sharp edges, spikes and thin walls.
  for (const TriangleMesh& mesh :
       {shapes::rotated(shapes::box({4, 3, 1e-3}), 5), shapes::rotated(shapes::double_cone(3, 2, 0.02, 0.02), 1),
        shapes::double_cone(40, 0.05, 3, 0.5), shapes::rotated(shapes::double_cone(64, 2, 1, -0.5), 3),
        shapes::rotated(shapes::torus(1.5, 0.6, 60, 4), 8), shapes::sphere(1, 4)}) {
    const WindingNumber winding(mesh);
    RandomStream random(9);
    std::vector<Vec3> points;
    for (int n = 0; n < 4000; ++n) {
      const int f = static_cast<int>(random.next() * mesh.face_count());
      double u = random.next(), v = random.next();
      if (u + v > 1) u = 1 - u, v = 1 - v;
      if (n % 3 == 0) u *= 1e-3;  // beside an edge
      const Vec3 p =
          mesh.corner(f, 0) + u * (mesh.corner(f, 1) - mesh.corner(f, 0)) + v * (mesh.corner(f, 2) - mesh.corner(f, 0));
      const double reach = std::pow(10, -5 * random.next());
      points.push_back(p + reach * Vec3(random.next() - 0.5, random.next() - 0.5, random.next() - 0.5));
    }
    const std::vector<char> sides = test::sides_of_mesh(mesh, points);
    int inside = 0;
    for (std::size_t n = 0; n < points.size(); ++n) {
      if (sides[n] == 0) continue;  // on the surface
      ASSERT_EQ(winding.inside(points[n]), sides[n] > 0) << n;
      inside += sides[n] > 0;
    }
    EXPECT_GT(inside, 100);
  }
}

TEST(DistanceField, IsTheSameOnOneAndTwoThreads) {
  const TriangleMesh mesh = shapes::rotated(shapes::torus(5, 2, 60, 30), 2);
  DistanceField fields[2];
  for (int i = 0; i < 2; ++i) {
    const oneapi::tbb::global_control limit(oneapi::tbb::global_control::max_allowed_parallelism, i + 1);
    DistanceStatistics statistics;
    fields[i] = compute_distance_field(mesh, {.voxel = 0.2, .inside_band = 1, .outside_band = 0.4}, statistics);
  }
  ASSERT_EQ(fields[0].distance.leaf_count(), fields[1].distance.leaf_count());
  for (int leaf = 0; leaf < fields[0].distance.leaf_count(); ++leaf) {
    ASSERT_EQ(fields[0].distance.leaf_coordinate(leaf), fields[1].distance.leaf_coordinate(leaf));
    ASSERT_EQ(fields[0].distance.leaf_mask(leaf), fields[1].distance.leaf_mask(leaf));
    ASSERT_EQ(std::memcmp(fields[0].distance.leaf_values(leaf), fields[1].distance.leaf_values(leaf), 4 * 512), 0);
    ASSERT_EQ(
        std::memcmp(fields[0].nearest_vertex.leaf_values(leaf), fields[1].nearest_vertex.leaf_values(leaf), 4 * 512),
        0);
    ASSERT_EQ(
        std::memcmp(fields[0].nearest_point.leaf_values(leaf), fields[1].nearest_point.leaf_values(leaf), 12 * 512), 0);
  }
}

TEST(DistanceField, IsTheSameAtEverySize) {
  const TriangleMesh mesh = shapes::rotated(shapes::torus(1.5, 0.6, 24, 12), 4);
  DistanceStatistics statistics;
  const DistanceField one = compute_distance_field(mesh, wide, statistics);
  for (const int power : {-12, 20}) {  // a thousandth of a millimetre, a kilometre
    const double size = std::ldexp(1.0, power);
    TriangleMesh scaled = mesh;
    scaled.vertices *= size;
    for (const SignRule sign : {SignRule::closed, SignRule::winding_number}) {
      const DistanceField field = compute_distance_field(
          scaled, {wide.voxel * size, wide.inside_band * size, wide.outside_band * size, sign}, statistics);
      ASSERT_EQ(field.distance.active_count(), one.distance.active_count());
      one.distance.for_each_active([&](int i, int j, int k, float value) {
        ASSERT_EQ(field.distance.value(i, j, k), value * static_cast<float>(size));
        ASSERT_EQ(field.nearest_vertex.value(i, j, k), one.nearest_vertex.value(i, j, k));
      });
    }
  }
}

TEST(DistanceField, LeavesLeavesBeyondTheBandUnallocated) {
  DistanceStatistics statistics;
  const DistanceField field = compute_distance_field(
      shapes::sphere(10, 4), {.voxel = 0.2, .inside_band = 0.6, .outside_band = 0.4}, statistics);
  for (int leaf = 0; leaf < field.distance.leaf_count(); ++leaf) {
    bool any = false;
    for (const std::uint64_t word : field.distance.leaf_mask(leaf)) any |= word != 0;
    EXPECT_TRUE(any);
  }
  // The band is 1 mm of a ball of 10 mm in its box.
  EXPECT_LT(statistics.allocated_leaves, statistics.possible_leaves / 2);
  EXPECT_GT(statistics.skipped(), 0.4);
}

TEST(DistanceField, RefusesSurfacesThatBoundNothing) {
  DistanceStatistics statistics;
  TriangleMesh open = shapes::sphere(1, 1);
  open.faces.conservativeResize(open.faces.rows() - 1, 3);
  EXPECT_THROW(compute_distance_field(open, wide, statistics), InputError);
  EXPECT_THROW(compute_distance_field(shapes::turned_around(shapes::sphere(1, 1)), wide, statistics), InputError);
  EXPECT_THROW(compute_distance_field(TriangleMesh{}, wide, statistics), InputError);
  EXPECT_THROW(compute_distance_field(shapes::sphere(1, 1), {.voxel = 1e-9}, statistics), InputError);
}

}  // namespace
}  // namespace shellgrid
