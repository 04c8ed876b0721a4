// SPDX-License-Identifier: AGPL-3.0-or-later
#include "solvers/dipole/dual_tree.h"

#include <gtest/gtest.h>

#include <cmath>
#include <limits>
#include <numbers>

#include "meshing/core/error.h"
#include "meshing/core/random.h"
#include "solvers/dipole/dipole.h"

namespace shellgrid {
namespace {

enum class Cloud { sphere, plane, volume, line, clustered };

std::vector<Vec3f> cloud(Cloud kind, int count) {
  RandomStream random(5, static_cast<std::uint64_t>(kind));
  std::vector<Vec3f> points;
  for (int i = 0; i < count; ++i) {
    const double a = random.next(), b = random.next(), c = random.next();
    Vec3 p = Vec3::Zero();
    switch (kind) {
      case Cloud::sphere: {
        const double z = 2 * a - 1, angle = 2 * std::numbers::pi * b, r = std::sqrt(1 - z * z);
        p = 20 * Vec3(r * std::cos(angle), r * std::sin(angle), z);
        break;
      }
      case Cloud::plane:
        p = Vec3(40 * a, 40 * b, 3);
        break;
      case Cloud::volume:
        p = 30 * Vec3(a, b, c);
        break;
      case Cloud::line:
        p = Vec3(60 * a, 0, 0);
        break;
      case Cloud::clustered:
        p = Vec3(40 * std::pow(a, 8), 40 * std::pow(b, 8), 40 * std::pow(c, 8));
        break;
    }
    points.push_back(p.cast<float>());
  }
  return points;
}

std::array<Dipole, 3> channels_of(double absorption) {
  return {Dipole(absorption, 1.5, 1.3), Dipole(absorption * 4, 1.1, 1.3), Dipole(absorption * 0.1, 2.1, 1.3)};
}

double greatest_error(const std::vector<Rgb>& sums, const std::vector<Rgb>& exact, double range) {
  double greatest = 0, error = 0;
  for (const Rgb& e : exact) greatest = std::max(greatest, static_cast<double>(e.maxCoeff()));
  for (std::size_t i = 0; i < sums.size(); ++i)
    for (int c = 0; c < 3; ++c) {
      const double e = static_cast<double>(exact[i][c]);
      if (e > greatest / range) error = std::max(error, std::abs(static_cast<double>(sums[i][c]) / e - 1));
    }
  return error;
}

// Far beyond the dynamic range of the sums too.
TEST(DualTree, SumsAreNeverNegative) {
  const RadialProfile profile = dipole_profile(channels_of(0.1));
  for (const Cloud kind : {Cloud::sphere, Cloud::plane, Cloud::line}) {
    const std::vector<Vec3f> points = cloud(kind, 6000);
    std::vector<Rgb> powers;
    for (const Vec3f& p : points) powers.push_back(p.x() < -12 || p.x() > 32 ? Rgb::Ones() : Rgb::Zero());
    for (const Rgb& sum : dual_tree_sums(points, points, powers, profile, {})) ASSERT_GE(sum.minCoeff(), 0);
  }
}

class DualTreeClouds : public testing::TestWithParam<Cloud> {};

// Lit from one side, so that the other one lives on what comes far: each sum, bright or dim, within the tolerance.
TEST_P(DualTreeClouds, SumsWithinTheTolerance) {
  const std::vector<Vec3f> points = cloud(GetParam(), 3000);
  std::vector<Rgb> powers;
  for (const Vec3f& p : points) powers.push_back(p.x() + p.y() > 16 ? Rgb(1, 0.5f, 0.2f) : Rgb::Zero());
  for (const double absorption : {0.0, 0.004, 0.3}) {
    const RadialProfile profile = dipole_profile(channels_of(absorption));
    DualTreeOptions check;
    check.brute_force = true;
    const std::vector<Rgb> exact = dual_tree_sums(points, points, powers, profile, check);
    for (const double tolerance : {0.1, 0.01, 0.001}) {
      DualTreeOptions options;
      options.tolerance = tolerance;
      DualTreeStatistics statistics;
      const std::vector<Rgb> sums = dual_tree_sums(points, points, powers, profile, options, &statistics);
      EXPECT_LE(greatest_error(sums, exact, 1e6), tolerance) << absorption;
      EXPECT_LE(statistics.evaluations, 3000LL * 3000) << absorption << " " << tolerance;
    }
  }
}

INSTANTIATE_TEST_SUITE_P(Clouds, DualTreeClouds,
                         testing::Values(Cloud::sphere, Cloud::plane, Cloud::volume, Cloud::line, Cloud::clustered));

TEST(DualTree, TakesTargetsElsewhereThanSources) {
  const std::vector<Vec3f> sources = cloud(Cloud::sphere, 2000), targets = cloud(Cloud::volume, 900);
  const std::vector<Rgb> powers(sources.size(), Rgb(1, 2, 3));
  const RadialProfile profile = dipole_profile(channels_of(0.02));
  DualTreeOptions check;
  check.brute_force = true;
  const auto exact = dual_tree_sums(targets, sources, powers, profile, check);
  EXPECT_LE(greatest_error(dual_tree_sums(targets, sources, powers, profile), exact, 1e6), 0.01);
}

TEST(DualTree, GrowsInsteadOfSquaring) {
  const RadialProfile profile = dipole_profile(channels_of(0.004));
  std::int64_t evaluations[2];
  for (int i = 0; i < 2; ++i) {
    const std::vector<Vec3f> points = cloud(Cloud::sphere, 20000 << (2 * i));
    const std::vector<Rgb> powers(points.size(), Rgb::Ones());
    DualTreeStatistics statistics;
    dual_tree_sums(points, points, powers, profile, {}, &statistics);
    evaluations[i] = statistics.evaluations;
  }
  EXPECT_LT(evaluations[1], 5 * evaluations[0]);
  EXPECT_LT(evaluations[1], 80000LL * 80000 / 8);
}

TEST(DualTree, SumsFewAndEqualPoints) {
  const RadialProfile profile = dipole_profile(channels_of(0.1));
  EXPECT_TRUE(dual_tree_sums({}, {}, {}, profile).empty());
  const std::vector<Vec3f> one = {Vec3f(1, 2, 3)};
  EXPECT_NEAR(dual_tree_sums(one, one, {Rgb(2, 0, 0)}, profile)[0][0], 2 * profile.at(0)[0], 1e-6);
  const std::vector<Vec3f> same(500, Vec3f(1, 2, 3));
  const auto sums = dual_tree_sums(same, same, std::vector<Rgb>(500, Rgb::Ones()), profile);
  for (const Rgb& sum : sums) EXPECT_NEAR(sum[1] / (500 * profile.at(0)[1]), 1, 1e-4);
  const auto dark = dual_tree_sums(same, one, {Rgb::Zero()}, profile);
  for (const Rgb& sum : dark) EXPECT_TRUE((sum == 0).all());
}

TEST(DualTree, RefusesPowersThatAreNone) {
  const RadialProfile profile = dipole_profile(channels_of(0.1));
  const std::vector<Vec3f> one = {Vec3f::Zero()};
  EXPECT_THROW(dual_tree_sums(one, one, {Rgb(-1, 0, 0)}, profile), InputError);
  EXPECT_THROW(dual_tree_sums(one, one, {Rgb(NAN, 0, 0)}, profile), InputError);
  EXPECT_THROW(dual_tree_sums(one, one, {}, profile), InputError);
  EXPECT_THROW(dual_tree_sums({Vec3f(INFINITY, 0, 0)}, one, {Rgb::Ones()}, profile), InputError);
}

}  // namespace
}  // namespace shellgrid
