// SPDX-License-Identifier: AGPL-3.0-or-later
// Smoothing beside functions that are known: less noise, errors that tell what is left, nothing lost where there is
// none.
#include "solvers/shell_texture/irradiance_smoothing.h"

#include <gtest/gtest.h>
#include <oneapi/tbb/global_control.h>

#include <cmath>
#include <cstdio>
#include <numbers>
#include <random>

namespace shellgrid {
namespace {

// Light that falls through layers, with veins of other matter whose borders are sharp, and waves around the rings.
std::vector<float> veined(const FunctionGrid& grid) {
  std::vector<float> values;
  for (int z = 0; z < grid.size.z(); ++z)
    for (int y = 0; y < grid.size.y(); ++y)
      for (int x = 0; x < grid.size.x(); ++x)
        for (int c = 0; c < 3; ++c)
          for (int ring = 0; ring < grid.rings; ++ring)
            for (int t = 0; t < grid.turns; ++t) {
              const bool vein = (x + 2 * y + z) % 12 < 4;
              const double angle = 2 * std::numbers::pi * t / grid.turns;
              values.push_back(static_cast<float>(std::exp(-(0.3 + 0.2 * c + 0.1 * ring) * z) * (vein ? 0.5 : 1) *
                                                  (1 + 0.4 * std::sin(0.5 * x) * std::cos(angle) / (1 + z))));
            }
  return values;
}

struct Noisy {
  FunctionGrid grid;
  std::vector<float> truth, first, second;
};

// Each value with noise of `relative` times it, in each half.
Noisy noisy(const Vec3i& size, double relative) {
  Noisy n;
  n.grid = {size, 3, 8, std::vector<float>(static_cast<std::size_t>(size.prod()), 1.0f)};
  std::mt19937 random(7);
  std::normal_distribution<double> normal;  // a width of nothing is not allowed there, so `relative` scales it
  std::bernoulli_distribution cut(0.1);
  for (float& w : n.grid.weight)
    if (cut(random)) w = 0.25f;
  n.grid.weight[5 % n.grid.weight.size()] = n.grid.weight.size() > 5 ? 0.0f : 1.0f;
  n.truth = veined(n.grid);
  const auto drawn = [&] {
    std::vector<float> half = n.truth;
    for (std::size_t k = 0; k < half.size(); ++k)
      half[k] *= static_cast<float>(1 + relative * normal(random) /
                                            std::sqrt(std::max(0.25, static_cast<double>(n.grid.weight[k / 72]))));
    return half;
  };
  n.first = drawn();
  n.second = drawn();
  return n;
}

// Of the channels' means, relative to the truth; of voxels that count.
struct Errors {
  double smoothed = 0, halves = 0, told = 0;
};
Errors errors_of(const Noisy& n, const SmoothedFunction& f) {
  Errors e;
  double count = 0;
  for (std::size_t v = 0; v < n.grid.weight.size(); ++v) {
    if (!(n.grid.weight[v] > 0)) continue;
    for (std::size_t l = 0; l < 24; ++l) {
      double truth = 0, smoothed = 0, halves = 0;
      for (std::size_t c = 0; c < 3; ++c) {
        const std::size_t at = (3 * v + c) * 24 + l;
        truth += static_cast<double>(n.truth[at]);
        smoothed += static_cast<double>(f.value[at]);
        halves += 0.5 * (static_cast<double>(n.first[at]) + static_cast<double>(n.second[at]));
      }
      e.smoothed += std::pow(smoothed / truth - 1, 2);
      e.halves += std::pow(halves / truth - 1, 2);
      e.told += std::pow(3 * static_cast<double>(f.error[24 * v + l]) / truth, 2);
      ++count;
    }
  }
  return {std::sqrt(e.smoothed / count), std::sqrt(e.halves / count), std::sqrt(e.told / count)};
}

TEST(IrradianceSmoothing, TakesNoiseAwayAndTellsWhatIsLeft) {
  for (const double noise : {0.05, 0.2, 0.8}) {
    const Noisy n = noisy({32, 24, 6}, noise);
    const Errors e = errors_of(n, smooth_function(n.grid, n.first, n.second));
    std::printf("noise %.2f: error of the halves' mean %.4f, smoothed %.4f, told %.4f\n", noise, e.halves, e.smoothed,
                e.told);
    EXPECT_LT(e.smoothed, 0.75 * e.halves);
    EXPECT_NEAR(e.told / e.smoothed, 1, 0.15);
  }
}

TEST(IrradianceSmoothing, KeepsWhatIsCertain) {
  for (const Vec3i& size : {Vec3i(24, 16, 5), Vec3i(1, 1, 4), Vec3i(1, 1, 1), Vec3i(2, 1, 3)}) {
    const Noisy n = noisy(size, 0);
    const SmoothedFunction f = smooth_function(n.grid, n.first, n.second);
    for (std::size_t k = 0; k < n.truth.size(); ++k) {
      const bool counts = n.grid.weight[k / 72] > 0;
      ASSERT_NEAR(f.value[k], counts ? n.truth[k] : 0, 1e-4 * n.truth[k]) << size.transpose() << ": " << k;
      ASSERT_LT(f.error[k / 72 * 24 + k % 24], 1e-3);
    }
  }
}

TEST(IrradianceSmoothing, KeepsLayersMeans) {
  const Noisy n = noisy({10, 9, 6}, 0.5);
  const SmoothedFunction f = smooth_function(n.grid, n.first, n.second);
  for (std::size_t z = 0; z < 6; ++z)
    for (std::size_t k = 0; k < 72; ++k) {
      double given = 0, smoothed = 0;
      for (std::size_t v = 90 * z; v < 90 * (z + 1); ++v) {
        const auto weight = static_cast<double>(n.grid.weight[v]);
        given += 0.5 * weight * static_cast<double>(n.first[72 * v + k] + n.second[72 * v + k]);
        smoothed += weight * static_cast<double>(f.value[72 * v + k]);
      }
      EXPECT_NEAR(smoothed / given, 1, 1e-5) << z << ' ' << k;
    }
}

TEST(IrradianceSmoothing, TheSameBitsAtAnyThreadCount) {
  const Noisy n = noisy({9, 7, 4}, 0.3);
  const SmoothedFunction f = smooth_function(n.grid, n.first, n.second);
  const oneapi::tbb::global_control one(oneapi::tbb::global_control::max_allowed_parallelism, 1);
  const SmoothedFunction again = smooth_function(n.grid, n.first, n.second);
  EXPECT_TRUE(f.value == again.value);
  EXPECT_TRUE(f.error == again.error);
}

TEST(IrradianceSmoothing, ServesDarkAndEmptyGrids) {
  FunctionGrid grid{{4, 3, 2}, 1, 1, std::vector<float>(24, 1.0f)};
  const std::vector<float> dark(72, 0.0f);
  for (const float value : smooth_function(grid, dark, dark).value) EXPECT_EQ(value, 0);
  grid.weight.assign(24, 0.0f);
  const std::vector<float> bright(72, 1.0f);
  for (const float value : smooth_function(grid, bright, bright).value) EXPECT_EQ(value, 0);
}

}  // namespace
}  // namespace shellgrid
