// SPDX-License-Identifier: AGPL-3.0-or-later
// The shell texture function against closed forms: attenuation in a flat layer, energy, and the white furnace.
#include "solvers/shell_texture/irradiance_tracing.h"

#include <gtest/gtest.h>
#include <oneapi/tbb/global_control.h>

#include <cmath>
#include <cstdio>
#include <numbers>

#include "meshing/core/error.h"
#include "meshing/core/random.h"
#include "solvers/transport/dielectric.h"

namespace shellgrid {
namespace {

BaseVolume layer(const Vec3i& size, const Vec3f& extinction, const Vec3f& albedo, float anisotropy, double ior) {
  BaseVolume v;
  v.size = size;
  v.voxel = 0.5;
  v.ior = ior;
  v.extinction.assign(v.voxel_count(), extinction);
  v.albedo.assign(v.voxel_count(), albedo);
  v.anisotropy.assign(v.voxel_count(), Vec3f::Constant(anisotropy));
  v.free.assign(v.voxel_count(), 0);
  return v;
}

// σ_t of random powers, and a block on top whose upper part overhangs.
BaseVolume bumpy(float albedo, double ior) {
  BaseVolume v = layer({10, 10, 8}, Vec3f::Ones(), Vec3f::Constant(albedo), 0.3f, ior);
  for (std::size_t k = 0; k < v.voxel_count(); ++k) {
    const double power = 2 * to_unit(hash64(3, k)) - 1;
    v.extinction[k] = Vec3f(1.0f, 2.0f, 0.5f) * static_cast<float>(std::pow(4.0, power));
  }
  for (int y = 0; y < 10; ++y)
    for (int x = 0; x < 10; ++x)
      for (int z = 0; z < 4; ++z) {
        const bool head = z < 2 && x >= 2 && x < 8 && y >= 2 && y < 8;
        const bool stem = x >= 4 && x < 6 && y >= 4 && y < 6;
        if (!head && !stem) v.free[v.index(x, y, z)] = 1;
      }
  return v;
}

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
  options.paths = 60;
  IrradianceReport report;
  const ShellTexture t = trace_irradiance(v, options, &report);
  for (int l = 0; l <= options.directions.count(); ++l) {
    const DirectionBalance& b = report.balance[l];
    EXPECT_NEAR(b.absorbed + b.left_above + b.left_below, 1, 0.015) << l;  // the roulette's noise
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
        absorbed += 0.2 * v.extinction[k][c] * (t.single[t.at(l, k)][c] + t.multiple[t.at(l, k)][c]) * t.matter[k] / 3;
    }
    const double fallen = 100 * options.directions.direction(l).z();  // texels; the voxel's edge falls out but once
    EXPECT_NEAR(absorbed * 0.5 / fallen, b.absorbed, 0.06 * b.absorbed) << l;
  }
}

// White matter in even light is as bright as the light: within it η² times.
TEST(IrradianceTracing, AWhiteSampleInEvenLightDisappears) {
  for (const bool bumps : {false, true})
    for (const double ior : {1.0, 1.5}) {
      const BaseVolume v = bumps ? bumpy(1, ior) : layer({4, 4, 6}, {1, 3, 0.3f}, Vec3f::Ones(), 0.5f, ior);
      IrradianceOptions options;
      options.directions = {12, 8};
      options.paths = bumps ? 24 : 100;
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
      // Noise: a fortieth of a channel, less of their mean.
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
  IrradianceReport report;
  const ShellTexture t = trace_irradiance(v, options, &report);
  EXPECT_LE(report.median_error, 0.1);
  EXPECT_GT(report.median_error, 0.03);
  const oneapi::tbb::global_control one(oneapi::tbb::global_control::max_allowed_parallelism, 1);
  const ShellTexture again = trace_irradiance(v, options);
  for (std::size_t k = 0; k < t.multiple.size(); ++k) ASSERT_EQ(t.multiple[k], again.multiple[k]);
  for (std::size_t k = 0; k < t.single.size(); ++k) ASSERT_EQ(t.single[k], again.single[k]);
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
