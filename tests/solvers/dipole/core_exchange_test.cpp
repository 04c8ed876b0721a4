// SPDX-License-Identifier: AGPL-3.0-or-later
#include "solvers/dipole/core_exchange.h"

#include <gtest/gtest.h>

#include <cmath>
#include <numbers>

#include "meshing/core/error.h"
#include "solvers/dipole/dipole.h"

namespace shellgrid {
namespace {

// A sphere of evenly spread points, evenly lit: W a point.
CoreSurface sphere(int count, float radius) {
  CoreSurface surface;
  for (int i = 0; i < count; ++i) {
    const double z = 1 - 2 * (i + 0.5) / count, angle = i * 2.399963229728653, r = std::sqrt(1 - z * z);
    surface.points.push_back(radius * Vec3f(Vec3(r * std::cos(angle), r * std::sin(angle), z).cast<float>()));
  }
  const auto area = static_cast<float>(4 * std::numbers::pi * radius * radius / count);
  surface.areas.assign(count, area);
  surface.power.assign(count, Rgb(1, 0.5f, 2) * area);
  return surface;
}

std::array<Dipole, 3> of(double absorption) {
  std::array<Dipole, 3> channels;
  channels.fill(Dipole(absorption, 1.5, 1, DipoleEntry::diffuse));
  return channels;
}

// Within a chord r of a point of a sphere lies π r² of it: the plane's integral, cut off at the diameter.
double returned_by_sphere(const Dipole& d, double radius) {
  double sum = 0;
  const int steps = 200000;
  for (int i = 0; i < steps; ++i) {
    const double r = (i + 0.5) * 2 * radius / steps;
    sum += 2 * std::numbers::pi * r * d.reflectance(r) * 2 * radius / steps;
  }
  return sum;
}

TEST(CoreExchange, SumsTheProfileOverTheCore) {
  const CoreSurface surface = sphere(20000, 15);
  const auto channels = of(0.01);
  const CoreExchange exchange = exchange_core_light(surface, dipole_profile(channels));
  const double expected = returned_by_sphere(channels[0], 15);
  for (std::size_t i = 0; i < surface.points.size(); i += 371) {
    EXPECT_NEAR(exchange.exitance[i][0] / expected, 1, 0.01);
    EXPECT_NEAR(exchange.exitance[i][2] / (2 * expected), 1, 0.01);
  }
  EXPECT_EQ(exchange.bounces, 0);
}

// Lit from one side: what goes to and fro may be summed over fewer points.
TEST(CoreExchange, BouncesOverFewerPoints) {
  const auto lit = [](CoreSurface surface) {
    for (std::size_t i = 0; i < surface.points.size(); ++i) {
      surface.power[i] *= std::max(0.0f, surface.points[i].z() / 15);
      surface.shell_reflection.push_back(Rgb(0.2f, 0.5f, 0.8f));
    }
    return surface;
  };
  const CoreSurface surface = lit(sphere(8000, 15));
  const auto channels = of(0.02);
  const RadialProfile profile =
      dipole_profile(channels, std::sqrt(static_cast<double>(surface.areas[0]) / std::numbers::pi));
  CoarserCore coarser{lit(sphere(1000, 15)), nullptr, nullptr};
  const RadialProfile coarse_profile =
      dipole_profile(channels, std::sqrt(static_cast<double>(coarser.surface.areas[0]) / std::numbers::pi));
  coarser.profile = &coarse_profile;
  coarser.at_points = [&](const std::vector<Rgb>& values) {
    std::vector<Rgb> result;
    for (const Vec3f& point : surface.points) {
      Rgb sum = Rgb::Zero();
      float weights = 0;
      for (std::size_t k = 0; k < values.size(); ++k) {
        const float weight = std::max(0.0f, 1 - (coarser.surface.points[k] - point).norm() / 2);
        sum += weight * values[k];
        weights += weight;
      }
      result.push_back(sum / weights);
    }
    return result;
  };
  CoreExchangeOptions options;
  const CoreExchange whole = exchange_core_light(surface, profile, options);
  options.coarser = &coarser;
  const CoreExchange parted = exchange_core_light(surface, profile, options);
  EXPECT_GT(parted.bounces, 2);
  EXPECT_LT(parted.evaluations, whole.evaluations / 2);
  double wrong = 0, missing = 0, all = 0;
  for (std::size_t i = 0; i < surface.points.size(); ++i) {
    wrong += static_cast<double>((parted.exitance[i] - whole.exitance[i]).square().sum());
    missing += static_cast<double>((whole.first[i] - whole.exitance[i]).square().sum());
    all += static_cast<double>(whole.exitance[i].square().sum());
  }
  EXPECT_LT(std::sqrt(wrong / all), 0.02);
  EXPECT_GT(std::sqrt(missing / all), 0.1);  // of bounces that are there
}

TEST(CoreExchange, FollowsBouncesToTheirSum) {
  CoreSurface surface = sphere(6000, 15);
  surface.shell_reflection.assign(surface.points.size(), Rgb(0.2f, 0.6f, 0.9f));
  const auto channels = of(0.02);
  // Points farther apart than the profile is wide stand for discs of light.
  const double once = returned_by_sphere(channels[0], 15);
  const CoreExchange exchange = exchange_core_light(surface, dipole_profile(channels, 0.39));
  const double lit[3] = {1, 0.5, 2}, reflection[3] = {0.2, 0.6, 0.9};
  for (int c = 0; c < 3; ++c) {
    const double expected = lit[c] * once / (1 - once * reflection[c]);
    EXPECT_NEAR(exchange.exitance[100][c] / expected, 1, 0.015) << c;
    EXPECT_NEAR(exchange.power[100][c] / (surface.areas[100] * expected / once), 1, 0.015) << c;
  }
  EXPECT_GT(exchange.bounces, 1);
}

// White matter returns all light from a closed core, however small, and from two sheets that nearly touch.
TEST(CoreExchange, ReturnsAsMuchAsComes) {
  CoreSurface small = sphere(3000, 3);
  CoreSurface sheets;
  for (int i = 0; i < 60; ++i)
    for (int j = 0; j < 60; ++j)
      for (int k = 0; k < 2; ++k) {
        sheets.points.emplace_back(0.5f * static_cast<float>(i), 0.5f * static_cast<float>(j),
                                   0.2f * static_cast<float>(k));
        sheets.areas.push_back(0.25f);
        sheets.power.emplace_back(Rgb::Constant(0.25f));
      }
  for (const CoreSurface* surface : {&small, &sheets}) {
    CoreExchangeOptions options;
    options.returned = {1, 1, 1};
    const CoreExchange exchange = exchange_core_light(*surface, dipole_profile(of(0)), options);
    double in = 0, out = 0;
    for (std::size_t i = 0; i < surface->points.size(); ++i) {
      in += static_cast<double>(surface->power[i][1]);
      out += static_cast<double>(exchange.exitance[i][1]) * static_cast<double>(surface->areas[i]);
    }
    EXPECT_NEAR(out / in, 1, 0.01);
  }
  CoreExchangeOptions options;
  options.returned = {1, 1, 1};
  EXPECT_GT(exchange_core_light(sheets, dipole_profile(of(0)), options).greatest_return, 1.5);
}

// Lit from one side, through a shell that reflects unevenly: against bounces over all pairs, one by one to the end,
// each point within the tolerance, down to a millionth of the brightest.
TEST(CoreExchange, KeepsToItsToleranceBrightAndDim) {
  CoreSurface surface = sphere(2000, 12);
  surface.shell_reflection.resize(surface.points.size());
  for (std::size_t i = 0; i < surface.points.size(); ++i) {
    const float z = surface.points[i].z() / 12;
    surface.power[i] *= std::max(0.0f, z - 0.3f);
    surface.shell_reflection[i] = Rgb(0.5f, 0.3f, 0.6f) * (0.75f + 0.25f * std::sin(9 * z));
  }
  for (const double absorption : {0.003, 0.05, 0.4}) {
    const RadialProfile profile = dipole_profile(of(absorption), 0.54);
    CoreExchangeOptions options;
    options.sums.tolerance = 0.02;
    DualTreeOptions all_pairs;
    all_pairs.brute_force = true;
    DualTree exact(surface.points, surface.points, profile, all_pairs);
    std::vector<Rgb> expected(surface.points.size(), Rgb::Zero()), coming = surface.power;
    for (int bounce = 0; bounce < 60; ++bounce) {
      const std::vector<Rgb> leaving = exact.sums(coming, 0.02);
      for (std::size_t i = 0; i < coming.size(); ++i) {
        expected[i] += leaving[i];
        coming[i] = surface.shell_reflection[i] * surface.areas[i] * leaving[i];
      }
    }
    const CoreExchange exchange = exchange_core_light(surface, profile, options);
    double greatest = 0, error = 0;
    for (const Rgb& e : expected) greatest = std::max(greatest, static_cast<double>(e.maxCoeff()));
    for (std::size_t i = 0; i < expected.size(); ++i)
      for (int c = 0; c < 3; ++c)
        if (static_cast<double>(expected[i][c]) > 1e-6 * greatest)
          error = std::max(error, std::abs(static_cast<double>(exchange.exitance[i][c] / expected[i][c]) - 1));
    EXPECT_LE(error, options.sums.tolerance) << absorption;
    EXPECT_LE(exchange.residual, 0.011);
  }
}

TEST(CoreExchange, RefusesWhatIsNone) {
  const RadialProfile profile = dipole_profile(of(0.1));
  CoreSurface surface = sphere(10, 5);
  surface.areas[3] = -1;
  EXPECT_THROW(exchange_core_light(surface, profile), InputError);
  surface = sphere(10, 5);
  surface.shell_reflection.assign(10, Rgb::Constant(1.5f));
  EXPECT_THROW(exchange_core_light(surface, profile), InputError);
  surface.shell_reflection.resize(9);
  EXPECT_THROW(exchange_core_light(surface, profile), InputError);
  surface = sphere(10, 5);
  surface.power[0][0] = NAN;
  EXPECT_THROW(exchange_core_light(surface, profile), InputError);
  EXPECT_TRUE(exchange_core_light({}, profile).exitance.empty());
}

}  // namespace
}  // namespace shellgrid
