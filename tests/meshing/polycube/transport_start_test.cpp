// SPDX-License-Identifier: AGPL-3.0-or-later
#include "meshing/polycube/transport_start.h"

#include <gtest/gtest.h>

#include <algorithm>

#include "meshing/polycube/given_polycube.h"
#include "tests/meshing/polycube/shapes.h"
#include "tests/support/lattice_polygrid.h"

namespace shellgrid {
namespace {

// A plate of 6×4×2 units with an arm of 2×2×5 on it, `shift` units from its end.
bool in_shape(const Vec3& x, double shift) {
  return (x.z() < 2 && x.x() < 6 && x.y() < 4) ||
         (x.z() < 7 && x.x() >= shift && x.x() < shift + 2 && x.y() >= 1 && x.y() < 3);
}

std::vector<Vec3i> cubes(double shift) {
  std::vector<Vec3i> list;
  for (int k = 0; k < 7; ++k)
    for (int j = 0; j < 4; ++j)
      for (int i = 0; i < 6; ++i)
        if (in_shape(Vec3(i + 0.5, j + 0.5, k + 0.5), shift)) list.push_back({i, j, k});
  return list;
}

TriangleMesh object(double shift) {
  TriangleMesh mesh = voxel_shapes::voxel_surface(
      {24, 16, 28}, [&](int i, int j, int k) { return in_shape(Vec3(i + 0.5, j + 0.5, k + 0.5) / 4, shift); }, 3);
  mesh.vertices /= 4;
  return mesh;
}

TEST(TransportStart, AnArmFindsTheArmThatLiesCubesApart) {
  const std::vector<Vec3i> blocks = cubes(4);
  const LatticeGrid lattice = refine_blocks(blocks, 1);
  const VertexMatrix start = transport_start(blocks, object(1));
  ASSERT_EQ(start.rows(), lattice.points.rows());
  double moved = 0;
  int tip = 0;
  for (Eigen::Index p = 0; p < start.rows(); ++p)
    if (lattice.point_lattice[p].z() >= 6) moved += start(p, 0) - lattice.points(p, 0), ++tip;
  // Three cubes apart, less what the smoothing over neighbours leaves.
  EXPECT_LT(moved / tip, -1.5);
  EXPECT_GT(moved / tip, -3.5);
}

TEST(TransportStart, APolycubeThatFitsHardlyMoves) {
  const std::vector<Vec3i> blocks = cubes(2);
  EXPECT_LT((transport_start(blocks, object(2)) - refine_blocks(blocks, 1).points).rowwise().norm().maxCoeff(), 0.5);
}

TEST(TransportStart, TheGridOfARoughPolycubeIsValidAndReachesTheSurface) {
  const std::vector<Vec3i> blocks = cubes(4);
  const TargetSurface surface(object(1));
  const LayeredGrid grid = layer_rough_polycube(blocks, 2, surface, {});
  EXPECT_TRUE(inverted_cells(grid).empty());
  double farthest = 0;
  for (const LatticeHexahedron& cell : grid.layer)
    for (int k = 4; k < 8; ++k)
      farthest = std::max(farthest, surface.nearest(grid.points.row(cell[k]).transpose() / 2).distance);
  EXPECT_LT(farthest, 0.6);
}

}  // namespace
}  // namespace shellgrid
