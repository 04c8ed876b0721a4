// SPDX-License-Identifier: AGPL-3.0-or-later
#include "meshing/surface/closest_point.h"

#include <gtest/gtest.h>

#include <Eigen/Geometry>
#include <algorithm>
#include <cmath>

#include "meshing/core/random.h"

namespace shellgrid {
namespace {

// Distance from a point to a triangle, region by region. Source: [Ericson2005 §5.1.5].
Vec3 nearest_on_triangle(const Vec3& p, const Vec3& a, const Vec3& b, const Vec3& c) {
  const Vec3 ab = b - a, ac = c - a, ap = p - a;
  const double d1 = ab.dot(ap), d2 = ac.dot(ap);
  if (d1 <= 0 && d2 <= 0) return a;
  const Vec3 bp = p - b;
  const double d3 = ab.dot(bp), d4 = ac.dot(bp);
  if (d3 >= 0 && d4 <= d3) return b;
  const double vc = d1 * d4 - d3 * d2;
  if (vc <= 0 && d1 >= 0 && d3 <= 0) return a + d1 / (d1 - d3) * ab;
  const Vec3 cp = p - c;
  const double d5 = ab.dot(cp), d6 = ac.dot(cp);
  if (d6 >= 0 && d5 <= d6) return c;
  const double vb = d5 * d2 - d1 * d6;
  if (vb <= 0 && d2 >= 0 && d6 <= 0) return a + d2 / (d2 - d6) * ac;
  const double va = d3 * d6 - d5 * d4;
  if (va <= 0 && d4 - d3 >= 0 && d5 - d6 >= 0) return b + (d4 - d3) / ((d4 - d3) + (d5 - d6)) * (c - b);
  return a + (ab * vb + ac * vc) / (va + vb + vc);
}

TriangleMesh triangle_soup(int faces, double edge, std::uint64_t seed) {
  RandomStream random(seed);
  const auto unit = [&] { return Vec3(random.next() - 0.5, random.next() - 0.5, random.next() - 0.5); };
  TriangleMesh mesh;
  mesh.vertices.resize(3 * faces, 3);
  mesh.faces.resize(faces, 3);
  for (int f = 0; f < faces; ++f) {
    const Vec3 centre = unit();
    for (int k = 0; k < 3; ++k) {
      mesh.vertices.row(3 * f + k) = (centre + edge * unit()).transpose();
      mesh.faces(f, k) = 3 * f + k;
    }
  }
  return mesh;
}

class ClosestPointOnSoup : public testing::TestWithParam<int> {};

TEST_P(ClosestPointOnSoup, WeighsFacesByTheirDirection) {
  const TriangleMesh mesh = triangle_soup(GetParam(), 0.2, 7);
  const ClosestPointQuery query(mesh, ClosestPointQuery::Facing::known);
  RandomStream random(13);
  const auto unit = [&] { return Vec3(random.next() - 0.5, random.next() - 0.5, random.next() - 0.5); };
  for (int i = 0; i < 300; ++i) {
    const Vec3 p = 3 * unit(), facing = unit().normalized();
    const double least_cosine = i % 2 ? -2 : 0.25;
    double least = std::numeric_limits<double>::infinity();
    const auto cost = [&](int f, const Vec3& place) {
      const Vec3 normal =
          (mesh.corner(f, 1) - mesh.corner(f, 0)).cross(mesh.corner(f, 2) - mesh.corner(f, 0)).normalized();
      return normal.dot(facing) < least_cosine ? std::numeric_limits<double>::infinity()
                                               : (place - p).squaredNorm() * (2 - normal.dot(facing));
    };
    for (int f = 0; f < mesh.face_count(); ++f)
      least = std::min(least, cost(f, nearest_on_triangle(p, mesh.corner(f, 0), mesh.corner(f, 1), mesh.corner(f, 2))));
    const SurfacePoint found = query.nearest_facing(p, facing, least_cosine);
    ASSERT_EQ(found.face_index >= 0, std::isfinite(least));
    if (found.face_index < 0) continue;
    EXPECT_NEAR(cost(found.face_index, found.point), least, 1e-12 * (1 + least));
    EXPECT_NEAR(found.squared_distance, (found.point - p).squaredNorm(), 1e-15);
  }
}

TEST_P(ClosestPointOnSoup, ListsTheFacesWithin) {
  const TriangleMesh mesh = triangle_soup(GetParam(), 0.2, 7);
  const ClosestPointQuery query(mesh);
  RandomStream random(17);
  for (int i = 0; i < 100; ++i) {
    const Vec3 p(random.next() - 0.5, random.next() - 0.5, random.next() - 0.5);
    std::vector<int> expected, found = query.faces_within(p, 0.2);
    for (int f = 0; f < mesh.face_count(); ++f)
      if ((nearest_on_triangle(p, mesh.corner(f, 0), mesh.corner(f, 1), mesh.corner(f, 2)) - p).norm() <= 0.2)
        expected.push_back(f);
    std::sort(found.begin(), found.end());
    EXPECT_EQ(found, expected);
  }
}

TEST_P(ClosestPointOnSoup, EqualsBruteForce) {
  const TriangleMesh mesh = triangle_soup(GetParam(), 0.2, 7);
  const ClosestPointQuery query(mesh);
  RandomStream random(11);
  for (int i = 0; i < 300; ++i) {
    const Vec3 p(3 * random.next() - 1.5, 3 * random.next() - 1.5, 3 * random.next() - 1.5);
    double least = std::numeric_limits<double>::infinity();
    for (int f = 0; f < mesh.face_count(); ++f)
      least = std::min(
          least, (nearest_on_triangle(p, mesh.corner(f, 0), mesh.corner(f, 1), mesh.corner(f, 2)) - p).squaredNorm());
    const SurfacePoint found = query.nearest(p);
    ASSERT_GE(found.face_index, 0);
    EXPECT_NEAR(std::sqrt(found.squared_distance), std::sqrt(least), 1e-13);
    EXPECT_NEAR((found.point - p).norm(), std::sqrt(least), 1e-12);
    Vec3 rebuilt = Vec3::Zero();
    for (int k = 0; k < 3; ++k) rebuilt += found.barycentric[k] * mesh.corner(found.face_index, k);
    EXPECT_LT((rebuilt - found.point).norm(), 1e-13);
    EXPECT_GE(found.barycentric.minCoeff(), 0);
    EXPECT_EQ(query.nearest(p, 0.999 * std::sqrt(least)).face_index, -1);
    EXPECT_GE(query.nearest(p, 1.001 * std::sqrt(least)).face_index, 0);
  }
}

INSTANTIATE_TEST_SUITE_P(Sizes, ClosestPointOnSoup, testing::Values(1, 7, 8, 9, 63, 65, 500, 3000));

TEST(ClosestPoint, ToleratesDegenerateTriangles) {
  TriangleMesh mesh;
  mesh.vertices.resize(4, 3);
  mesh.vertices << 0, 0, 0, 1, 0, 0, 0.25, 0, 0, 5, 5, 5;
  mesh.faces.resize(2, 3);
  mesh.faces << 0, 1, 2, 3, 3, 3;  // a segment and a point
  const ClosestPointQuery query(mesh);
  EXPECT_NEAR(query.nearest(Vec3(0.6, 2, 0)).squared_distance, 4, 1e-15);
  EXPECT_EQ(query.nearest(Vec3(5, 5, 6)).face_index, 1);
}

TEST(ClosestPoint, OfAnEmptyMeshIsNone) {
  EXPECT_EQ(ClosestPointQuery(TriangleMesh{}).nearest(Vec3::Zero()).face_index, -1);
}

TEST(NearestVertex, EqualsBruteForceWithTiesToTheLowestIndex) {
  RandomStream random(3);
  VertexMatrix points(2000, 3);
  for (int i = 0; i < points.rows(); ++i)  // a coarse lattice, so that many coincide and many tie
    points.row(i) << std::floor(8 * random.next()), std::floor(8 * random.next()), std::floor(8 * random.next());
  const NearestVertexQuery query(points);
  for (int i = 0; i < 2000; ++i) {
    const Vec3 p(std::floor(18 * random.next() - 1) / 2, std::floor(18 * random.next() - 1) / 2, 4 * random.next());
    int least = 0;
    for (int v = 1; v < points.rows(); ++v)
      if ((points.row(v).transpose() - p).squaredNorm() < (points.row(least).transpose() - p).squaredNorm()) least = v;
    EXPECT_EQ(query.nearest(p), least);
    EXPECT_EQ(query.nearest(p, static_cast<int>(2000 * random.next())), least);
  }
}

}  // namespace
}  // namespace shellgrid
