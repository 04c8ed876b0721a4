// SPDX-License-Identifier: AGPL-3.0-or-later
#include "meshing/polycube/block_cover.h"

#include <gtest/gtest.h>

#include "meshing/core/random.h"
#include "meshing/polycube/sample_pieces.h"
#include "meshing/polycube/stair_annealing.h"
#include "tests/meshing/polycube/shapes.h"

namespace shellgrid {
namespace {

TEST(BlockMasks, hold_the_samples_of_blocks_that_begin_at_any_even_sample) {
  const TriangleMesh mesh = voxel_shapes::hairpin(0.05);
  const SampleRaster raster = rasterize(mesh, Vec3(-2.03, -1.98, -2.01), 0.5, Vec3i(48, 32, 24));
  const BlockMasks masks(raster);
  long inside = 0, cut = 0;
  RandomStream random(5, 2);
  for (int trial = 0; trial < 2000; ++trial) {
    const Vec3i base = 2 * Vec3i(static_cast<int>(22 * random.next()), static_cast<int>(14 * random.next()),
                                 static_cast<int>(10 * random.next()));
    const BlockMask mask = masks.at(base);
    for (int bit = 0; bit < 64; ++bit) {
      const Vec3i sample = base + Vec3i(bit & 3, bit >> 2 & 3, bit >> 4);
      ASSERT_EQ(mask.inside >> bit & 1, raster.inside(sample) ? 1u : 0u);
      inside += raster.inside(sample);
      for (int axis = 0; axis < 3; ++axis) {
        ASSERT_EQ(mask.cut[axis] >> bit & 1, static_cast<unsigned>(raster.at(sample) >> axis & 1));
        cut += raster.at(sample) >> axis & 1;
      }
    }
  }
  EXPECT_GT(inside, 1000);
  EXPECT_GT(cut, 1000);
}

class CoverOfHairpin : public testing::Test {
 protected:
  // Block faces in y at 0.02 + 2n: the gap at y 4 to 4.05 lies inside the blocks with j = 2 or at their lower side.
  TriangleMesh mesh_ = voxel_shapes::hairpin(0.05);
  SampleRaster raster_ = rasterize(mesh_, Vec3(-2.0, -1.48, -2.0), 0.5, Vec3i(48, 32, 24));
  BlockMasks masks_{raster_};
  Vec3i counts_{11, 7, 5};
  TargetSurface surface_{mesh_};
};

TEST_F(CoverOfHairpin, a_thin_gap_splits_a_block_into_pieces_that_are_connected_only_around_it) {
  const SamplePieces pieces(masks_, Vec3i::Zero(), counts_, true);
  const BlockGrid shape(counts_);
  int split = 0;
  for (std::size_t b = 0; b < shape.filled.size(); ++b) {
    const double x = raster_.lower.x() + 2 * shape.place(b).x();
    const int first = pieces.main_piece(b);
    if (first < 0) continue;
    const BlockMask mask = masks_.at(4 * shape.place(b));
    const std::size_t count = mask.pieces(mask.inside).size();
    EXPECT_EQ(count, shape.place(b).y() == 2 && x >= 3 ? 2u : 1u) << shape.place(b).transpose();
    split += count == 2;
    if (count != 2) continue;
    if (x < 5) continue;
    // Each side goes on along its own bar only.
    for (int next : pieces.neighbours(first))
      for (int other : pieces.neighbours(first + 1)) EXPECT_NE(next, other);
  }
  EXPECT_GE(split, 8);
}

TEST_F(CoverOfHairpin, blocks_of_the_other_bar_do_not_cover) {
  const std::vector<TargetSurface::Sample> samples = surface_.samples(2000);
  BlockCover cover(raster_, masks_, Vec3i::Zero(), counts_, samples, 1, BlockCover::Side::inside);
  BlockGrid grid(counts_);
  // The lower bar alone: all blocks that begin below the gap by more than half a block.
  for (int k = 1; k < 3; ++k)
    for (int i = 1; i < 9; ++i) grid.filled[grid.index(i, 1, k)] = 1;
  cover.take(grid);
  // The samples of the upper bar at the gap are half a block from these blocks.
  std::size_t beyond = 0;
  for (const TargetSurface::Sample& sample : samples) beyond += sample.point.y() > 4 && sample.point.x() > 7;
  EXPECT_GT(beyond, 300u);
  EXPECT_GE(cover.uncovered_count(), beyond);
  const std::vector<std::size_t> helpful = cover.helpful_blocks();
  EXPECT_FALSE(helpful.empty());
  for (std::size_t b : helpful) {
    EXPECT_TRUE(cover.would_help(b));
    EXPECT_FALSE(grid.filled[b]);
  }
}

TEST_F(CoverOfHairpin, counts_go_up_and_down_with_the_blocks) {
  const std::vector<TargetSurface::Sample> samples = surface_.samples(500);
  BlockCover cover(raster_, masks_, Vec3i::Zero(), counts_, samples, 1, BlockCover::Side::inside);
  BlockGrid grid(counts_);
  cover.take(grid);
  EXPECT_EQ(cover.uncovered_count(), samples.size());
  RandomStream random(3, 3);
  for (int step = 0; step < 400; ++step) {
    const Vec3i block(1 + static_cast<int>(9 * random.next()), 1 + static_cast<int>(5 * random.next()),
                      1 + static_cast<int>(3 * random.next()));
    const std::size_t b = grid.index(block);
    const std::size_t before = cover.uncovered_count();
    if (grid.filled[b]) {
      const bool needed = cover.is_needed(b);
      cover.remove(b);
      EXPECT_EQ(cover.uncovered_count() > before, needed);
    } else {
      const bool helps = cover.would_help(b);
      cover.add(b);
      EXPECT_EQ(cover.uncovered_count() < before, helps);
    }
    grid.filled[b] ^= 1;
    const std::size_t kept = cover.uncovered_count();
    cover.take(grid);
    ASSERT_EQ(cover.uncovered_count(), kept);
  }
}

TEST(StairAnnealing, straightens_stairs_and_keeps_topology_and_cover) {
  const TriangleMesh mesh = voxel_shapes::torus(10, 4);
  const SampleRaster raster = rasterize(mesh, Vec3(-18.03, -18.01, -8.02), 0.4, Vec3i(92, 92, 44));
  const BlockMasks masks(raster);
  const Vec3i counts(22, 22, 10);
  const BlockParts parts(raster, masks, Vec3i::Zero(), counts);
  BlockGrid grid(counts);
  std::vector<double> cost(grid.filled.size(), 0);
  std::vector<std::size_t> blocks;
  for (std::size_t b = 0; b < grid.filled.size(); ++b) {
    grid.filled[b] = parts.fractions()[b] >= 0.5f && grid.may_fill(grid.place(b));
    cost[b] = 2.5 * (1 - 2 * parts.fractions()[b]);
    if (grid.may_fill(grid.place(b))) blocks.push_back(b);
  }
  std::vector<Vec3i> filled;
  for (std::size_t b = 0; b < grid.filled.size(); ++b)
    if (grid.filled[b]) filled.push_back(grid.place(b));
  for (const Vec3i& b : fill_to_visible(filled)) grid.filled[grid.index(b)] = 1;
  ASSERT_EQ(count_ill_composed(grid), 0u);
  ASSERT_EQ(boundary_euler_characteristic(grid), 0);
  const std::vector<TargetSurface::Sample> samples = TargetSurface(mesh).samples(3000);
  BlockCover inner(raster, masks, Vec3i::Zero(), counts, samples, 1, BlockCover::Side::inside);
  BlockCover outer(raster, masks, Vec3i::Zero(), counts, samples, 1, BlockCover::Side::outside);
  inner.take(grid), outer.take(grid);
  ASSERT_EQ(inner.uncovered_count(), 0u);
  ASSERT_EQ(outer.uncovered_count(), 0u);
  const SingularityCounts before = count_singularities(grid);
  anneal_stairs(grid, cost, blocks, parts, inner, outer, 200);
  const SingularityCounts after = count_singularities(grid);
  EXPECT_LT(static_cast<double>(after.edges), 0.8 * static_cast<double>(before.edges));
  EXPECT_LT(static_cast<double>(after.corners), 0.8 * static_cast<double>(before.corners));
  EXPECT_EQ(count_ill_composed(grid), 0u);
  EXPECT_EQ(boundary_euler_characteristic(grid), 0);
  inner.take(grid), outer.take(grid);
  EXPECT_EQ(inner.uncovered_count(), 0u);
  EXPECT_EQ(outer.uncovered_count(), 0u);
}

}  // namespace
}  // namespace shellgrid
