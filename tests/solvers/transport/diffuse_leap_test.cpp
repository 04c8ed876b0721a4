// SPDX-License-Identifier: AGPL-3.0-or-later
#include "solvers/transport/diffuse_leap.h"

#include <gtest/gtest.h>

#include <cmath>

#include "solvers/transport/phase.h"

namespace shellgrid {
namespace {

// Isotropic scattering: (α/y) artanh y = 1.
TEST(DiffuseLeap, DecayIsTransportsOwn) {
  for (const double albedo : {0.92, 0.99, 0.9999, 1 - 1e-8}) {
    const double y = DiffuseLeap(3, albedo, 0).decay() / 3;
    EXPECT_NEAR(albedo / y * std::atanh(y), 1, 1e-9);
  }
  EXPECT_EQ(DiffuseLeap(3, 1, 0.3).decay(), 0);
  // √(3 (1 − α) (1 − αg)) as the albedo nears one.
  EXPECT_NEAR(DiffuseLeap(1, 1 - 1e-9, 0.9).decay() / std::sqrt(3e-9 * 0.1), 1, 1e-6);
}

TEST(DiffuseLeap, OnlyWhereTheRestHasDied) {
  EXPECT_FALSE(DiffuseLeap(1, 0.5, 0).possible());
  EXPECT_FALSE(DiffuseLeap(0, 1, 0).possible());
  EXPECT_FALSE(DiffuseLeap(1, 1, -0.9).possible());
  const DiffuseLeap leap(2, 1, 0.9);
  EXPECT_EQ(leap.radius(20 / 0.2), 0);
  EXPECT_NEAR(leap.radius(40 / 0.2), 26 / 0.2, 1e-9);
}

TEST(DiffuseLeap, LossesAndLengthsFitTogether) {
  const DiffuseLeap white(2, 1, 0.5), nearly(2, 1 - 1e-13, 0.5), grey(2, 0.999, 0.5);
  EXPECT_EQ(white.loss(100), 0);
  EXPECT_NEAR(nearly.length(100) / white.length(100), 1, 1e-3);  // 1 − albedo itself is known to so many digits
  for (const double r : {1.0, 1.8, 1.9, 20.0}) {
    const double x = grey.decay() * r;
    EXPECT_NEAR(grey.loss(r) / (1 - x / std::sinh(x)), 1, 1e-9);
  }
  EXPECT_EQ(grey.loss(1e9), 1);
}

// The mean of the places' distance: ∫ r² sinh(κ(R − r)) / ∫ r sinh(κ(R − r)); R/2 of white matter.
TEST(DiffuseLeap, PlacesAreWhereLightPasses) {
  for (const double absorbed : {0.0, 1e-3}) {
    const DiffuseLeap leap(1, 1 - absorbed, 0);
    PathRandom random(5, 1);
    double sum = 0, above = 0, below = 0;
    constexpr int count = 200000, steps = 2000;
    for (int k = 0; k < count; ++k) sum += leap.place(60, random);
    for (int k = 0; k < steps; ++k) {
      const double r = 60 * (k + 0.5) / steps, y = leap.decay() * (60 - r),
                   passing = r * (y > 0 ? std::sinh(y) : 60 - r);
      above += r * passing;
      below += passing;
    }
    EXPECT_NEAR(sum / count, above / below, 4 * 15 / std::sqrt(count));
  }
}

// Those that the even part scattered have every cosine alike, and are as many as it is large.
TEST(DiffuseLeap, EvenPartOfThePhaseFunction) {
  for (const double g : {-0.6, 0.0, 0.8}) {
    PathRandom random(6, 2);
    double evenly = 0, cosine_sum = 0, square_sum = 0;
    constexpr int count = 400000;
    for (int k = 0; k < count; ++k) {
      const double cosine = henyey_greenstein_cosine(g, random.next());
      if (!scattered_evenly(g, cosine, random)) continue;
      ++evenly;
      cosine_sum += cosine;
      square_sum += cosine * cosine;
    }
    const double share = (1 - std::abs(g)) / std::pow(1 + std::abs(g), 2);
    EXPECT_NEAR(evenly / count, share, 4 * std::sqrt(share / count));
    EXPECT_NEAR(cosine_sum / evenly, 0, 4 * 0.58 / std::sqrt(evenly));
    EXPECT_NEAR(square_sum / evenly, 1.0 / 3, 4 * 0.3 / std::sqrt(evenly));
  }
}

}  // namespace
}  // namespace shellgrid
