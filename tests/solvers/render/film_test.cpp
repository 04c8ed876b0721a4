// SPDX-License-Identifier: AGPL-3.0-or-later
#include "solvers/render/film.h"

#include <gtest/gtest.h>

#include <cmath>

#include "meshing/core/random.h"
#include "solvers/render/tone_map.h"

namespace shellgrid {
namespace {

TEST(Film, PositionsFollowTheTentFilter) {
  double mean = 0, square = 0;
  int count = 0;
  for (std::uint64_t pixel = 0; pixel < 200; ++pixel)
    for (int i = 0; i < 16; ++i) {
      const Vec2 at = Film::position(7, 3, hash64(pixel), i) - Vec2(7.5, 3.5);
      ASSERT_LE(at.cwiseAbs().maxCoeff(), 1);
      mean += at.x() + at.y();
      square += at.squaredNorm();
      count += 2;
    }
  EXPECT_NEAR(mean / count, 0, 0.01);
  EXPECT_NEAR(square / count, 1.0 / 6, 0.01);  // the tent's variance
}

TEST(Film, SamplesAreStratified) {
  // The first 4 of a pixel's samples fall into the four quadrants.
  for (std::uint64_t pixel = 0; pixel < 50; ++pixel) {
    int seen = 0;
    for (int i = 0; i < 4; ++i) {
      const Vec2 at = Film::position(0, 0, hash64(pixel), i) - Vec2(0.5, 0.5);
      seen |= 1 << ((at.x() > 0) + 2 * (at.y() > 0));
    }
    EXPECT_EQ(seen, 15);
  }
}

TEST(Film, EdgesAreSmoothAndFlatPartsCheap) {
  Film film(40, 20, {});
  const auto statistics = film.expose([](double x, double) {
    FilmSample sample;
    sample.hit = x < 19;
    if (sample.hit) sample.exitance = Rgb::Ones();
    return sample;
  });
  EXPECT_EQ(statistics.samples + statistics.samples_skipped, 40 * 20 * 16);
  EXPECT_LE(statistics.refined_pixels, 20 * 4);
  EXPECT_GE(statistics.refined_pixels, 20 * 2);
  const Image image = film.develop();
  const auto& alpha = image.find("A")->values;
  for (int y = 0; y < 20; ++y) {
    EXPECT_EQ(alpha[y * 40 + 17], 1);
    EXPECT_NEAR(alpha[y * 40 + 18], 0.875, 0.07);  // ∫ of the tent beyond half a pixel is 1/8
    EXPECT_NEAR(alpha[y * 40 + 19], 0.125, 0.07);
    EXPECT_EQ(alpha[y * 40 + 20], 0);
  }
}

TEST(ToneMap, BlackIsBlackAndTheCurveRises) {
  Image image;
  image.width = 8;
  image.height = 1;
  for (const char* name : {"R", "G", "B"}) {
    auto& channel = image.add(name);
    for (int i = 0; i < 8; ++i) channel.values[i] = i == 0 ? 0 : 0.02f * std::exp2(static_cast<float>(i));
  }
  const auto bytes = tone_map(image, 0, ToneCurve::filmic);
  ASSERT_EQ(bytes.size(), 24u);
  EXPECT_EQ(bytes[0], 0);
  for (int i = 1; i < 8; ++i) EXPECT_GT(bytes[3 * i], bytes[3 * i - 3]);
  const auto linear = tone_map(image, 0, ToneCurve::linear);
  EXPECT_NEAR(linear[3 * 4], 255 * (1.055 * std::pow(0.32, 1 / 2.4) - 0.055), 1.5);
  // Automatic exposure brings the bright end to one level whatever the units.
  const double exposure = automatic_exposure(image);
  for (auto& channel : image.channels)
    for (float& value : channel.values) value *= 1024;
  EXPECT_NEAR(automatic_exposure(image), exposure - 10, 1e-4);
}

}  // namespace
}  // namespace shellgrid
