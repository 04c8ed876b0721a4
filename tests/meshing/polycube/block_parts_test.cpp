// SPDX-License-Identifier: AGPL-3.0-or-later
#include "meshing/polycube/block_parts.h"

#include <gtest/gtest.h>

#include "meshing/core/random.h"
#include "meshing/polycube/target_surface.h"
#include "meshing/polycube/voxel_polycube.h"
#include "tests/meshing/polycube/shapes.h"

namespace shellgrid {
namespace {

using voxel_shapes::hairpin;

TEST(SampleRaster, agrees_with_the_shape_and_sees_a_gap_thinner_than_its_samples) {
  const TriangleMesh mesh = hairpin(0.05);
  const SampleRaster raster = rasterize(mesh, Vec3(-1.01, -1.02, -1.03), 0.25, Vec3i(72, 48, 24));
  long inside = 0, cut = 0;
  for (int k = 0; k < raster.size.z(); ++k)
    for (int j = 0; j < raster.size.y(); ++j)
      for (int i = 0; i < raster.size.x(); ++i) {
        const Vec3 c = raster.centre({i, j, k});
        const bool in_gap = c.y() > 4 && c.y() < 4.05 && c.x() > 3;
        const bool expected = c.x() > 0 && c.x() < 16 && c.y() > 0 && c.y() < 8.05 && c.z() > 0 && c.z() < 4 && !in_gap;
        ASSERT_EQ(raster.inside({i, j, k}), expected) << c.transpose();
        inside += expected;
        // Across the gap both samples are inside and the surface passes between them.
        if (expected && c.x() > 3.3 && c.y() < 4 && c.y() + 0.25 > 4.05 && raster.inside({i, j + 1, k})) {
          EXPECT_TRUE(raster.at({i, j, k}) & 2);
          ++cut;
        }
      }
  EXPECT_GT(inside, 1000);
  EXPECT_GT(cut, 100);
}

TEST(BlockParts, parts_blocks_on_both_sides_of_a_thin_gap_but_not_near_the_joint) {
  const TriangleMesh mesh = hairpin(0.05);
  const Vec3 lower(-2.0, -1.98, -2.0);  // block faces at y = 0.02 + 2n: the gap lies just below one
  const SampleRaster raster = rasterize(mesh, lower, 0.5, Vec3i(48, 32, 24));
  const Vec3i counts(10, 6, 5);
  const BlockMasks masks(raster);
  const BlockParts parts(raster, masks, Vec3i::Zero(), counts);
  int parted = 0;
  for (int i = 1; i < 9; ++i) {
    const double x = lower.x() + 2 * i;  // the block's lower side
    const bool is_parted = parts.are_parted({i, 2, 1}, 1);
    if (x >= 8) {
      EXPECT_TRUE(is_parted) << "x " << x;
      parted += is_parted;
    }
    if (x < 3) {
      EXPECT_FALSE(is_parted) << "x " << x;
    }
    EXPECT_FALSE(parts.are_parted({i, 1, 1}, 1));
  }
  EXPECT_GE(parted, 3);
}

TEST(BlockParts, keeps_two_bars_apart_that_nearly_touch) {
  const TriangleMesh mesh = hairpin(0.1);
  PolycubeOptions options;
  options.nodes = 6000;
  options.blocks = 800;
  const VoxelPolycube polycube = build_voxel_polycube(mesh, options);
  EXPECT_EQ(polycube.genus, 0);
  // Walking over filled blocks from the end of one bar to the end of the other leads through the joint.
  const double edge = polycube.spacing * polycube.cells_per_block;
  std::map<std::array<int, 3>, int> steps;
  std::vector<Vec3i> front;
  double far = 0;
  for (const Vec3i& b : polycube.blocks) far = std::max(far, polycube.origin.x() + edge * (b.x() + 0.5));
  for (const Vec3i& b : polycube.blocks) {
    const Vec3 centre = polycube.origin + edge * (b.cast<double>() + Vec3::Constant(0.5));
    if (centre.x() > far - 1.5 * edge && centre.y() < 3) steps[{b.x(), b.y(), b.z()}] = 0, front.push_back(b);
  }
  ASSERT_FALSE(front.empty());
  std::map<std::array<int, 3>, bool> filled;
  for (const Vec3i& b : polycube.blocks) filled[{b.x(), b.y(), b.z()}] = true;
  while (!front.empty()) {
    std::vector<Vec3i> next;
    for (const Vec3i& b : front)
      for (int axis = 0; axis < 3; ++axis)
        for (int side : {-1, 1}) {
          const Vec3i n = b + side * Vec3i::Unit(axis);
          if (!filled.count({n.x(), n.y(), n.z()}) || steps.count({n.x(), n.y(), n.z()})) continue;
          steps[{n.x(), n.y(), n.z()}] = steps[{b.x(), b.y(), b.z()}] + 1;
          next.push_back(n);
        }
    front = std::move(next);
  }
  int nearest = 1000;
  for (const Vec3i& b : polycube.blocks) {
    const Vec3 centre = polycube.origin + edge * (b.cast<double>() + Vec3::Constant(0.5));
    if (centre.x() > far - 1.5 * edge && centre.y() > 5) nearest = std::min(nearest, steps[{b.x(), b.y(), b.z()}]);
  }
  ASSERT_LT(nearest, 1000);
  // There and back along some ten of the sixteen units.
  EXPECT_GT(nearest * edge, 16);
}

TEST(BlockGrid, fills_any_blocks_until_all_corners_see_their_faces) {
  RandomStream random(7, 1);
  for (int trial = 0; trial < 60; ++trial) {
    std::vector<Vec3i> blocks;
    const double part = 0.1 + 0.8 * random.next();
    for (int k = 0; k < 5; ++k)
      for (int j = 0; j < 4; ++j)
        for (int i = 0; i < 4; ++i)
          if (random.next() < part) blocks.push_back({i + 3, j - 2, k});
    if (blocks.empty()) continue;
    const std::vector<Vec3i> filled = fill_to_visible(blocks);
    BlockGrid grid(Vec3i::Constant(12));
    for (const Vec3i& b : filled) grid.filled[grid.index(b + Vec3i::Constant(3))] = 1;
    EXPECT_EQ(grid.count(), filled.size());
    for (const Vec3i& b : blocks) EXPECT_TRUE(grid.at(b + Vec3i::Constant(3)));
    EXPECT_EQ(count_ill_composed(grid), 0u);
    for (int k = 0; k <= 12; ++k)
      for (int j = 0; j <= 12; ++j)
        for (int i = 0; i <= 12; ++i) {
          const int window = window_at(grid, {i, j, k});
          if (window != 0 && window != 255) EXPECT_TRUE(has_visible_normal(window));
        }
  }
}

}  // namespace
}  // namespace shellgrid
