// SPDX-License-Identifier: AGPL-3.0-or-later
#include "synthesis/sample_symmetry.h"

#include <gtest/gtest.h>

#include <cmath>
#include <functional>

#include "meshing/core/random.h"
#include "synthesis/sample_layers.h"
#include "synthesis/texton_set.h"
#include "tests/synthesis/synthesis_shapes.h"

namespace shellgrid {
namespace {

RowMatrixf map_of(int width, int height, const std::function<float(int, int)>& value) {
  RowMatrixf maps(width * height, 1);
  for (int y = 0; y < height; ++y)
    for (int x = 0; x < width; ++x) maps(y * width + x, 0) = value(x, y);
  return maps;
}

float noise(int x, int y, std::uint64_t seed) { return static_cast<float>(to_unit(hash64(seed, x, y))); }

TEST(SampleSymmetry, StripesLookAlikeAfterAHalfTurnOnly) {
  for (bool across : {false, true}) {
    const RowMatrixf maps = map_of(
        64, 64, [&](int x, int y) { return static_cast<float>((across ? y : x) / 4 % 2) + 0.2f * noise(x, y, 1); });
    EXPECT_EQ(find_symmetry(maps, 64, 64, 1).symmetry, 2);
  }
  // Wavy ones of uneven width too.
  const RowMatrixf wavy = map_of(96, 64, [](int x, int y) {
    return static_cast<float>(std::sin(2 * M_PI * (5 * y / 64.0 + 0.15 * std::sin(2 * M_PI * 2 * x / 96.0)))) +
           0.3f * noise(x / 4, y, 2);
  });
  EXPECT_EQ(find_symmetry(wavy, 96, 64, 1).symmetry, 2);
}

TEST(SampleSymmetry, ChequersSpotsAndNoiseLookAlikeAfterQuarterTurns) {
  const RowMatrixf chequers =
      map_of(64, 64, [](int x, int y) { return static_cast<float>((x / 8 + y / 8) % 2) + 0.2f * noise(x, y, 3); });
  EXPECT_EQ(find_symmetry(chequers, 64, 64, 1).symmetry, 4);
  EXPECT_EQ(find_symmetry(map_of(48, 80, [](int x, int y) { return noise(x, y, 4); }), 48, 80, 1).symmetry, 4);
  EXPECT_EQ(find_symmetry(map_of(32, 32, [](int, int) { return 1.0f; }), 32, 32, 1).symmetry, 4);
}

TEST(SampleSymmetry, WhatHasATopHasNone) {
  // Ramps that rise slowly and fall at once, and arrow heads.
  const RowMatrixf ramps =
      map_of(64, 64, [](int x, int y) { return static_cast<float>(x % 16) / 16 + 0.05f * noise(x, y, 5); });
  EXPECT_EQ(find_symmetry(ramps, 64, 64, 1).symmetry, 1);
  const RowMatrixf arrows = map_of(64, 64, [](int x, int y) {
    const int i = x % 16, j = (y + x / 16 * 8) % 16;
    return static_cast<float>(i < 12 && std::abs(j - 8) * 2 < i) + 0.05f * noise(x, y, 6);
  });
  EXPECT_EQ(find_symmetry(arrows, 64, 64, 1).symmetry, 1);
}

TEST(SampleSymmetry, TextonsRecogniseTheSymmetryThatAllSamplesHave) {
  const MaterialSample spots = make_procedural_sample(testing::spots(48)),
                       wood = make_procedural_sample(testing::wood(48));
  TextonOptions options;
  options.symmetry = 0;
  options.texton_count = 20;
  EXPECT_EQ(make_textons(spots, options).layers.symmetry, 4);
  EXPECT_EQ(make_textons(wood, options).layers.symmetry, 2);
  TextonStatistics statistics;
  EXPECT_EQ(make_textons({&spots, &wood}, options, &statistics).layers.symmetry, 2);
  ASSERT_EQ(statistics.symmetry.size(), 2u);
  EXPECT_EQ(statistics.symmetry[0].symmetry, 4);
  options.symmetry = 1;
  EXPECT_EQ(make_textons(spots, options).layers.symmetry, 1);
}

TEST(SampleLayers, TurnsComeBackAndTextelsGoWithTheirPlaces) {
  for (int symmetry : {2, 4}) {
    const SampleLayers layers = SampleLayers::make({{8, 5}, {3, 7}}, symmetry);
    EXPECT_EQ(layers.size(), 2 * symmetry);
    EXPECT_EQ(layers.texel_count(), symmetry * layers.base_texel_count());
    for (int layer = 0; layer < layers.size(); ++layer)
      for (int t = 0; t < layers[layer].texel_count(); ++t) {
        const std::int32_t texel = layers[layer].first + t;
        ASSERT_EQ(layers.layer_of(texel), layer);
        ASSERT_EQ(layers.turned_texel(texel, symmetry), texel);
        ASSERT_EQ(layers.turned_texel(layers.turned_texel(texel, 1), -1), texel);
      }
    // A step to the right of the sample is a step along the turned layer's own axis.
    const LayerPlace start{1, Vec2f(1.25f, 2.5f)}, right{1, Vec2f(2.25f, 2.5f)};
    for (int step = 0; step < symmetry; ++step) {
      const LayerPlace a = layers.turned(start, step), b = layers.turned(right, step);
      const double angle = 2 * M_PI * step / symmetry;
      EXPECT_NEAR((b.at - a.at).x(), std::cos(angle), 1e-5);
      EXPECT_NEAR((b.at - a.at).y(), std::sin(angle), 1e-5);
    }
  }
}

}  // namespace
}  // namespace shellgrid
