// SPDX-License-Identifier: AGPL-3.0-or-later
#include "solvers/render/film.h"

#include <algorithm>
#include <cmath>

#include "meshing/core/parallel.h"
#include "meshing/core/random.h"

namespace shellgrid {
namespace {

constexpr int tile = 16;
constexpr int first_samples = 4;

std::uint32_t reverse_bits(std::uint32_t n) {
  n = (n << 16) | (n >> 16);
  n = ((n & 0x00ff00ffu) << 8) | ((n & 0xff00ff00u) >> 8);
  n = ((n & 0x0f0f0f0fu) << 4) | ((n & 0xf0f0f0f0u) >> 4);
  n = ((n & 0x33333333u) << 2) | ((n & 0xccccccccu) >> 2);
  n = ((n & 0x55555555u) << 1) | ((n & 0xaaaaaaaau) >> 1);
  return n;
}

std::uint32_t sobol_second(std::uint32_t n) {
  std::uint32_t result = 0;
  for (std::uint32_t v = 1u << 31; n; n >>= 1, v ^= v >> 1)
    if (n & 1u) result ^= v;
  return result;
}

// Uniform u in [0, 1) to the tent on (-1, 1).
double tent(double u) { return u < 0.5 ? std::sqrt(2 * u) - 1 : 1 - std::sqrt(2 - 2 * u); }

float luminance(const Rgb& c) { return 0.2126f * c[0] + 0.7152f * c[1] + 0.0722f * c[2]; }

}  // namespace

Vec2 Film::position(int pixel_x, int pixel_y, std::uint64_t pixel_key, int sample_index) {
  const auto n = static_cast<std::uint32_t>(sample_index);
  const std::uint32_t x = reverse_bits(n) ^ static_cast<std::uint32_t>(pixel_key);
  const std::uint32_t y = sobol_second(n) ^ static_cast<std::uint32_t>(pixel_key >> 32);
  return {pixel_x + 0.5 + tent((x + 0.5) * 0x1p-32), pixel_y + 0.5 + tent((y + 0.5) * 0x1p-32)};
}

Film::Film(int width, int height, const Settings& settings)
    : width_(width), height_(height), settings_(settings), pixels_(static_cast<std::size_t>(width) * height) {
  settings_.samples_per_pixel = std::max(1, settings_.samples_per_pixel);
}

void Film::take(int pixel_x, int pixel_y, int first, int last,
                const std::function<FilmSample(double x, double y)>& sample) {
  const std::size_t index = static_cast<std::size_t>(pixel_y) * width_ + pixel_x;
  const std::uint64_t key = hash64(settings_.seed, index);
  Pixel& pixel = pixels_[index];
  for (int i = first; i < last; ++i) {
    const Vec2 at = position(pixel_x, pixel_y, key, i);
    const FilmSample s = sample(at.x(), at.y());
    pixel.exitance += s.exitance;
    pixel.specular += s.specular;
    pixel.backdrop += s.backdrop;
    if (s.hit) {
      pixel.normal += s.normal.cast<float>();
      pixel.depth += s.depth;
      ++pixel.hits;
    }
    const float l = luminance(s.exitance + s.specular + s.backdrop);
    pixel.low = pixel.count == 0 ? l : std::min(pixel.low, l);
    pixel.high = pixel.count == 0 ? l : std::max(pixel.high, l);
    ++pixel.count;
  }
}

bool Film::varies(int pixel_x, int pixel_y, float floor_luminance) const {
  bool any_hit = false, any_miss = false;
  float low = 0, high = 0;
  bool first = true;
  for (int y = std::max(0, pixel_y - 1); y <= std::min(height_ - 1, pixel_y + 1); ++y)
    for (int x = std::max(0, pixel_x - 1); x <= std::min(width_ - 1, pixel_x + 1); ++x) {
      const Pixel& pixel = pixels_[static_cast<std::size_t>(y) * width_ + x];
      any_hit |= pixel.hits > 0;
      any_miss |= pixel.hits < pixel.count;
      low = first ? pixel.low : std::min(low, pixel.low);
      high = first ? pixel.high : std::max(high, pixel.high);
      first = false;
    }
  return (any_hit && any_miss) || (high - low) > settings_.contrast * (high + low + floor_luminance);
}

Film::Statistics Film::expose(const std::function<FilmSample(double x, double y)>& sample, Progress& progress) {
  const int tiles_x = (width_ + tile - 1) / tile, tiles_y = (height_ + tile - 1) / tile;
  const std::size_t tiles = static_cast<std::size_t>(tiles_x) * tiles_y;
  auto for_each_pixel = [&](const auto& body) {
    parallel_for(
        tiles,
        [&](std::size_t t) {
          const int x0 = static_cast<int>(t % tiles_x) * tile, y0 = static_cast<int>(t / tiles_x) * tile;
          for (int y = y0; y < std::min(height_, y0 + tile); ++y)
            for (int x = x0; x < std::min(width_, x0 + tile); ++x) body(x, y);
          progress.advance();
        },
        1);
  };
  const int total = settings_.samples_per_pixel, first = std::min(total, first_samples);
  progress.begin("render", static_cast<long>(tiles) * (total > first ? 2 : 1));
  for_each_pixel([&](int x, int y) { take(x, y, 0, first, sample); });

  std::int64_t refined = 0;
  if (total > first) {
    // Differences far below the picture's mean do not show.
    double mean = 0;
    for (const Pixel& pixel : pixels_) mean += 0.5 * (pixel.low + pixel.high);
    const float floor_luminance = static_cast<float>(0.2 * mean / pixels_.size());
    std::vector<char> refine(pixels_.size(), 0);
    for (int y = 0; y < height_; ++y)
      for (int x = 0; x < width_; ++x)
        if (varies(x, y, floor_luminance)) refine[static_cast<std::size_t>(y) * width_ + x] = 1, ++refined;
    for_each_pixel([&](int x, int y) {
      if (refine[static_cast<std::size_t>(y) * width_ + x]) take(x, y, first, total, sample);
    });
  }
  progress.end();
  Statistics statistics;
  statistics.refined_pixels = refined;
  statistics.samples = static_cast<std::int64_t>(pixels_.size()) * first + refined * (total - first);
  statistics.samples_skipped = static_cast<std::int64_t>(pixels_.size()) * total - statistics.samples;
  return statistics;
}

Image Film::develop() const {
  Image image;
  image.width = width_;
  image.height = height_;
  for (const char* name : {"R", "G", "B", "A", "exitance.R", "exitance.G", "exitance.B", "specular.R", "specular.G",
                           "specular.B", "depth.Z", "normal.X", "normal.Y", "normal.Z"})
    image.add(name);
  for (std::size_t i = 0; i < pixels_.size(); ++i) {
    const Pixel& pixel = pixels_[i];
    if (pixel.count == 0) continue;
    const Rgb exitance = pixel.exitance / static_cast<float>(pixel.count),
              specular = pixel.specular / static_cast<float>(pixel.count),
              beauty = exitance + specular + pixel.backdrop / static_cast<float>(pixel.count);
    for (int k = 0; k < 3; ++k) {
      image.channels[k].values[i] = beauty[k];
      image.channels[4 + k].values[i] = exitance[k];
      image.channels[7 + k].values[i] = specular[k];
    }
    image.channels[3].values[i] = static_cast<float>(pixel.hits) / pixel.count;
    if (pixel.hits == 0) continue;
    image.channels[10].values[i] = static_cast<float>(pixel.depth / pixel.hits);
    const float length = pixel.normal.norm();
    for (int k = 0; k < 3; ++k) image.channels[11 + k].values[i] = length > 0 ? pixel.normal[k] / length : 0;
  }
  return image;
}

}  // namespace shellgrid
