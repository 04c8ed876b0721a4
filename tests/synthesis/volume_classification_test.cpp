// SPDX-License-Identifier: AGPL-3.0-or-later
#include "synthesis/volume_classification.h"

#include <gtest/gtest.h>

#include <cmath>
#include <numbers>

#include "meshing/core/error.h"
#include "synthesis/sample_check.h"
#include "synthesis/sample_resize.h"
#include "tests/synthesis/synthesis_shapes.h"

namespace shellgrid {
namespace {

using testing::marble_body;
using testing::marble_vein;
using testing::material;

// Values at the middles of the cells of a box.
template <class Value>
ScalarVolume measured(const Vec3i& size, const Vec3& spacing, const Value& value) {
  ScalarVolume volume;
  volume.size = size;
  volume.spacing = spacing;
  for (int z = 0; z < size.z(); ++z)
    for (int y = 0; y < size.y(); ++y)
      for (int x = 0; x < size.x(); ++x)
        volume.values.push_back(static_cast<float>(value(Vec3(x + 0.5, y + 0.5, z + 0.5).cwiseProduct(spacing))));
  return volume;
}

VoxelClass matter(double value, const Material& m) { return {value, value, m, false}; }
VoxelClass air(double value) { return {value, value, {}, true}; }

TEST(VolumeClassification, CoefficientsAreAveragesByComposition) {
  ClassificationOptions options;
  options.classes = {matter(10, marble_body()), matter(30, marble_vein())};
  const ScalarVolume volume = measured(Vec3i(8, 8, 4), Vec3::Ones(), [](const Vec3& p) { return 10 + 2 * p.x(); });
  const ClassificationResult result = classify_volume(volume, options);
  for (int x = 0; x < 8; ++x) {
    const double share = 2 * (x + 0.5) / 20;
    const Material mixed = result.sample.material(result.sample.index(x, 3, 2));
    for (int c = 0; c < 3; ++c) {
      EXPECT_NEAR(mixed.absorption()[c],
                  (1 - share) * marble_body().absorption()[c] + share * marble_vein().absorption()[c], 1e-5);
      EXPECT_NEAR(mixed.scattering()[c],
                  (1 - share) * marble_body().scattering()[c] + share * marble_vein().scattering()[c], 1e-5);
    }
  }
  EXPECT_NEAR(result.shares[1], 0.4, 1e-4);
}

TEST(VolumeClassification, ValuesBeyondAllClassesBelongToTheLastOnes) {
  ClassificationOptions options;
  options.classes = {matter(10, marble_body()), matter(30, marble_vein())};
  const ScalarVolume volume =
      measured(Vec3i(4, 4, 2), Vec3::Ones(), [](const Vec3& p) { return p.z() < 1 ? -1e6 : 1e6; });
  const MaterialSample sample = classify_volume(volume, options).sample;
  EXPECT_NEAR((sample.material(sample.index(1, 1, 0)).extinction - marble_body().extinction).abs().maxCoeff(), 0, 1e-4);
  EXPECT_NEAR((sample.material(sample.index(1, 1, 1)).extinction - marble_vein().extinction).abs().maxCoeff(), 0, 1e-4);
}

// A blurred wavy top: share of material at a place.
double wavy(const Vec3& p) {
  const double level = 3 + 0.8 * std::sin(2 * std::numbers::pi * p.x() / 12.8);
  return std::clamp(0.5 + (p.z() - level) / 0.8, 0.0, 1.0);
}

TEST(VolumeClassification, TheSurfaceIsTheIsosurfaceWithItsNormals) {
  ClassificationOptions options;
  options.classes = {air(0), matter(200, marble_body())};
  const MaterialSample sample =
      classify_volume(measured(Vec3i(32, 32, 20), Vec3::Constant(0.4), [](const Vec3& p) { return 200 * wavy(p); }),
                      options)
          .sample;
  double worst = 1;
  for (int x = 0; x < 32; ++x) {
    const double at = 0.4 * (x + 0.5),
                 slope = 0.8 * 2 * std::numbers::pi / 12.8 * std::cos(2 * std::numbers::pi * at / 12.8);
    const double level = 3 + 0.8 * std::sin(2 * std::numbers::pi * at / 12.8);
    int first = 0;
    while (sample.kind[sample.index(x, 5, first)] == VoxelKind::free_space) ++first;
    EXPECT_NEAR(0.4 * first, level, 0.21);
    const std::size_t i = sample.index(x, 5, first);
    EXPECT_EQ(sample.kind[i], VoxelKind::surface);
    // Matter at the surface is whole.
    EXPECT_NEAR(sample.extinction[i][0], marble_body().extinction[0], 1e-4);
    const Vec3f outward = Vec3(slope, 0, -1).normalized().cast<float>();
    worst = std::min<double>(worst, sample.normal[i].dot(outward));
  }
  EXPECT_GT(worst, std::cos(6 * std::numbers::pi / 180));
}

TEST(VolumeClassification, BubblesBelowTheOutermostSurfaceAreThinMatterAndCavesAreNot) {
  ClassificationOptions options;
  options.classes = {air(0), matter(200, marble_body())};
  const auto value = [](const Vec3& p) {
    const bool bubble = (p - Vec3(4, 4, 6)).norm() < 1.5;
    const bool cave = (p - Vec3(9, 9, 5)).norm() < 1.5 || (std::hypot(p.x() - 9, p.y() - 9) < 0.8 && p.z() < 5);
    return bubble || cave ? 0.0 : 200.0;
  };
  const ClassificationResult result = classify_volume(measured(Vec3i(32, 32, 24), Vec3::Constant(0.4), value), options);
  const MaterialSample& sample = result.sample;
  const auto at = [&](double x, double y, double z) {
    return sample.index(static_cast<int>(x / 0.4), static_cast<int>(y / 0.4), static_cast<int>(z / 0.4));
  };
  EXPECT_EQ(sample.kind[at(9, 9, 5)], VoxelKind::free_space);
  EXPECT_EQ(sample.kind[at(4, 4, 6)], VoxelKind::interior);
  EXPECT_EQ(sample.extinction[at(4, 4, 6)].norm(), 0);
  EXPECT_GT(result.enclosed_free, 0.3);
}

TEST(VolumeClassification, TracedBordersDoNotSeeTheClassesBetween) {
  // A blurred ball of value 200 in 40, with a class of 120 that is not there.
  ClassificationOptions options;
  options.classes = {matter(40, marble_body()), matter(120, material({1, 1, 1}, {1, 1, 1})),
                     matter(200, marble_vein())};
  const auto value = [](const Vec3& p) {
    return 40 + 160 * std::clamp(0.5 + (3.0 - (p - Vec3(6.4, 6.4, 6.4)).norm()) / 1.2, 0.0, 1.0);
  };
  const ScalarVolume volume = measured(Vec3i(32, 32, 32), Vec3::Constant(0.4), value);
  const std::vector<double> traced = classify_volume(volume, options).shares;
  options.trace_borders = false;
  const std::vector<double> by_value = classify_volume(volume, options).shares;
  const double ball = 4.0 / 3 * std::numbers::pi * 27 / std::pow(12.8, 3);
  EXPECT_GT(by_value[1], 0.3 * ball);
  EXPECT_LT(traced[1], 0.03 * ball);
  EXPECT_NEAR(traced[2], ball, 0.1 * ball);
}

TEST(VolumeClassification, CoarserVoxelsKeepTheAmountOfEachMaterial) {
  ClassificationOptions options;
  options.classes = {matter(10, marble_body()), matter(30, marble_vein())};
  const auto value = [](const Vec3& p) { return 20 + 10 * std::sin(p.x()) * std::sin(p.y()) * std::sin(0.7 * p.z()); };
  const ScalarVolume volume = measured(Vec3i(64, 48, 32), Vec3(0.2, 0.2, 0.3), value);
  const std::vector<double> fine = classify_volume(volume, options).shares;
  options.voxel = 0.8;
  const ClassificationResult coarse = classify_volume(volume, options);
  EXPECT_EQ(coarse.sample.size, Vec3i(16, 12, 12));
  EXPECT_NEAR(coarse.shares[1], fine[1], 0.003);
}

TEST(VolumeClassification, DepthMayRunAlongAnyAxisAndMirrorsTile) {
  ClassificationOptions options;
  options.classes = {matter(0, marble_body()), matter(1, marble_vein())};
  const ScalarVolume volume =
      measured(Vec3i(5, 8, 6), Vec3::Ones(), [](const Vec3& p) { return (p.x() + 5 * p.y() + 40 * p.z()) / 300; });
  options.down = 0, options.descend = false;
  const MaterialSample turned = classify_volume(volume, options).sample;
  ASSERT_EQ(turned.size, Vec3i(8, 6, 5));
  // Depth 0 is x = 4.5; (y, z) become (x, y).
  const double share = (4.5 + 5 * 2.5 + 40 * 1.5) / 300;
  EXPECT_NEAR(turned.material(turned.index(2, 1, 0)).absorption()[0],
              (1 - share) * marble_body().absorption()[0] + share * marble_vein().absorption()[0], 1e-5);
  options.down = 2, options.descend = true, options.mirror = true;
  const MaterialSample mirrored = classify_volume(volume, options).sample;
  EXPECT_EQ(mirrored.size, Vec3i(10, 16, 6));
  const SampleCheck check = check_sample(mirrored);
  EXPECT_LT(check.seam_x, 1e-6);
  EXPECT_LT(check.seam_y, 1e-6);
}

TEST(VolumeClassification, RefusesClassesOutOfOrderAndVolumesWithoutMatter) {
  ClassificationOptions options;
  const ScalarVolume volume = measured(Vec3i(4, 4, 4), Vec3::Ones(), [](const Vec3&) { return 0; });
  EXPECT_THROW(classify_volume(volume, options), InputError);
  options.classes = {matter(30, marble_body()), matter(10, marble_vein())};
  EXPECT_THROW(classify_volume(volume, options), InputError);
  options.classes = {air(0), matter(10, marble_vein())};
  EXPECT_THROW(classify_volume(volume, options), InputError);
  options.classes = {matter(10, marble_vein())};
  options.voxel = 2;
  EXPECT_THROW(classify_volume(volume, options), InputError);
}

TEST(SampleResize, MirrorsTurnNormalsAndRepeatsKeepThem) {
  const MaterialSample bumps = make_procedural_sample(testing::bumps(24));
  const MaterialSample mirrored = mirror_sample(bumps), repeated = repeat_sample(bumps, 2, 3);
  ASSERT_EQ(mirrored.size, Vec3i(48, 48, bumps.size.z()));
  ASSERT_EQ(repeated.size, Vec3i(48, 72, bumps.size.z()));
  for (int z = 0; z < bumps.size.z(); ++z)
    for (int y = 0; y < 24; ++y)
      for (int x = 0; x < 24; ++x) {
        const Vec3f normal = bumps.normal[bumps.index(x, y, z)];
        ASSERT_EQ(mirrored.normal[mirrored.index(47 - x, y, z)], Vec3f(-normal.x(), normal.y(), normal.z()));
        ASSERT_EQ(mirrored.kind[mirrored.index(x, 47 - y, z)], bumps.kind[bumps.index(x, y, z)]);
        ASSERT_EQ(repeated.normal[repeated.index(x + 24, y + 48, z)], normal);
      }
  EXPECT_LT(check_sample(mirrored).seam_x, 1e-6);
}

TEST(SampleResize, MoreLayersContinueTheBottom) {
  const MaterialSample flat = make_procedural_sample(testing::layers(8));
  const MaterialSample deep = with_layers(flat, flat.size.z() + 4), thin = with_layers(flat, 2);
  for (std::size_t i = flat.index(0, 0, flat.size.z() - 1); i < flat.voxel_count(); ++i) {
    EXPECT_EQ(deep.extinction[i + 4 * 64], flat.extinction[i]);
    EXPECT_EQ(deep.kind[i + 4 * 64], VoxelKind::interior);
  }
  EXPECT_EQ(thin.size.z(), 2);
  EXPECT_EQ(thin.kind[0], VoxelKind::surface);
  EXPECT_THROW(crop_sample(flat, Vec3i(4, 0, 0), Vec3i(5, 8, 1)), InputError);
  EXPECT_EQ(crop_sample(flat, Vec3i(4, 1, 2), Vec3i(4, 4, 1)).extinction[5], flat.extinction[flat.index(5, 2, 2)]);
}

}  // namespace
}  // namespace shellgrid
