// SPDX-License-Identifier: AGPL-3.0-or-later
#include "meshing/polycube/genus_repair.h"

#include <gtest/gtest.h>

#include "meshing/polycube/surface_handles.h"
#include "meshing/polycube/voxel_polycube.h"
#include "meshing/surface/repair.h"
#include "tests/meshing/polycube/shapes.h"

namespace shellgrid {
namespace {

TEST(SurfaceHandles, are_where_the_surface_is_cut_open_and_as_many_as_its_genus) {
  const TriangleMesh torus = voxel_shapes::torus(10, 3);
  const std::vector<SurfaceHandle> one = find_handles(torus, 5);
  ASSERT_EQ(one.size(), 1u);
  // Around the tube, not around the hole.
  EXPECT_NEAR(one[0].length, 2 * std::numbers::pi * 3, 1);
  EXPECT_NEAR(one[0].centre.norm(), 10, 0.5);
  EXPECT_EQ(find_handles(voxel_shapes::double_torus(), 9).size(), 2u);
  EXPECT_EQ(find_handles(voxel_shapes::double_torus(), 1).size(), 1u);
  EXPECT_TRUE(find_handles(voxel_shapes::sphere(1), 3).empty());
}

// A ball with a thread above its surface: genus 1, thinner than any block.
TriangleMesh ball_with_thread() {
  const TriangleMesh ball = voxel_shapes::voxel_surface(
      Vec3i(41, 41, 44),
      [](int i, int j, int k) {
        if (std::hypot(i - 20, j - 20, k - 20) < 20) return true;
        return j == 20 && ((k == 42 && i >= 18 && i <= 22) || (k < 43 && k >= 38 && (i == 18 || i == 22)));
      },
      2);
  return ball;
}

TEST(GenusRepair, finds_a_handle_thinner_than_the_blocks) {
  const TriangleMesh mesh = ball_with_thread();
  ASSERT_EQ(genus(mesh), 1);
  PolycubeOptions options;
  options.nodes = 5000;
  options.blocks = 600;
  const VoxelPolycube polycube = build_voxel_polycube(mesh, options);
  EXPECT_EQ(polycube.genus, 1);
  EXPECT_GT(polycube.spacing * polycube.cells_per_block, 3);  // the thread is one thick
}

TEST(GenusRepair, drills_builds_fills_and_cuts_until_the_genus_is_right) {
  const TriangleMesh mesh = voxel_shapes::box(20, 20, 6);
  const Vec3i counts(16, 16, 9);
  const SampleRaster raster = rasterize(mesh, Vec3(-6.02, -6.01, -6.03), 0.5, 4 * counts);
  const BlockMasks masks(raster);
  const BlockParts parts(raster, masks, Vec3i::Zero(), counts);
  BlockGrid grid(counts);
  for (std::size_t b = 0; b < grid.filled.size(); ++b)
    grid.filled[b] = parts.fractions()[b] >= 0.5f && grid.may_fill(grid.place(b));
  ASSERT_EQ(boundary_euler_characteristic(grid), 2);
  const std::size_t before = grid.count();
  const std::vector<Vec3> places = {Vec3(5.5, 5.5, 4.5), Vec3(10.5, 10.5, 6)};
  EXPECT_EQ(repair_genus(grid, 2, places, parts), 2);
  EXPECT_EQ(boundary_euler_characteristic(grid), -2);
  EXPECT_EQ(count_ill_composed(grid), 0u);
  EXPECT_LE(std::abs(static_cast<double>(grid.count()) - static_cast<double>(before)), 12);
  EXPECT_EQ(repair_genus(grid, 0, {}, parts), 0);
  EXPECT_EQ(boundary_euler_characteristic(grid), 2);
  EXPECT_EQ(count_ill_composed(grid), 0u);
  BlockGrid whole = grid;
  keep_largest_component(whole);
  EXPECT_EQ(whole.count(), grid.count());
}

}  // namespace
}  // namespace shellgrid
