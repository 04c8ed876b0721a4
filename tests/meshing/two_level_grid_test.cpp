// SPDX-License-Identifier: AGPL-3.0-or-later
#include "meshing/shell/two_level_grid.h"

#include "meshing/core/random.h"
#include "meshing/shell/leaf_march.h"
#include "meshing/shell/sample_runs.h"

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

TEST(TwoLevelGrid, AccessorReadsWhatTheGridHolds) {
  TwoLevelGrid<float> grid(Vec3i(-2, -1, -2), Vec3i(4, 3, 4), 4.0f);
  for (int n = 0; n < 300; ++n)
    grid.set(n * 7 % 30 - 15, n * 11 % 22 - 7, n * 13 % 10 - 15, static_cast<float>(n % 64));
  TwoLevelGrid<float>::Accessor accessor(grid);
  // Steps within leaves, between leaves, to where there is none, and out of the grid's bounds.
  for (int i = -20; i < 20; ++i)
    for (int j = -12; j < 20; j += 3)
      for (int k = -20; k < 20; ++k) {
        ASSERT_EQ(accessor.value(i, j, k), grid.value(i, j, k)) << i << ' ' << j << ' ' << k;
        const Vec3f place = Vec3f(i, j, k) + Vec3f(0.25f, 0.5f, 0.125f);
        ASSERT_EQ(accessor.interpolate(place), grid.interpolate(place));
      }
}

TEST(LeafMarch, MeetsEverySampleInLeavesOnceAndNoOther) {
  TwoLevelGrid<float> grid(Vec3i(-3, -2, -1), Vec3i(7, 5, 6), -1.0f);
  RandomStream random(11);
  const auto within = [&](int from, int to) { return from + static_cast<int>(random.next() * (to - from)); };
  for (int n = 0; n < 40; ++n) grid.allocate_leaf({within(-3, 4), within(-2, 3), within(-1, 5)});
  for (int leaf = 0; leaf < grid.leaf_count(); ++leaf)
    for (int n = 0; n < 512; ++n) grid.leaf_values(leaf)[n] = static_cast<float>(leaf * 512 + n);
  std::size_t total = 0;
  for (int ray = 0; ray < 3000; ++ray) {
    Vec3 origin(within(-40, 50), within(-40, 50), within(-40, 60)), step(within(-3, 4), within(-3, 4), within(-3, 4));
    if (ray % 4 != 0) origin += Vec3(random.next(), random.next(), random.next());
    if (ray % 4 == 1) origin.x() = std::floor(origin.x()) + 0.5;  // along faces of samples
    if (ray % 3 != 0) step += Vec3(random.next(), random.next(), random.next());
    const int count = within(1, 150);
    if (ray % 5 != 0) step = 2.0 / count * (Vec3(within(-24, 32), within(-16, 24), within(-8, 40)) - origin);
    if (step.isZero(0)) step.x() = 1;
    std::vector<std::pair<int, float>> expected, met;
    for (int n = 0; n < count; ++n) {
      const Vec3i at = ((origin + n * step).array() + 0.5).floor().cast<int>();
      if (grid.find_leaf(TwoLevelGrid<float>::leaf_of(at.x(), at.y(), at.z())) >= 0)
        expected.emplace_back(n, grid.value(at.x(), at.y(), at.z()));
    }
    for_each_sample_along(grid, origin, step, count, [&](int n, float value) { met.emplace_back(n, value); });
    ASSERT_EQ(met, expected) << ray;
    total += met.size();
  }
  EXPECT_GT(total, 10000u);
}

TEST(LeafMarch, OutsideTheGridMeetsNothing) {
  TwoLevelGrid<float> grid(Vec3i(0, 0, 0), Vec3i(2, 2, 2), 0.0f);
  grid.set(3, 3, 3, 1);
  int met = 0;
  const auto count = [&](int, float) { ++met; };
  for_each_sample_along(grid, {-5, 3, 3}, {-1, 0, 0}, 50, count);
  for_each_sample_along(grid, {-5, 30, 3}, {1, 0, 0}, 50, count);
  for_each_sample_along(grid, {30, 30, 30}, {1, 1, 1}, 50, count);
  for_each_sample_along(TwoLevelGrid<float>(), {0, 0, 0}, {1, 1, 1}, 50, count);
  EXPECT_EQ(met, 0);
  for_each_sample_along(grid, {-5, 3, 3}, {1, 0, 0}, 50, count);
  EXPECT_EQ(met, 8);
}

TwoLevelGrid<float> scattered_leaves() {
  TwoLevelGrid<float> grid(Vec3i(-3, -2, -1), Vec3i(7, 5, 6), -1.0f);
  RandomStream random(12);
  const auto within = [&](int from, int to) { return from + static_cast<int>(random.next() * (to - from)); };
  for (int n = 0; n < 60; ++n) grid.allocate_leaf({within(-3, 4), within(-2, 3), within(-1, 5)});
  for (int leaf = 0; leaf < grid.leaf_count(); ++leaf)
    for (int n = 0; n < 512; ++n) grid.leaf_values(leaf)[n] = static_cast<float>(leaf * 512 + n);
  return grid;
}

TEST(SampleRuns, ReadWhatTheGridHoldsAtEachPlace) {
  const TwoLevelGrid<float> grid = scattered_leaves();
  RandomStream random(13);
  for (const std::size_t count : {0, 1, 63, 64, 65, 1000}) {
    std::vector<Vec3i> places;
    for (std::size_t n = 0; n < count; ++n) {
      const double reach = n % 50 == 7 ? 4e9 : 120;
      const auto draw = [&] { return static_cast<int>((random.next() - 0.5) * reach); };
      places.emplace_back(draw(), draw(), draw());
    }
    std::vector<float> values(count + 1, -5.0f);
    read_samples(grid, places.data(), count, values.data());
    for (std::size_t n = 0; n < count; ++n)
      ASSERT_EQ(values[n], grid.value(places[n].x(), places[n].y(), places[n].z())) << n;
    EXPECT_EQ(values[count], -5.0f);
  }
}

TEST(SampleRuns, ReadTheNearestSamplesAlongALine) {
  const TwoLevelGrid<float> grid = scattered_leaves();
  RandomStream random(14);
  const auto within = [&](double from, double to) { return from + random.next() * (to - from); };
  int in_leaves = 0;
  for (int ray = 0; ray < 15000; ++ray) {
    Vec3 origin(within(-40, 50), within(-40, 50), within(-40, 60)), step(within(-2, 2), within(-2, 2), within(-2, 2));
    // Exact in binary: on faces of samples, along axes and standing still too.
    const bool exact = ray % 3 == 0;
    if (exact) origin = (2 * origin).array().round() / 2, step = (2 * step).array().round() / 2;
    if (ray % 50 == 1) origin *= 1e5, step *= 1e3;
    if (ray % 50 == 2) step *= 0x1p40;
    const int count = static_cast<int>(within(0, 300));
    std::vector<float> values(static_cast<std::size_t>(count) + 1, -5.0f);
    read_samples_along(grid, origin, step, count, values.data());
    for (int n = 0; n < count; ++n) {
      const Vec3 p = (origin + n * step).array() + 0.5;
      const Vec3 s = p.array().floor();
      if (!exact && ((p - s).array() < 1e-6 || (p - s).array() > 1 - 1e-6).any()) continue;
      const bool near = s.cwiseAbs().maxCoeff() < 1e6;
      const float expected = near
                                 ? grid.value(static_cast<int>(s.x()), static_cast<int>(s.y()), static_cast<int>(s.z()))
                                 : grid.background();
      ASSERT_EQ(values[n], expected) << ray << ' ' << n;
      in_leaves += expected != -1.0f;
    }
    EXPECT_EQ(values[count], -5.0f);
  }
  EXPECT_GT(in_leaves, 10000);
}

TEST(SampleRuns, OfAGridWithoutLeavesAreBackground) {
  const TwoLevelGrid<float> none, empty(Vec3i(0, 0, 0), Vec3i(2, 2, 2), 3.0f);
  const Vec3i place(1, 2, 3);
  float value = -5;
  read_samples(none, &place, 1, &value);
  EXPECT_EQ(value, 0.0f);
  read_samples_along(empty, {0, 0, 0}, {1, 0, 0}, 1, &value);
  EXPECT_EQ(value, 3.0f);
}

TEST(TwoLevelGrid, WithoutBoundsIsBackgroundEverywhere) {
  const TwoLevelGrid<float> grid;
  TwoLevelGrid<float>::Accessor accessor(grid);
  EXPECT_EQ(grid.value(0, 0, 0), 0.0f);
  EXPECT_EQ(accessor.value(-1, 2, 100), 0.0f);
  EXPECT_EQ(grid.interpolate({0.5f, 7.5f, 3}), 0.0f);
  EXPECT_EQ(accessor.interpolate({0.5f, 6.5f, 3}), 0.0f);
}

TEST(TwoLevelGrid, NeedsLittleMoreThanItsLeaves) {
  TwoLevelGrid<float> grid(Vec3i(0, 0, 0), Vec3i(20, 20, 20), 0.0f);
  std::vector<Vec3i> leaves;
  for (int n = 0; n < 20; ++n)
    for (int m = 0; m < 20; ++m) leaves.emplace_back(n, m, (n + m) / 2);
  grid.allocate_leaves(leaves);
  ASSERT_EQ(grid.leaf_count(), 400);
  for (int n = 0; n < 400; ++n) EXPECT_EQ(grid.find_leaf(leaves[n]), n);
  EXPECT_LE(static_cast<double>(grid.bytes()), 1.1 * 400 * 512 * sizeof(float));
}

}  // namespace
}  // namespace shellgrid
