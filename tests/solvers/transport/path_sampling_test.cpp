// SPDX-License-Identifier: AGPL-3.0-or-later
#include <gtest/gtest.h>

#include <Eigen/Geometry>
#include <cmath>
#include <numbers>

#include "solvers/scattering/fresnel.h"
#include "solvers/transport/dielectric.h"
#include "solvers/transport/path_random.h"
#include "solvers/transport/phase.h"
#include "solvers/transport/roulette.h"
#include "tests/support/chi_square.h"

namespace shellgrid {
namespace {

constexpr int samples = 200000;

TEST(PathRandom, LogarithmAndTurnAreExactToABillionth) {
  for (int k = 0; k < 20000; ++k) {
    const double u = std::pow(10.0, -16.0 * k / 20000);
    EXPECT_NEAR(negative_log(u), -std::log(u), 1e-9 * -std::log(u));
    const double v = k / 20000.0;
    EXPECT_NEAR(turn(v).cosine, std::cos(2 * std::numbers::pi * v), 4e-9);
    EXPECT_NEAR(turn(v).sine, std::sin(2 * std::numbers::pi * v), 4e-9);
  }
  EXPECT_EQ(negative_log(1), 0);
}

TEST(PathRandom, PathsDifferAndComeBack) {
  PathRandom a(7, 0), again(7, 0), b(7, 1), other(8, 0);
  for (int k = 0; k < 100; ++k) {
    const std::uint64_t bits = a.next_bits();
    EXPECT_EQ(bits, again.next_bits());
    EXPECT_NE(bits, b.next_bits());
    EXPECT_NE(bits, other.next_bits());
  }
}

// Fifty bins of free paths, and pairs of successive ones: flights follow one another.
TEST(PathRandom, FreePathsFollowTheirDensity) {
  std::vector<double> counts(50), expected(50), pairs(100, 0.0), even(100, samples / 100.0);
  const auto below = [](double t) { return 1 - std::exp(-t); };
  for (int k = 0; k < 50; ++k)
    expected[k] = samples * (k == 49 ? 1 - below(4.9) : below(0.1 * (k + 1)) - below(0.1 * k));
  for (int path = 0; path < samples; ++path) {
    PathRandom random(1, path);
    const double t = random.exponential(), next = random.exponential();
    ++counts[std::min(49, static_cast<int>(t / 0.1))];
    const auto tenth = [&](double x) { return std::min(9, static_cast<int>(10 * below(x))); };
    ++pairs[10 * tenth(t) + tenth(next)];
  }
  EXPECT_LT(std::abs(test::chi_square_deviate(counts, expected)), 4);
  EXPECT_LT(std::abs(test::chi_square_deviate(pairs, even)), 4);
}

// The share below a cosine, from the density alone.
std::vector<double> bins_of_density(double g, int bins) {
  std::vector<double> shares;
  for (int k = 0; k < bins; ++k) {
    constexpr int steps = 2000;
    double sum = 0;
    for (int s = 0; s < steps; ++s) sum += henyey_greenstein(g, -1 + 2 * (k + (s + 0.5) / steps) / bins);
    shares.push_back(sum * 2 / bins / steps);
  }
  return shares;
}

TEST(HenyeyGreenstein, IsNormalisedWithItsMeanCosine) {
  for (const double g : {-0.95, -0.5, -1e-4, 0.0, 1e-7, 0.3, 0.75, 0.95}) {
    constexpr int steps = 400000;
    double total = 0, mean = 0;
    for (int s = 0; s < steps; ++s) {
      const double cosine = -1 + 2 * (s + 0.5) / steps;
      total += henyey_greenstein(g, cosine) * 2 / steps;
      mean += cosine * henyey_greenstein(g, cosine) * 2 / steps;
    }
    EXPECT_NEAR(total, 1, 1e-6) << g;
    EXPECT_NEAR(mean, g, 1e-6) << g;
  }
}

TEST(HenyeyGreenstein, SamplesFollowTheDensityAboutAnyAxis) {
  PathRandom axes(3, 0);
  for (const double g : {-0.9, -0.3, -2e-6, 0.0, 0.5, 0.9, 0.99}) {
    std::vector<double> counts(64), expected, turns(32, 0.0), even(32, samples / 32.0);
    for (const double share : bins_of_density(g, 64)) expected.push_back(samples * share);
    const Vec3 axis = even_direction(axes);
    const Vec3 across = axis.unitOrthogonal(), up = axis.cross(across);
    for (int path = 0; path < samples; ++path) {
      PathRandom random(2, path);
      const Vec3 d = scattered(axis, g, random);
      ASSERT_NEAR(d.norm(), 1, 1e-8);
      ++counts[std::min(63, static_cast<int>(32 * (1 + d.dot(axis))))];
      const double angle = std::atan2(d.dot(across), d.dot(up)) / (2 * std::numbers::pi);
      ++turns[std::clamp(static_cast<int>(32 * (angle + 0.5)), 0, 31)];
    }
    EXPECT_LT(std::abs(test::chi_square_deviate(counts, expected)), 4) << g;
    EXPECT_LT(std::abs(test::chi_square_deviate(turns, even)), 4) << g;
  }
}

TEST(HenyeyGreenstein, DirectionsStayUnitAfterAMillionScatterings) {
  PathRandom random(5, 0);
  Vec3 d(0, 0, -1);
  for (int k = 0; k < 1000000; ++k) d = scattered(d, 0.9, random);
  EXPECT_NEAR(d.norm(), 1, 1e-8);
}

TEST(Dielectric, MeetsTheBoundaryAsTheFresnelEquationsSay) {
  for (const double ior : {0.4, 1 / 1.5, 1.0, 1.3, 2.5})
    for (int k = 0; k <= 100; ++k) {
      const double cosine = k / 100.0;
      const BoundaryMeeting meeting = meet_boundary(cosine, ior);
      if (ior == 1) {
        EXPECT_EQ(meeting.reflectance, 0);
        continue;
      }
      EXPECT_NEAR(meeting.reflectance, fresnel_reflectance(cosine, ior), 1e-15);
      if (meeting.reflectance >= 1) continue;
      const Vec3 normal(0, 0, 1), in(std::sqrt(1 - cosine * cosine), 0, -cosine);
      const Vec3 out = refracted(in, normal, cosine, meeting.cosine_beyond, ior);
      EXPECT_NEAR(out.norm(), 1, 1e-15);
      EXPECT_NEAR(in.x(), ior * out.x(), 1e-12);  // Snell
      EXPECT_LT(out.z(), 0);
      EXPECT_NEAR((mirrored(in, normal, cosine) - Vec3(in.x(), 0, -in.z())).norm(), 0, 1e-15);
      // The same boundary from its other side.
      EXPECT_NEAR(meet_boundary(meeting.cosine_beyond, 1 / ior).reflectance, meeting.reflectance, 1e-12);
    }
}

TEST(Roulette, IsFairToTheFaintAndTheLong) {
  double weight_sum = 0, long_sum = 0;
  constexpr int paths = 200000;
  for (int path = 0; path < paths; ++path) {
    PathRandom random(9, path);
    double weight = 0.03;
    if (survives_faintness(weight, random)) weight_sum += weight;
    double worth = 1;
    std::uint64_t next = event_limit;
    for (int turn = 0; turn < 3 && worth > 0; ++turn)
      worth = meet_event_limit(next, next, random) == LimitOutcome::goes_on ? worth * limit_weight : 0;
    long_sum += worth;
  }
  EXPECT_NEAR(weight_sum / paths, 0.03, 4 * std::sqrt(0.03 * 0.5 / paths));
  EXPECT_NEAR(long_sum / paths, 1, 4 * std::sqrt(7.0 / paths));
}

TEST(Roulette, EndsEveryPath) {
  PathRandom random(9, 0);
  std::uint64_t next = event_limit;
  EXPECT_EQ(meet_event_limit(most_events, next, random), LimitOutcome::cut_off);
}

}  // namespace
}  // namespace shellgrid
