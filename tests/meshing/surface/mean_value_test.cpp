// SPDX-License-Identifier: AGPL-3.0-or-later
#include "meshing/surface/mean_value.h"

#include <gtest/gtest.h>

#include "tests/support/closed_shapes.h"

namespace shellgrid {
namespace {

// Linear values at a mesh's vertices: one column each for 1, x, y, z and 2 − x + 3 y.
Eigen::MatrixXd linear_values(const TriangleMesh& mesh) {
  Eigen::MatrixXd values(mesh.vertex_count(), 5);
  for (int v = 0; v < mesh.vertex_count(); ++v) {
    const Vec3 p = mesh.vertex(v);
    values.row(v) << 1, p.x(), p.y(), p.z(), 2 - p.x() + 3 * p.y();
  }
  return values;
}

Vec3 point_in_torus(int i) {
  const double u = 6.3 * to_unit(hash64(i, 1)), v = 6.3 * to_unit(hash64(i, 2)), r = 0.7 * to_unit(hash64(i, 3));
  return {(2 + r * std::cos(v)) * std::cos(u), (2 + r * std::cos(v)) * std::sin(u), r * std::sin(v)};
}

TEST(MeanValue, ReproducesLinearFunctionsInsideAnyClosedMesh) {
  const TriangleMesh torus = shapes::torus(2, 0.8, 24, 12);
  std::vector<std::int32_t> cluster;
  const TriangleMesh merged = cluster_vertices(torus, 0.37, cluster);
  EXPECT_LT(merged.face_count(), torus.face_count());
  EXPECT_GT(merged.face_count(), torus.face_count() / 8);
  for (const TriangleMesh* mesh : {&torus, &merged}) {
    const Eigen::MatrixXd values = linear_values(*mesh);
    for (int i = 0; i < 200; ++i) {
      const Vec3 p = 0.6 * point_in_torus(i) + 0.4 * point_in_torus(i).cwiseProduct(Vec3(1, 1, 0.5));
      const Eigen::RowVectorXd found = mean_value(*mesh, values, p);
      EXPECT_NEAR(found[0], 1, 1e-9);
      EXPECT_NEAR(found[1], p.x(), 1e-7);
      EXPECT_NEAR(found[2], p.y(), 1e-7);
      EXPECT_NEAR(found[3], p.z(), 1e-7);
      EXPECT_NEAR(found[4], 2 - p.x() + 3 * p.y(), 1e-7);
    }
  }
}

TEST(MeanValue, IsTheBoundarysOwnOnTheBoundary) {
  const TriangleMesh box = shapes::box({2, 3, 4});
  Eigen::MatrixXd values(8, 1);
  for (int v = 0; v < 8; ++v) values(v, 0) = to_unit(hash64(v, 7));
  for (int v = 0; v < 8; ++v) EXPECT_EQ(mean_value(box, values, box.vertex(v))[0], values(v, 0));
  for (int f = 0; f < box.face_count(); ++f) {
    const Vec3 w(0.2, 0.3, 0.5);
    Vec3 p = Vec3::Zero();
    double expected = 0;
    for (int k = 0; k < 3; ++k) p += w[k] * box.vertex(box.faces(f, k)), expected += w[k] * values(box.faces(f, k), 0);
    EXPECT_NEAR(mean_value(box, values, p)[0], expected, 1e-6);
    // And towards it.
    EXPECT_NEAR(mean_value(box, values, p * (1 - 1e-6))[0], expected, 1e-4);
  }
}

TEST(MeanValue, StaysInTheRangeOfAConvexMesh) {
  const TriangleMesh box = shapes::box({1, 1, 5});
  Eigen::MatrixXd values(8, 1);
  for (int v = 0; v < 8; ++v) values(v, 0) = v % 3;
  for (int i = 0; i < 300; ++i) {
    const Vec3 p(to_unit(hash64(i, 1)) - 0.5, to_unit(hash64(i, 2)) - 0.5, 5 * to_unit(hash64(i, 3)) - 2.5);
    const double found = mean_value(box, values, p)[0];
    EXPECT_GE(found, 0);
    EXPECT_LE(found, 2);
  }
}

TEST(MeanValue, MergedMeshesStayCycles) {
  std::vector<std::int32_t> cluster;
  const TriangleMesh merged = cluster_vertices(shapes::torus(2, 0.8, 60, 40), 0.5, cluster);
  std::map<std::pair<int, int>, int> passed;
  for (int f = 0; f < merged.face_count(); ++f)
    for (int k = 0; k < 3; ++k) {
      const int a = merged.faces(f, k), b = merged.faces(f, (k + 1) % 3);
      passed[std::minmax(a, b)] += a < b ? 1 : -1;
    }
  for (const auto& [edge, count] : passed) EXPECT_EQ(count, 0) << edge.first << ", " << edge.second;
}

}  // namespace
}  // namespace shellgrid
