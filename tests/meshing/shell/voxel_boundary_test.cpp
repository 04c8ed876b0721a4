// SPDX-License-Identifier: AGPL-3.0-or-later
#include "meshing/shell/voxel_boundary.h"

#include <gtest/gtest.h>

#include <Eigen/Geometry>
#include <cmath>
#include <map>
#include <numbers>
#include <set>
#include <tuple>

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

// One quad for each face of a voxel beside one that does not belong, and one vertex in each cell of both kinds.
TEST(VoxelBoundary, HasAllFacesWhereverTheVoxelsLie) {
  RandomStream random(9);
  std::set<std::tuple<int, int, int>> members;
  std::vector<Vec3i> voxels;
  for (int n = 0; n < 4000; ++n) {
    const Vec3i v = (Vec3(random.next(), random.next(), random.next()) * 40 - Vec3::Constant(20)).cast<int>();
    if (members.insert({v.x(), v.y(), v.z()}).second) voxels.push_back(v);
  }
  voxels.emplace_back(300, -200, 77);  // far from all others
  members.insert({300, -200, 77});
  int faces = 0;
  std::set<std::tuple<int, int, int>> cells;
  for (const Vec3i& v : voxels)
    for (int axis = 0; axis < 3; ++axis)
      for (const int side : {-1, 1}) {
        Vec3i next = v;
        next[axis] += side;
        if (members.contains({next.x(), next.y(), next.z()})) continue;
        ++faces;
        for (int k = 0; k < 4; ++k) {
          Vec3i cell = v;
          cell[axis] -= side < 0;
          cell[(axis + 1) % 3] -= k & 1;
          cell[(axis + 2) % 3] -= k >> 1;
          cells.insert({cell.x(), cell.y(), cell.z()});
        }
      }
  const TriangleMesh mesh = voxel_boundary(GridFrame(), voxels);
  EXPECT_EQ(mesh.face_count(), 2 * faces);
  EXPECT_EQ(mesh.vertex_count(), static_cast<int>(cells.size()));
  expect_closed(mesh);
  std::set<std::tuple<int, int, int>> found;
  for (int i = 0; i < mesh.vertex_count(); ++i) {
    const Vec3 at = mesh.vertex(i);
    found.insert({static_cast<int>(std::floor(at.x())), static_cast<int>(std::floor(at.y())),
                  static_cast<int>(std::floor(at.z()))});
  }
  EXPECT_EQ(found, cells);  // each in its cell
  EXPECT_GT(volume(mesh), 0);
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
