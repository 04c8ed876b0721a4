// SPDX-License-Identifier: AGPL-3.0-or-later
#include <gtest/gtest.h>
#include <oneapi/tbb/global_control.h>

#include <atomic>
#include <cmath>

#include "solvers/transport/path_campaign.h"
#include "solvers/transport/path_random.h"

namespace shellgrid {
namespace {

// Adds an exponential variate, and puts another into a field.
PathKind exponentials(std::atomic<int>* followed = nullptr) {
  PathKind kind;
  kind.scalars = 2;
  kind.field_size = 10;
  kind.follow = [followed](std::uint64_t path, ChunkTally& tally) {
    PathRandom random(3, path);
    tally.add(0, random.exponential());
    tally.add(1, 0.25);
    tally.add(1, 0.75);
    const auto place = static_cast<std::uint32_t>(10 * random.next());
    tally.add_to_field(place, Eigen::Array3d(1, random.next(), 0));
    tally.add_to_field(place, Eigen::Array3d(1, 0, 0));
    tally.note(PathEvent::collisions);
    if (followed) ++*followed;
  };
  kind.relative_error = [](const PathState& state) {
    const Estimate e = state.scalar(0);
    return std::optional<double>(e.standard_error / e.value);
  };
  return kind;
}

PathState followed(double paths) {
  const PathKind kind = exponentials();
  PathState state(kind.scalars, kind.field_size);
  PathLimits limits;
  limits.paths = paths;
  EXPECT_EQ(follow_paths(kind, limits, state), PathEnd::paths);
  return state;
}

void expect_same_bits(const PathState& a, const PathState& b) {
  EXPECT_EQ(a.paths, b.paths);
  EXPECT_EQ(a.sum, b.sum);
  EXPECT_EQ(a.square, b.square);
  EXPECT_EQ(a.field_sum, b.field_sum);
  EXPECT_EQ(a.field_square, b.field_square);
  EXPECT_EQ(a.events, b.events);
}

TEST(PathCampaign, MeansComeWithTheirStandardError) {
  const PathState state = followed(100000);
  const Estimate e = state.scalar(0);
  EXPECT_NEAR(e.standard_error, 1 / std::sqrt(1e5), 2e-2 / std::sqrt(1e5));
  EXPECT_NEAR(e.value, 1, 4 * e.standard_error);
  EXPECT_EQ(state.scalar(1).value, 1);
  EXPECT_EQ(state.scalar(1).standard_error, 0);
  double paths = 0, squares = 0;
  for (int place = 0; place < 10; ++place)
    paths += state.field_sum[3 * place], squares += state.field_square[3 * place];
  EXPECT_EQ(paths, 2e5);
  EXPECT_EQ(squares, 4e5);  // of whole paths: (1 + 1)²
  EXPECT_EQ(state.count(PathEvent::collisions), 100000u);
}

TEST(PathCampaign, SameBitsAtAnyThreadCountAndHoweverOftenInterrupted) {
  const PathState whole = followed(50000);
  {
    const oneapi::tbb::global_control one(oneapi::tbb::global_control::max_allowed_parallelism, 1);
    expect_same_bits(followed(50000), whole);
  }
  const PathKind kind = exponentials();
  PathState state(kind.scalars, kind.field_size);
  PathLimits limits;
  for (const double paths : {1.0, 300.0, 17000.0, 17001.0, 50000.0}) {
    limits.paths = paths;
    EXPECT_EQ(follow_paths(kind, limits, state), PathEnd::paths);
  }
  expect_same_bits(state, whole);
}

TEST(PathCampaign, AnInterruptionLeavesWholePathsToGoOnFrom) {
  std::atomic<int> count{0};
  const PathKind kind = exponentials(&count);
  PathState state(kind.scalars, kind.field_size);
  PathLimits limits;
  limits.paths = 1e9;
  limits.interrupted = [&] { return count > 30000; };
  EXPECT_EQ(follow_paths(kind, limits, state), PathEnd::interrupted);
  EXPECT_GT(state.paths, 10000u);
  EXPECT_LT(state.paths, 60000u);
  expect_same_bits(state, followed(static_cast<double>(state.paths)));
}

TEST(PathCampaign, StopsAtATargetErrorAndAtATime) {
  const PathKind kind = exponentials();
  PathLimits limits;
  limits.paths = 0;
  limits.target_error = 0.002;
  PathState state(kind.scalars, kind.field_size);
  EXPECT_EQ(follow_paths(kind, limits, state), PathEnd::target_error);
  EXPECT_LE(kind.relative_error(state).value(), 0.002);
  EXPECT_NEAR(static_cast<double>(state.paths), 250000, 0.15 * 250000);
  // An interrupted run stops at the same path.
  PathState parts(kind.scalars, kind.field_size);
  PathLimits part;
  part.paths = 99999;
  follow_paths(kind, part, parts);
  EXPECT_EQ(follow_paths(kind, limits, parts), PathEnd::target_error);
  expect_same_bits(parts, state);
  // What has met its target before is left as it is, also where it was followed for other reasons.
  std::atomic<int> more = 0;
  EXPECT_EQ(follow_paths(exponentials(&more), limits, state), PathEnd::target_error);
  part.paths = 400001;
  follow_paths(kind, part, parts);
  EXPECT_EQ(follow_paths(exponentials(&more), limits, parts), PathEnd::target_error);
  EXPECT_EQ(more, 0);
  PathLimits time;
  time.paths = 0;
  time.seconds = 0.05;
  EXPECT_EQ(follow_paths(kind, time, state), PathEnd::seconds);
}

// Each path brings the same: its error is known to be none, which is not the same as nothing found.
TEST(PathCampaign, WhatNeverVariesMeetsAnyTarget) {
  PathKind kind = exponentials();
  kind.relative_error = [](const PathState& state) {
    const Estimate e = state.scalar(1);
    return std::optional<double>(e.standard_error / e.value);
  };
  PathState state(kind.scalars, kind.field_size);
  PathLimits limits;
  limits.paths = 0;
  limits.target_error = 1e-9;
  EXPECT_EQ(follow_paths(kind, limits, state), PathEnd::target_error);
  EXPECT_LT(state.paths, 50000u);
}

TEST(PathCampaign, ErrorsFallWithTheSquareRootOfTheNumberOfPaths) {
  // Root mean square over 64 independent runs, at n and 16 n.
  double errors[2] = {0, 0};
  for (int run = 0; run < 64; ++run) {
    double sum = 0;
    int n = 0;
    for (int k = 0; k < 2; ++k) {
      for (; n < (k == 0 ? 1000 : 16000); ++n) sum += PathRandom(run, n).exponential();
      errors[k] += (sum / n - 1) * (sum / n - 1) / 64;
    }
  }
  EXPECT_NEAR(std::sqrt(errors[0] / errors[1]), 4, 1.2);
}

}  // namespace
}  // namespace shellgrid
