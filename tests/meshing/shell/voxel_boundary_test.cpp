// SPDX-License-Identifier: AGPL-3.0-or-later
#include "meshing/shell/voxel_boundary.h"

#include <gtest/gtest.h>

#include <Eigen/Geometry>
#include <cmath>
#include <map>
#include <numbers>

#include "meshing/core/random.h"

namespace shellgrid {
namespace {

double volume(const TriangleMesh& mesh) {
  double sum = 0;
  for (int f = 0; f < mesh.face_count(); ++f)
    sum += mesh.corner(f, 0).cross(mesh.corner(f, 1)).dot(mesh.corner(f, 2)) / 6;
  return sum;
}

// Each edge as often in the one direction as in the other.
void expect_closed(const TriangleMesh& mesh) {
  std::map<std::pair<int, int>, int> edges;
  for (int f = 0; f < mesh.face_count(); ++f)
    for (int k = 0; k < 3; ++k) {
      const int a = mesh.faces(f, k), b = mesh.faces(f, (k + 1) % 3);
      edges[std::minmax(a, b)] += a < b ? 1 : -1;
    }
  for (const auto& [edge, balance] : edges) EXPECT_EQ(balance, 0);
}

TEST(VoxelBoundary, BallIsSmoothAndKeepsItsVolume) {
  GridFrame frame;
  frame.voxel = 0.5;
  frame.origin = Vec3(1, 2, 3);
  constexpr double radius = 10.3;
  std::vector<Vec3i> voxels;
  for (int i = -12; i <= 12; ++i)
    for (int j = -12; j <= 12; ++j)
      for (int k = -12; k <= 12; ++k)
        if (Vec3(i, j, k).norm() <= radius) voxels.emplace_back(i, j, k);
  const TriangleMesh mesh = voxel_boundary(frame, voxels);
  expect_closed(mesh);
  EXPECT_NEAR(volume(mesh), 4 * std::numbers::pi / 3 * std::pow(0.5 * radius, 3), 0.03 * volume(mesh));
  double area = 0, turned = 0;
  for (int f = 0; f < mesh.face_count(); ++f) {
    const Vec3 a = mesh.corner(f, 0), n = (mesh.corner(f, 1) - a).cross(mesh.corner(f, 2) - a);
    const Vec3 out = ((a + mesh.corner(f, 1) + mesh.corner(f, 2)) / 3 - frame.origin).normalized();
    EXPECT_GT(n.dot(out), 0);
    area += n.norm() / 2;
    turned += n.norm() / 2 * std::acos(std::min(1.0, n.normalized().dot(out)));
  }
  EXPECT_LT(turned / area, 0.15);  // radians; of a staircase 0.5
}

TEST(VoxelBoundary, AnySetIsClosedAndSingleVoxelsStay) {
  GridFrame frame;
  RandomStream random(4);
  std::vector<Vec3i> voxels;
  for (int i = 0; i < 12; ++i)
    for (int j = 0; j < 12; ++j)
      for (int k = 0; k < 12; ++k)
        if (random.next() < 0.4) voxels.emplace_back(i, j, k);
  const TriangleMesh mesh = voxel_boundary(frame, voxels);
  expect_closed(mesh);
  EXPECT_TRUE(mesh.vertices.allFinite());
  const TriangleMesh one = voxel_boundary(frame, {Vec3i(3, -4, 5)});
  EXPECT_EQ(one.vertex_count(), 8);
  EXPECT_EQ(one.face_count(), 12);
  EXPECT_GT(volume(one), 0);
  EXPECT_LT((one.vertices.colwise().mean().transpose() - Vec3(3, -4, 5)).norm(), 1e-12);
  EXPECT_EQ(voxel_boundary(frame, {}).face_count(), 0);
}

}  // namespace
}  // namespace shellgrid
