// SPDX-License-Identifier: AGPL-3.0-or-later
#include "solvers/render/lights.h"

#include <gtest/gtest.h>

#include <cmath>
#include <numbers>

#include "meshing/core/error.h"
#include "meshing/core/random.h"

namespace shellgrid {
namespace {

constexpr double pi = std::numbers::pi;

Rgb irradiance(const std::vector<DirectionalLight>& lights, const Vec3& normal) {
  Rgb sum = Rgb::Zero();
  for (const DirectionalLight& light : lights)
    sum += light.irradiance * static_cast<float>(std::max(0.0, -light.direction.dot(normal)));
  return sum;
}

// ∫ L cos dω by many random directions.
Rgb brute_force_irradiance(const EnvironmentLight& environment, const Vec3& normal) {
  RandomStream random(1);
  Eigen::Array3d sum = Eigen::Array3d::Zero();
  const int count = 400000;
  for (int i = 0; i < count; ++i) {
    const double z = 1 - 2 * random.next(), a = 2 * pi * random.next(), r = std::sqrt(1 - z * z);
    const Vec3 direction(r * std::cos(a), r * std::sin(a), z);
    const double cosine = direction.dot(normal);
    if (cosine > 0) sum += radiance(environment, direction).cast<double>() * cosine;
  }
  return (sum * (4 * pi / count)).cast<float>();
}

TEST(Lights, UniformSkyGivesPiOnEveryPlane) {
  EnvironmentLight sky;
  sky.zenith = sky.horizon = sky.ground = Rgb(1, 2, 3);
  const auto lights = directional_lights(sky, 256);
  for (const Vec3& n : {Vec3(0, 1, 0), Vec3(0, -1, 0), Vec3(1, 0, 0), Vec3(0.6, 0, 0.8), Vec3(0.48, -0.6, 0.64)})
    for (int k = 0; k < 3; ++k) EXPECT_NEAR(irradiance(lights, n)[k], pi * (k + 1), 0.01 * (k + 1) * pi);
}

TEST(Lights, LampsAndGradientsIntegrateLikeBruteForce) {
  EnvironmentLight sky;
  sky.up = Vec3(0, 0, 1);
  sky.zenith = Rgb(0.2f, 0.4f, 0.8f);
  sky.horizon = Rgb(0.5f, 0.4f, 0.3f);
  sky.ground = Rgb(0.05f, 0.05f, 0.05f);
  sky.lamps.push_back({Vec3(1, 1, 1).normalized(), 0.4, 0.3, Rgb(8, 7, 6)});
  sky.lamps.push_back({Vec3(-1, 0.2, 0).normalized(), 0.15, 0.0, Rgb(20, 25, 30)});
  const auto lights = directional_lights(sky, 512);
  EXPECT_LE(lights.size(), 540u);
  for (const Vec3& n : {Vec3(0, 0, 1), Vec3(0, 1, 0), Vec3(-1, 0, 0), Vec3(1, 0, 0)}) {
    const Rgb expected = brute_force_irradiance(sky, n), found = irradiance(lights, n);
    for (int k = 0; k < 3; ++k) EXPECT_NEAR(found[k], expected[k], 0.03 * expected[k]) << n.transpose();
  }
}

TEST(Lights, PictureKeepsItsEnergyAndItsDirections) {
  auto picture = std::make_shared<Image>();
  picture->width = 64;
  picture->height = 32;
  for (const char* name : {"R", "G", "B"}) picture->add(name);
  for (auto& channel : picture->channels) channel.values.assign(64 * 32, 0.1f);
  // A bright patch right of the middle column, above the horizon: towards −z turned to +x, up.
  for (int y = 8; y < 10; ++y)
    for (int x = 40; x < 42; ++x) picture->channels[0].values[y * 64 + x] = 100;
  EnvironmentLight sky;
  sky.image = picture;
  sky.scale = Rgb(1, 2, 1);
  const double longitude = 2 * pi * (41.0 / 64 - 0.5), polar = pi * 9.0 / 32;
  const Vec3 patch(std::sin(polar) * std::sin(longitude), std::cos(polar), -std::sin(polar) * std::cos(longitude));
  EXPECT_NEAR(radiance(sky, patch)[0], 100, 1);
  EXPECT_NEAR(radiance(sky, -patch)[0], 0.1, 1e-5);
  EXPECT_NEAR(radiance(sky, -patch)[1], 0.2, 1e-5);

  const auto lights = directional_lights(sky, 128);
  EXPECT_LE(lights.size(), 128u);
  Rgb total = Rgb::Zero();
  for (const DirectionalLight& light : lights) total += light.irradiance;
  EXPECT_NEAR(total[1], 4 * pi * 0.2, 1e-3);
  for (const Vec3& n : {patch, Vec3(0, 1, 0), Vec3(1, 0, 0)}) {
    const Rgb expected = brute_force_irradiance(sky, n), found = irradiance(lights, n);
    for (int k = 0; k < 3; ++k) EXPECT_NEAR(found[k], expected[k], 0.05 * expected[k]);
  }
  picture->channels[2].values[5] = -1;
  EXPECT_THROW(directional_lights(sky, 16), InputError);
  picture->channels.pop_back();
  EXPECT_THROW(directional_lights(sky, 16), InputError);
}

TEST(Lights, PicturesOfFewPixelsStandForAllDirections) {
  for (const Vec3i size : {Vec3i(1, 1, 0), Vec3i(2, 1, 0), Vec3i(1, 3, 0), Vec3i(5, 3, 0)}) {
    auto picture = std::make_shared<Image>();
    picture->width = size.x();
    picture->height = size.y();
    for (const char* name : {"R", "G", "B"}) {
      Image::Channel& channel = picture->add(name);
      for (std::size_t i = 0; i < channel.values.size(); ++i) channel.values[i] = 1 + static_cast<float>(i % 4);
    }
    EnvironmentLight environment;
    environment.image = picture;
    const std::vector<DirectionalLight> lights = directional_lights(environment, 256);
    EXPECT_GT(lights.size(), 100u);
    for (const Vec3 normal : {Vec3(0, 1, 0), Vec3(0, -1, 0), Vec3(1, 0, 0), Vec3(0, 0, 1), Vec3(0, 0, -1)}) {
      const float wanted = brute_force_irradiance(environment, normal)[1];
      EXPECT_NEAR(irradiance(lights, normal)[1], wanted, 0.03 * wanted)
          << size.transpose() << ", " << normal.transpose();
    }
  }
}

TEST(Lights, BeamsFollowTheirLaws) {
  const IncidentBeam sun = incident_beam(DirectionalLight{Vec3(0, -2, 0), Rgb(1, 2, 3)}, Vec3(7, 7, 7));
  EXPECT_EQ(sun.direction, Vec3(0, 1, 0));
  EXPECT_TRUE(std::isinf(sun.distance));
  const IncidentBeam bulb = incident_beam(PointLight{Vec3(0, 0, 4), Rgb(8, 16, 32)}, Vec3::Zero());
  EXPECT_EQ(bulb.direction, Vec3(0, 0, 1));
  EXPECT_EQ(bulb.distance, 4);
  EXPECT_FLOAT_EQ(bulb.irradiance[1], 1);
  EnvironmentLight black;
  EXPECT_EQ(simple_lights({DirectionalLight{}, PointLight{}, black}, 64).size(), 2u);
  // A ray that meets its front sees it, another does not.
  const AreaLight panel{Vec3(0, 0, 5), Vec3(0, 0, -1), Vec3(0, 1, 0), 2, 6, Rgb(1, 2, 3)};
  EXPECT_EQ(radiance(panel, Vec3::Zero(), Vec3(0, 0.4, 1).normalized())[1], 2);
  EXPECT_EQ(radiance(panel, Vec3::Zero(), Vec3(0.4, 0, 1).normalized())[1], 0);
  EXPECT_EQ(radiance(panel, Vec3::Zero(), Vec3(0, 0, -1))[1], 0);
  EXPECT_EQ(radiance(panel, Vec3(0, 0, 9), Vec3(0, 0, -1))[1], 0);
  EXPECT_EQ(radiance(panel, Vec3::Zero(), Vec3(0, 0, 1), 4)[1], 0);
  // A rectangle's patches: together its power, each dark behind it.
  const AreaLight area{Vec3(0, 0, 5), Vec3(0, 0, -1), Vec3(0, 1, 0.5), 2, 6, Rgb(1, 2, 3)};
  const std::vector<PatchLight> patches = patch_lights(area, 48);
  EXPECT_EQ(patches.size(), 48u);
  Rgb straight = Rgb::Zero(), behind = Rgb::Zero(), aside = Rgb::Zero();
  Vec3 reach = Vec3::Zero();
  for (const PatchLight& patch : patches) {
    straight += incident_beam(patch, Vec3(0, 0, -995)).irradiance;
    behind += incident_beam(patch, Vec3(0, 1, 9)).irradiance;
    aside += incident_beam(patch, Vec3(600, 0, -795)).irradiance;
    reach = reach.cwiseMax(patch.position.cwiseAbs());
  }
  EXPECT_NEAR(straight[1], 2 * 12 / 1e6, 1e-9);
  EXPECT_NEAR(aside[1], 0.8 * 2 * 12 / 1e6, 1e-9);
  EXPECT_EQ(behind.sum(), 0);
  EXPECT_NEAR(reach.x(), 1 - 0.25, 1e-12);  // the middles of patches half a millimetre wide
  EXPECT_NEAR(reach.y(), 3 - 0.25, 1e-12);
}

}  // namespace
}  // namespace shellgrid
