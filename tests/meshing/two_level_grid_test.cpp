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

}  // namespace
}  // namespace shellgrid
