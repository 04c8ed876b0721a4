// SPDX-License-Identifier: AGPL-3.0-or-later
#include "meshing/shell/two_level_grid.h"

#include <gtest/gtest.h>

namespace shellgrid {
namespace {

TEST(TwoLevelGrid, ReturnsWhatWasSetAndBackgroundElsewhere) {
  TwoLevelGrid<float> grid(Vec3i(-2, -2, -2), Vec3i(4, 4, 4), 7.0f);
  grid.set(-16, 15, 0, 1.5f);
  EXPECT_EQ(grid.value(-16, 15, 0), 1.5f);
  EXPECT_TRUE(grid.is_active(-16, 15, 0));
  EXPECT_FALSE(grid.is_active(-15, 15, 0));
  EXPECT_EQ(grid.value(-15, 15, 0), 7.0f);
  EXPECT_EQ(grid.value(1000, -1000, 3), 7.0f);
  EXPECT_EQ(grid.leaf_count(), 1);
  EXPECT_EQ(grid.active_count(), 1u);
}

TEST(TwoLevelGrid, VisitsEachActiveSampleOnceAtItsOwnIndex) {
  TwoLevelGrid<int> grid(Vec3i(-1, -1, -1), Vec3i(3, 3, 3), -1);
  int expected = 0;
  for (int i = -8; i < 16; i += 3)
    for (int j = -8; j < 16; j += 5)
      for (int k = -8; k < 16; k += 7) grid.set(i, j, k, i * 10000 + j * 100 + k), ++expected;
  int visited = 0;
  grid.for_each_active([&](int i, int j, int k, int value) {
    EXPECT_EQ(value, i * 10000 + j * 100 + k);
    ++visited;
  });
  EXPECT_EQ(visited, expected);
}

TEST(TwoLevelGrid, InterpolatesTrilinearFunctionsExactlyAcrossLeaves) {
  const auto function = [](double x, double y, double z) {
    return 1 + 0.5 * x - 0.25 * y + 2 * z + 0.125 * x * y - 0.0625 * y * z + 0.03125 * x * y * z;
  };
  TwoLevelGrid<float> grid(Vec3i(-1, -1, -1), Vec3i(3, 3, 3), -7.0f);
  for (int i = -8; i < 16; ++i)
    for (int j = -8; j < 16; ++j)
      for (int k = -8; k < 16; ++k) grid.set(i, j, k, static_cast<float>(function(i, j, k)));
  for (float x = -7.75f; x < 15; x += 1.25f)
    for (float y = -8; y < 15; y += 0.875f)
      for (float z = -7.5f; z < 15; z += 0.625f)
        ASSERT_NEAR(grid.interpolate({x, y, z}), function(x, y, z), 1e-4) << x << ' ' << y << ' ' << z;
}

TEST(TwoLevelGrid, InterpolatesWithTheBackgroundWhereNothingIsAllocated) {
  TwoLevelGrid<float> grid(Vec3i(-1, -1, -1), Vec3i(3, 3, 3), 4.0f);
  grid.set(7, 7, 7, 12.0f);
  EXPECT_EQ(grid.interpolate({7, 7, 7}), 12.0f);
  EXPECT_EQ(grid.interpolate({7.5f, 7, 7}), 8.0f);
  EXPECT_EQ(grid.interpolate({7.5f, 7.5f, 7.5f}), 5.0f);
  EXPECT_EQ(grid.interpolate({6.5f, 7, 6.5f}), 6.0f);
  EXPECT_EQ(grid.interpolate({-3.5f, -3.5f, 12.25f}), 4.0f);
  EXPECT_EQ(grid.interpolate({1000, -1000, 0.5f}), 4.0f);
}

}  // namespace
}  // namespace shellgrid
