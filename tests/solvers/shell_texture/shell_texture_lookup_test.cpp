// SPDX-License-Identifier: AGPL-3.0-or-later
// Looking up: exact at the table's places, linear between, continuous over the zenith, around the circle and the tile.
#include "solvers/shell_texture/shell_texture_lookup.h"

#include <gtest/gtest.h>

#include <algorithm>
#include <cmath>
#include <numbers>
#include <vector>

#include "meshing/core/error.h"
#include "meshing/core/random.h"

namespace shellgrid {
namespace {

ShellTexture noise(const Vec3i& size, const LightDirections& directions) {
  ShellTexture t;
  t.size = size;
  t.directions = directions;
  auto value = [n = std::uint64_t{0}]() mutable { return static_cast<float>(to_unit(hash64(7, n++))); };
  const std::size_t voxels = static_cast<std::size_t>(size.x()) * size.y() * size.z();
  for (std::size_t k = 0; k < voxels * directions.count(); ++k) t.single.emplace_back(value(), value(), value());
  for (std::size_t k = 0; k < voxels * (directions.count() + 1); ++k)
    t.multiple.emplace_back(value(), value(), value());
  t.error.assign(t.multiple.size(), 0.1f);
  t.matter.assign(voxels, 1.0f);
  for (std::size_t k = 0; k < t.texel_count() * (directions.count() + 1); ++k)
    t.below.emplace_back(value(), value(), value());
  return t;
}

Vec3 towards(double polar, double azimuth) {
  return {std::sin(polar) * std::cos(azimuth), std::sin(polar) * std::sin(azimuth), std::cos(polar)};
}

TEST(ShellTextureLookup, IsTheTableAtItsPlaces) {
  const ShellTexture t = noise({4, 3, 2}, {3, 5});
  const auto lookup = look_up_as_it_is(t);
  const auto reader = lookup->reader();
  for (int l = 0; l < t.directions.count(); ++l) {
    const PreparedLight light = lookup->prepare_direction(t.directions.direction(l));
    for (int v = 0; v < 24; ++v) {
      const Vec3f middle(v % 4 + 0.5f, v / 4 % 3 + 0.5f, v / 12 + 0.5f);
      const VoxelLight found = reader->at(middle, light);
      EXPECT_LT((found.single - t.single[t.at(l, v)]).norm(), 2e-5) << l << ' ' << v;
      EXPECT_LT((found.multiple - t.multiple[t.at(l, v)]).norm(), 2e-5);
      if (l == 0) EXPECT_LT((reader->back(middle) - t.multiple[t.at(15, v)]).norm(), 1e-6);
      if (v < 12) EXPECT_LT((lookup->below(middle.x(), middle.y(), light) - t.below[l * 12 + v]).norm(), 2e-5);
    }
  }
}

TEST(ShellTextureLookup, IsLinearBetweenAndContinuousEverywhere) {
  const ShellTexture t = noise({4, 3, 3}, {3, 6});
  const auto lookup = look_up_as_it_is(t);
  const auto reader = lookup->reader();
  const double step = std::numbers::pi / 6;
  // Half-way between two rings and two turns: the mean of four.
  const PreparedLight half = lookup->prepare_direction(towards(step, (5.5) * std::numbers::pi / 3));
  Vec3f mean = Vec3f::Zero();
  for (const int l : {5, 0, 11, 6}) mean += 0.25f * t.multiple[t.at(l, 0)];
  EXPECT_LT((reader->at({0.5f, 0.5f, 0.5f}, half).multiple - mean).norm(), 1e-5);
  // At the zenith: the mean of opposite directions, whatever the azimuth says.
  const VoxelLight zenith = reader->at({0.5f, 0.5f, 0.5f}, lookup->prepare_direction(towards(0, 0)));
  EXPECT_LT((zenith.multiple - 0.5f * (t.multiple[t.at(0, 0)] + t.multiple[t.at(3, 0)])).norm(), 1e-5);
  const auto at = [&](const Vec3f& p, double polar, double azimuth) {
    const VoxelLight light = reader->at(p, lookup->prepare_direction(towards(polar, azimuth)));
    return Vec3f(light.single + light.multiple);
  };
  for (int k = 0; k < 200; ++k) {
    const auto u = [&](int n) { return to_unit(hash64(k, n)); };
    const Vec3f p(static_cast<float>(10 * u(0) - 3), static_cast<float>(9 * u(1) - 3),
                  static_cast<float>(5 * u(2) - 1));
    const double polar = 1.7 * u(3), azimuth = 7 * u(4);
    const Vec3f here = at(p, polar, azimuth);
    EXPECT_LT((here - at(p, polar + 1e-4, azimuth)).norm(), 3e-3);
    EXPECT_LT((here - at(p, polar, azimuth + 1e-4)).norm(), 3e-3);
    EXPECT_LT((here - at(p + Vec3f(4, -3, 0), polar, azimuth)).norm(), 3e-4);
    EXPECT_LT((here - at(p + Vec3f::Constant(1e-4f), polar, azimuth)).norm(), 3e-3);
  }
  EXPECT_EQ(at({1, 1, 1}, std::numbers::pi / 2, 0).norm() < 1e-6, true);
  EXPECT_EQ(at({1, 1, 1}, 2, 0).norm(), 0);
  // Through the zenith along a line.
  EXPECT_LT((at({1, 1, 1}, 1e-4, 1) - at({1, 1, 1}, 1e-4, 1 + std::numbers::pi)).norm(), 3e-3);
}

// Each direction's weight is a hat over polar angle and azimuth, here by the library's angles.
TEST(DirectionBlend, HasTheWeightsOfItsAngles) {
  const LightDirections table{5, 9};
  const double step = std::numbers::pi / (2 * table.rings), turn = 2 * std::numbers::pi / table.turns;
  const auto hat = [](double distance) { return std::max(0.0, 1 - std::abs(distance)); };
  for (int n = 0; n < 2000; ++n) {
    const double polar = step * (0.5 + (table.rings - 1) * std::fmod(0.618034 * n, 1.0)), azimuth = 0.0137 * n - 9;
    const Vec3 light(std::sin(polar) * std::cos(azimuth), std::sin(polar) * std::sin(azimuth), std::cos(polar));
    std::vector<double> found(table.count(), 0.0);
    for (const DirectionWeight& one : blend_directions(table, light))
      found[one.direction] += static_cast<double>(one.weight[0]);
    for (int d = 0; d < table.count(); ++d) {
      const int ring = d / table.turns;
      const double around = std::remainder(azimuth - d % table.turns * turn, 2 * std::numbers::pi) / turn;
      EXPECT_NEAR(found[d], hat(polar / step - 0.5 - ring) * hat(around), 2e-6) << n << " " << d;
    }
  }
  for (const Vec3& axis : {Vec3(1, 0, 1), Vec3(-1, 0, 1), Vec3(0, 1, 1), Vec3(0, -1, 1), Vec3(0, 0, 1)}) {
    float sum = 0;
    for (const DirectionWeight& one : blend_directions(table, axis.normalized())) sum += one.weight[1];
    EXPECT_NEAR(sum, 1, 1e-6f);
  }
}

TEST(ShellTextureLookup, FreeSpaceDoesNotDarkenTheSurface) {
  ShellTexture t = noise({2, 2, 4}, {1, 1});
  for (std::size_t k = 0; k < t.multiple.size(); ++k) t.multiple[k] = Vec3f::Constant(k % 16 < 8 ? 0.0f : 2.0f);
  for (int k = 0; k < 8; ++k) t.matter[k] = 0;
  const auto lookup = look_up_as_it_is(t);
  const auto reader = lookup->reader();
  const PreparedLight light = lookup->prepare_direction(t.directions.direction(0));
  for (const float z : {-2.0f, 0.5f, 1.2f, 1.8f, 3.0f}) EXPECT_NEAR(reader->at({1, 1, z}, light).multiple[1], 2, 1e-5);
}

TEST(ShellTextureLookup, AddsUpLightFromSeveralDirectionsByColour) {
  const ShellTexture t = noise({3, 2, 2}, {2, 4});
  const auto lookup = look_up_as_it_is(t);
  const PreparedLight light = lookup->prepare({{1, {1, 0, 0.5f}}, {7, {0, 2, 1}}});
  const VoxelLight found = lookup->reader()->voxel_light(5, light);
  const Vec3f a = t.multiple[t.at(1, 5)], b = t.multiple[t.at(7, 5)];
  EXPECT_LT((found.multiple - Vec3f(a[0], 2 * b[1], 0.5f * a[2] + b[2])).norm(), 1e-6);
  EXPECT_THROW(lookup->prepare({{8, Vec3f::Ones()}}), InputError);
}

TEST(ShellTextureLookup, RefusesArraysOfAnotherSize) {
  ShellTexture t = noise({2, 2, 2}, {1, 2});
  t.single.pop_back();
  EXPECT_THROW(look_up_as_it_is(t), InputError);
  t = noise({2, 2, 2}, {1, 2});
  t.below.clear();
  EXPECT_THROW(look_up_as_it_is(t), InputError);
}

}  // namespace
}  // namespace shellgrid
