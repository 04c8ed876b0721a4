// SPDX-License-Identifier: AGPL-3.0-or-later
// The shell texture function against closed forms: attenuation in a flat layer, energy, and the white furnace.
#include "solvers/shell_texture/irradiance_tracing.h"

#include <gtest/gtest.h>
#include <oneapi/tbb/global_control.h>

#include <cmath>
#include <cstdio>
#include <numbers>

#include "meshing/core/error.h"
#include "solvers/transport/dielectric.h"
#include "tests/support/base_volumes.h"

namespace shellgrid {
namespace {

using test::layer;

// σ_t of random powers, and a block on top whose upper part overhangs.
BaseVolume bumpy(float albedo, double ior) {
  BaseVolume v = layer({10, 10, 8}, Vec3f::Ones(), Vec3f::Constant(albedo), 0.3f, ior);
  test::vary_extinction(v, 4);
  test::cut_mushroom(v);
  return v;
}

constexpr IrradianceEstimator both[] = {IrradianceEstimator::shared_walks, IrradianceEstimator::track_length};

// ∫ over the upper hemisphere, ring by ring, of I_s + I_m, and `below` times that from below.
Vec3 hemisphere_sum(const ShellTexture& t, std::size_t voxel, double below) {
  Vec3 sum = Vec3::Zero();
  const double step = std::numbers::pi / (2 * t.directions.rings);
  for (int l = 0; l < t.directions.count(); ++l) {
    const int ring = l / t.directions.turns;
    const double solid =
        (std::cos(ring * step) - std::cos((ring + 1) * step)) * 2 * std::numbers::pi / t.directions.turns;
    sum += solid * (t.single[t.at(l, voxel)] + t.multiple[t.at(l, voxel)]).cast<double>();
  }
  return sum + 2 * std::numbers::pi * below * t.multiple[t.at(t.directions.back(), voxel)].cast<double>();
}

TEST(IrradianceTracing, LightFadesInAFlatLayerAsItMust) {
  const BaseVolume v = layer({3, 2, 6}, {0.4f, 1.5f, 0.01f}, {0.2f, 0.9f, 0}, 0, 1.4);
  IrradianceOptions options;
  const ShellTexture t = trace_irradiance(v, options);
  for (int l = 0; l < options.directions.count(); ++l) {
    const double cosine = options.directions.direction(l).z();
    const BoundaryMeeting meeting = meet_boundary(cosine, 1.4);
    for (std::size_t k = 0; k < v.voxel_count(); ++k)
      for (int c = 0; c < 3; ++c) {
        const double depth = static_cast<double>(k / 6) * 0.5, sigma = v.extinction[0][c] / meeting.cosine_beyond;
        const double mean = (std::exp(-sigma * depth) - std::exp(-sigma * (depth + 0.5))) / (sigma * 0.5);
        const double expected = (1 - meeting.reflectance) * cosine / meeting.cosine_beyond * mean;
        ASSERT_NEAR(t.single[t.at(l, k)][c], expected, 2e-4 * expected) << l << ' ' << k << ' ' << c;
      }
  }
}

TEST(IrradianceTracing, EveryWattIsAbsorbedOrLeaves) {
  const BaseVolume v = bumpy(0.8f, 1.3);
  IrradianceOptions options;
  options.directions = {3, 4};
  for (const IrradianceEstimator estimator : both) {
    options.estimator = estimator;
    options.paths = estimator == IrradianceEstimator::shared_walks ? 400 : 60;
    IrradianceReport report;
    const ShellTexture t = trace_irradiance(v, options, &report);
    for (int l = 0; l <= options.directions.count(); ++l) {
      const DirectionBalance& b = report.balance[l];
      EXPECT_NEAR(b.absorbed + b.left_above + b.left_below, 1, 0.02) << l;  // the roulette's noise
      // What passes into the core.
      double below = 0;
      for (int k = 0; k < 100; ++k) below += t.below[100 * l + k].mean() / 100;
      const bool back = l == options.directions.back();
      EXPECT_NEAR(below, b.left_below * (back ? 1 : options.directions.direction(l).z()), 1e-4) << l;
      if (back) continue;
      // What the fluence says is absorbed, of what falls on the tile.
      double absorbed = 0;
      for (std::size_t k = 0; k < v.voxel_count(); ++k) {
        if (v.free[k]) continue;
        for (int c = 0; c < 3; ++c)
          absorbed +=
              0.2 * v.extinction[k][c] * (t.single[t.at(l, k)][c] + t.multiple[t.at(l, k)][c]) * t.matter[k] / 3;
      }
      const double fallen = 100 * options.directions.direction(l).z();  // texels; the voxel's edge falls out but once
      EXPECT_NEAR(absorbed * 0.5 / fallen, b.absorbed, 0.06 * b.absorbed) << l;
    }
  }
}

// White matter in even light is as bright as the light: within it η² times.
TEST(IrradianceTracing, AWhiteSampleInEvenLightDisappears) {
  for (const bool bumps : {false, true})
    for (const double ior : {1.0, 1.5}) {
      const BaseVolume v = bumps ? bumpy(1, ior) : layer({4, 4, 6}, {1, 3, 0.3f}, Vec3f::Ones(), 0.5f, ior);
      IrradianceOptions options;
      options.directions = {12, 8};
      options.paths = bumps ? 600 : 1500;
      const ShellTexture t = trace_irradiance(v, options);
      Vec3 mean = Vec3::Zero();
      double worst = 0;
      int count = 0;
      for (std::size_t k = 0; k < v.voxel_count(); ++k) {
        if (v.free[k] || t.matter[k] < 0.5f) continue;
        const Vec3 ratio = hemisphere_sum(t, k, ior * ior) / (4 * std::numbers::pi * ior * ior);
        mean += ratio;
        worst = std::max(worst, (ratio.array() - 1).abs().maxCoeff());
        ++count;
      }
      mean /= count;
      std::printf("bumps %d, index %.1f: %.4f %.4f %.4f of the light, worst voxel %.3f off\n", bumps, ior, mean[0],
                  mean[1], mean[2], worst);
      for (int c = 0; c < 3; ++c) EXPECT_NEAR(mean[c], 1, 0.05);
      EXPECT_NEAR(mean.mean(), 1, 0.015);
      EXPECT_LT(worst, 0.6);
    }
}

TEST(IrradianceTracing, ThePapersSphereIsBiasedNearTheSurface) {
  const BaseVolume v = layer({6, 6, 8}, Vec3f::Constant(2), Vec3f::Constant(0.9f), 0, 1.3);
  IrradianceOptions options;
  options.directions = {2, 2};
  options.paths = 400;
  options.estimator = IrradianceEstimator::track_length;
  const ShellTexture right = trace_irradiance(v, options);
  options.estimator = IrradianceEstimator::sphere;
  const ShellTexture paper = trace_irradiance(v, options);
  const auto layer_mean = [&](const ShellTexture& t, const std::vector<Vec3f>& of, int z) {
    double sum = 0;
    for (int k = 0; k < 36; ++k)
      sum += static_cast<double>(of[t.at(0, static_cast<std::size_t>(36 * z + k))].sum()) / 108;
    return sum;
  };
  const double single = layer_mean(paper, paper.single, 0) / layer_mean(right, right.single, 0);
  const double middle = layer_mean(paper, paper.multiple, 3) / layer_mean(right, right.multiple, 3);
  std::printf("the paper's sphere over the right value: I_s on top %.3f, I_m within %.3f\n", single, middle);
  EXPECT_LT(single, 0.95);  // a part of the sphere is outside
  EXPECT_NEAR(middle, 1, 0.05);
}

TEST(IrradianceTracing, StopsAtItsErrorAndGivesTheSameBitsAtAnyThreadCount) {
  const BaseVolume v = bumpy(0.9f, 1.4);
  IrradianceOptions options;
  options.directions = {2, 3};
  options.target_error = 0.1;
  for (const IrradianceEstimator estimator : both) {
    options.estimator = estimator;
    IrradianceReport report;
    const ShellTexture t = trace_irradiance(v, options, &report);
    EXPECT_LE(report.median_error, 0.1);
    EXPECT_GT(report.median_error, 0.02);
    const oneapi::tbb::global_control one(oneapi::tbb::global_control::max_allowed_parallelism, 1);
    const ShellTexture again = trace_irradiance(v, options);
    EXPECT_TRUE(t.multiple == again.multiple);
    EXPECT_TRUE(t.single == again.single);
    EXPECT_TRUE(t.below == again.below);
    EXPECT_TRUE(t.error == again.error);
  }
}

TEST(IrradianceTracing, GoesOnToTheSameBitsAsWithoutABreak) {
  const BaseVolume v = bumpy(0.9f, 1.4);
  for (const IrradianceEstimator estimator : {both[0], both[1], IrradianceEstimator::sphere}) {
    IrradianceOptions options;
    options.estimator = estimator;
    options.directions = {2, 3};
    options.paths = 30;
    options.target_error = 0.03;
    const ShellTexture whole = trace_irradiance(v, options);
    IrradianceSums sums = empty_sums(v, options);
    int breaks = 0;
    for (int run = 0; run < 1000; ++run) {
      int asked = 0;
      options.interrupted = [&] { return ++asked > 12; };
      IrradianceReport report;
      const ShellTexture part = trace_irradiance(v, options, sums, &report);
      if (report.interrupted) {
        ++breaks;
        continue;
      }
      EXPECT_TRUE(part.multiple == whole.multiple);
      EXPECT_TRUE(part.below == whole.below);
      EXPECT_TRUE(part.error == whole.error);
      EXPECT_TRUE(part.single == whole.single);
      break;
    }
    EXPECT_GT(breaks, 0);
    sums = empty_sums(v, options);
    options.interrupted = [] { return true; };
    EXPECT_THROW(trace_irradiance(v, options, sums), InputError);
  }
}

// Along a flat surface light of all directions of a ring does the same.
TEST(IrradianceTracing, StandardErrorsTellHowFarValuesAreOff) {
  const BaseVolume v = layer({6, 6, 5}, Vec3f(1, 2, 0.5f), Vec3f(0.9f, 0.5f, 0), 0.5f, 1.3);
  for (const IrradianceEstimator estimator : both) {
    IrradianceOptions options;
    options.estimator = estimator;
    options.smooth = false;
    options.directions = {2, 4};
    options.paths = 20;
    options.target_error = 1e-9;
    options.most_paths = 160;
    const ShellTexture t = trace_irradiance(v, options);
    double chi_square = 0;
    int count = 0;
    for (int l = 0; l < 8; ++l)
      for (int z = 0; z < 5; ++z) {
        double mean = 0;
        for (int m = l / 4 * 4; m < l / 4 * 4 + 4; ++m)
          for (int k = 0; k < 36; ++k) mean += static_cast<double>(t.multiple[t.at(m, 36 * z + k)].mean()) / 144;
        for (int k = 0; k < 36; ++k) {
          const std::size_t at = t.at(l, 36 * z + k);
          const double value = static_cast<double>(t.multiple[at].mean());
          chi_square += std::pow((value - mean) / (value * static_cast<double>(t.error[at])), 2);
          ++count;
        }
      }
    std::printf("mean square of deviations over standard errors: %.3f\n", chi_square / count);
    EXPECT_NEAR(chi_square / count, 1, 0.2);
  }
}

// Walks that leap and are split, beside paths that do neither: in a dense slab of white matter under one that absorbs a
// little, with a block of other matter, flat or bumpy.
TEST(IrradianceTracing, LeapsThroughDenseMatterAsStepsDo) {
  for (const bool bumps : {false, true}) {
    BaseVolume v = layer({4, 4, 6}, Vec3f::Constant(32), Vec3f::Constant(0.9995f), 0.4f, 1.2);
    for (std::size_t k = 48; k < v.voxel_count(); ++k) v.albedo[k] = Vec3f::Ones();
    for (const std::size_t k : {21, 22, 37}) v.extinction[k] = Vec3f::Constant(20);
    if (bumps) v.free[0] = v.free[1] = v.free[5] = 1;
    IrradianceOptions options;
    options.smooth = false;  // errors tell of single voxels
    options.directions = {2, 1};
    options.paths = 400;
    const ShellTexture leaping = trace_irradiance(v, options);
    options.estimator = IrradianceEstimator::track_length;
    options.paths = 200;
    const ShellTexture stepping = trace_irradiance(v, options);
    int sharp = 0;
    for (int l = 0; l <= options.directions.count(); ++l)
      for (int z = 0; z < 6; ++z) {
        double sum = 0, of = 0, square = 0;
        int count = 0;
        for (std::size_t k = 16 * z; k < 16u * z + 16; ++k) {
          if (v.free[k]) continue;
          ++count;
          sum += static_cast<double>(leaping.multiple[leaping.at(l, k)].sum());
          of += static_cast<double>(stepping.multiple[stepping.at(l, k)].sum());
          square += std::pow(static_cast<double>(leaping.error[leaping.at(l, k)]), 2) +
                    std::pow(static_cast<double>(stepping.error[stepping.at(l, k)]), 2);
        }
        const double error = std::sqrt(square / count);  // as if a layer's voxels were all off together
        std::printf("bumps %d, direction %d, layer %d: %.3f, errors %.3f\n", bumps, l, z, sum / of, error);
        EXPECT_NEAR(sum / of, 1, 2.5 * error) << bumps << ' ' << l << ' ' << z;
        if (error < 0.1) ++sharp;
      }
    EXPECT_GE(sharp, 2);
  }
}

// A slab of ten thousands of mean free paths in a moment: a linear fall, from the surface to its open bottom.
TEST(IrradianceTracing, WhiteMatterOfAnyDensityLetsLightFallLinearly) {
  const int layers = 5;
  for (const float extinction : {60.0f, 1e4f}) {
    const BaseVolume v = layer({3, 2, layers}, Vec3f::Constant(extinction), Vec3f::Ones(), 0, 1);
    IrradianceOptions options;
    options.directions = {1, 1};
    options.paths = 1200;
    const ShellTexture t = trace_irradiance(v, options);
    std::vector<double> ratio(layers, 0.0);
    double mean = 0;
    for (int z = 0; z < layers; ++z) {
      for (std::size_t k = 6 * z; k < 6u * z + 6; ++k)
        ratio[z] += static_cast<double>(t.multiple[t.at(t.directions.back(), k)].sum()) / 18;
      // Twice the power at the bottom, none at the top, beyond both by 0.71 paths.
      const double depth = static_cast<double>(extinction) * 0.5 * layers,
                   from_top = static_cast<double>(extinction) * 0.5 * (z + 0.5);
      ratio[z] /= 2 * (from_top + 0.7104) / (depth + 2 * 0.7104);
      std::printf("%g /mm, layer %d: %.4f of diffusion's\n", static_cast<double>(extinction), z, ratio[z]);
      mean += ratio[z] / layers;
    }
    // About a thousand walks; from level to level one in two goes on, which leaves √(14/1000) of noise in all layers.
    EXPECT_NEAR(mean, 1, 0.3);
    for (const double r : ratio) EXPECT_NEAR(r / mean, 1, 0.1);
  }
}

TEST(IrradianceTracing, ServesAnyMatterOrSaysWhyNot) {
  for (const double extinction : {1e-4, 1e4})
    for (const float albedo : {0.0f, 1.0f})
      for (const float g : {0.0f, 0.9f}) {
        BaseVolume v = layer({4, 3, 3}, Vec3f::Constant(static_cast<float>(extinction)), Vec3f::Constant(albedo), g, 1);
        v.free[0] = v.free[5] = 1;
        IrradianceOptions options;
        options.directions = {2, 3};
        options.paths = 40;
        IrradianceReport report;
        const ShellTexture t = trace_irradiance(v, options, &report);
        for (const Vec3f& value : t.multiple) ASSERT_TRUE(value.allFinite() && value.minCoeff() >= 0);
        for (const Vec3f& value : t.single) ASSERT_TRUE(value.allFinite() && value.minCoeff() >= 0);
        double balance = 0;
        for (int l = 0; l < 6; ++l) {
          const DirectionBalance& b = report.balance[l];
          balance += (b.absorbed + b.left_above + b.left_below) / 6;
          if (albedo == 0) {
            double most = 0;
            for (std::size_t k = 0; k < v.voxel_count(); ++k)
              most = std::max(most, static_cast<double>(t.multiple[t.at(l, k)].maxCoeff()));
            EXPECT_EQ(most, 0);  // index 1: nothing is mirrored, nothing scatters
          }
        }
        EXPECT_NEAR(balance, 1, 0.15) << extinction << ' ' << albedo << ' ' << g;
      }
  IrradianceOptions options;
  const BaseVolume one = layer({1, 1, 1}, Vec3f::Ones(), Vec3f::Constant(0.9f), 0, 1.3);
  const ShellTexture t = trace_irradiance(one, options);
  EXPECT_GT(t.multiple[0].minCoeff(), 0);
  EXPECT_GT(t.below[0].minCoeff(), 0);
}

TEST(IrradianceTracing, SurfacesMayHaveSeveralIndices) {
  BaseVolume v = layer({8, 4, 3}, Vec3f::Ones(), Vec3f::Zero(), 0, 1.5);
  v.surface_ior.assign(v.voxel_count(), 0.0f);
  for (int k = 0; k < 32; ++k) v.surface_ior[k] = k % 8 < 4 ? 1.5f : 1.1f;
  IrradianceOptions options;
  options.directions = {3, 4};
  const ShellTexture t = trace_irradiance(v, options);
  for (const int x : {1, 5}) {
    const double cosine = options.directions.direction(0).z();
    const BoundaryMeeting meeting = meet_boundary(cosine, x == 1 ? 1.5 : static_cast<double>(1.1f));
    const double sigma = 1 / meeting.cosine_beyond;
    const double expected =
        (1 - meeting.reflectance) * cosine / meeting.cosine_beyond * (1 - std::exp(-0.5 * sigma)) / (0.5 * sigma);
    EXPECT_NEAR(t.single[t.at(0, 8 + x)][0], expected, 0.02 * expected) << x;
  }
}

TEST(IrradianceTracing, RefusesWhatNoMatterHas) {
  IrradianceOptions options;
  BaseVolume v = layer({2, 2, 2}, Vec3f::Ones(), Vec3f::Ones(), 0, 1.3);
  v.extinction[3][1] = std::nanf("");
  EXPECT_THROW(trace_irradiance(v, options), InputError);
  v = layer({2, 2, 2}, Vec3f::Ones(), Vec3f::Constant(1.1f), 0, 1.3);
  EXPECT_THROW(trace_irradiance(v, options), InputError);
  v = layer({2, 2, 2}, Vec3f::Ones(), Vec3f::Ones(), 0, 0.9);
  EXPECT_THROW(trace_irradiance(v, options), InputError);
  v = layer({2, 2, 2}, Vec3f::Ones(), Vec3f::Ones(), 0, 1.3);
  v.free.assign(8, 1);
  EXPECT_THROW(trace_irradiance(v, options), InputError);
  v.free.pop_back();
  EXPECT_THROW(trace_irradiance(v, options), InputError);
}

}  // namespace
}  // namespace shellgrid
