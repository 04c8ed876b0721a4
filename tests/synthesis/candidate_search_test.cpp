// SPDX-License-Identifier: AGPL-3.0-or-later
#include "synthesis/candidate_search.h"

#include <gtest/gtest.h>
#include <oneapi/tbb/global_control.h>

#include <algorithm>
#include <array>
#include <numeric>

#include "meshing/core/error.h"
#include "meshing/core/random.h"
#include "synthesis/appearance_tree.h"

namespace shellgrid {
namespace {

// By looking at every texel. Components are small integers, so that distances are exact and often equal.
std::vector<std::int32_t> exhaustive(const RowMatrixf& appearance, int width, int height, int k, int separation) {
  std::vector<std::int32_t> result;
  for (int t = 0; t < width * height; ++t) {
    std::vector<int> taken{t};
    for (int i = 0; i < k; ++i) {
      int best = -1;
      float least = 1e30f;
      for (int u = 0; u < width * height; ++u) {
        bool allowed = true;
        for (int v : taken) {
          const int ax = std::abs(u % width - v % width), ay = std::abs(u / width - v / width);
          const int dx = std::min(ax, width - ax), dy = std::min(ay, height - ay);
          if (dx * dx + dy * dy < separation * separation) allowed = false;
        }
        const float distance = (appearance.row(u) - appearance.row(t)).squaredNorm();
        if (allowed && distance < least) best = u, least = distance;
      }
      result.push_back(best);
      if (best >= 0) taken.push_back(best);
    }
  }
  return result;
}

RowMatrixf appearance(int count, int values, std::uint64_t seed) {
  RowMatrixf rows(count, 8);
  RandomStream random(seed, 0);
  for (Eigen::Index i = 0; i < rows.size(); ++i)
    rows.data()[i] = static_cast<float>(static_cast<int>(random.next() * values));
  return rows;
}

std::vector<std::int32_t> find_candidates(const RowMatrixf& rows, int width, int height, int k, int separation) {
  return shellgrid::find_candidates(rows, SampleLayers::make({{width, height}}, 1), {0}, {0}, k, separation);
}

TEST(CandidateSearch, EqualsExhaustionAlsoWhereManyLookAlike) {
  for (int values : {1, 2, 5, 100})
    for (int separation : {1, 3, 6}) {
      const RowMatrixf rows = appearance(37 * 23, values, static_cast<std::uint64_t>(values + separation));
      ASSERT_EQ(find_candidates(rows, 37, 23, 4, separation), exhaustive(rows, 37, 23, 4, separation))
          << values << " values, separation " << separation;
    }
}

// The nearest few as a sorted list has them; with a share of 1/4, points at most four times as far (squared).
TEST(CandidateSearch, FindsTheNearestFewOrNearOnes) {
  const RowMatrixf rows = appearance(3000, 1000, 5), queries = appearance(40, 1000, 6);
  std::vector<std::int32_t> all(3000);
  std::iota(all.begin(), all.end(), 0);
  const AppearanceTree tree(rows, all);
  const auto even = [](std::int32_t t) { return t % 2 == 0; };
  int missed = 0;
  for (int q = 0; q < queries.rows(); ++q) {
    const AppearanceTree::Point query = queries.row(q).transpose().array();
    const auto distance = [&](std::int32_t t) { return (rows.row(t).transpose().array() - query).square().sum(); };
    std::vector<float> sorted;
    for (int t = 0; t < 3000; t += 2) sorted.push_back(distance(t));
    std::sort(sorted.begin(), sorted.end());
    std::array<std::int32_t, AppearanceTree::few> found;
    for (const float share : {1.0f, 0.25f}) {
      ASSERT_EQ(tree.nearest_few(query, even, 1e9f, 8, share, found.data()), 8);
      for (int i = 0; i < 8; ++i) {
        EXPECT_EQ(found[i] % 2, 0);
        EXPECT_LE(distance(found[i]), sorted[i] / share * 1.0001f);
        if (share < 1) missed += distance(found[i]) > sorted[i];
      }
    }
    // What lies beyond the bound is not told.
    EXPECT_EQ(tree.nearest_few(query, even, 0.5f * (sorted[2] + sorted[3]), 8, 1.0f, found.data()), 3);
  }
  EXPECT_GT(missed, 0);
}

TEST(CandidateSearch, SaysWhereNoTexelIsLeft) {
  const RowMatrixf rows = appearance(12 * 12, 9, 3);
  const std::vector<std::int32_t> found = find_candidates(rows, 12, 12, 8, 6);
  EXPECT_EQ(found, exhaustive(rows, 12, 12, 8, 6));
  EXPECT_EQ(found.back(), -1);
}

TEST(CandidateSearch, SameAtAnyThreadCount) {
  const RowMatrixf rows = appearance(64 * 64, 7, 4);
  const auto many = find_candidates(rows, 64, 64, 3, 5);
  const oneapi::tbb::global_control one(oneapi::tbb::global_control::max_allowed_parallelism, 1);
  EXPECT_EQ(find_candidates(rows, 64, 64, 3, 5), many);
}

TEST(CandidateSearch, RefusesAWrongShape) {
  EXPECT_THROW(find_candidates(appearance(10, 3, 1), 4, 4, 1, 1), InternalError);
}

}  // namespace
}  // namespace shellgrid
