// SPDX-License-Identifier: AGPL-3.0-or-later
#include "solvers/render/tone_map.h"

#include <algorithm>
#include <cmath>

#include "meshing/core/error.h"

namespace shellgrid {
namespace {

// Source: [Narkowicz2015], fit of the ACES reference rendering transform.
double filmic(double x) { return std::clamp(x * (2.51 * x + 0.03) / (x * (2.43 * x + 0.59) + 0.14), 0.0, 1.0); }

double encode_srgb(double x) { return x <= 0.0031308 ? 12.92 * x : 1.055 * std::pow(x, 1 / 2.4) - 0.055; }

const std::vector<float>& layer(const Image& image, const char* name) {
  const Image::Channel* channel = image.find(name);
  if (!channel) throw InputError(std::string("the picture has no layer ") + name);
  return channel->values;
}

}  // namespace

double automatic_exposure(const Image& image) {
  const auto &r = layer(image, "R"), &g = layer(image, "G"), &b = layer(image, "B");
  const Image::Channel* alpha = image.find("A");
  std::vector<float> values;
  for (const bool object_only : {true, false}) {
    for (std::size_t i = 0; i < r.size(); ++i)
      if (!object_only || (alpha && alpha->values[i] > 0.5f))
        values.push_back(0.2126f * r[i] + 0.7152f * g[i] + 0.0722f * b[i]);
    if (!values.empty()) break;
  }
  if (values.empty()) return 0;
  auto nth = values.begin() + static_cast<std::ptrdiff_t>(0.98 * (values.size() - 1));
  std::nth_element(values.begin(), nth, values.end());
  constexpr double filmic_at = 0.63;  // filmic(0.63) = 0.69
  return *nth > 0 ? std::log2(filmic_at / *nth) : 0;
}

std::vector<std::uint8_t> tone_map(const Image& image, double exposure, ToneCurve curve) {
  static constexpr int bayer[4][4] = {{0, 8, 2, 10}, {12, 4, 14, 6}, {3, 11, 1, 9}, {15, 7, 13, 5}};
  const double scale = std::exp2(exposure);
  std::vector<std::uint8_t> bytes(static_cast<std::size_t>(image.width) * image.height * 3);
  const char* names[3] = {"R", "G", "B"};
  for (int k = 0; k < 3; ++k) {
    const auto& values = layer(image, names[k]);
    for (int y = 0; y < image.height; ++y)
      for (int x = 0; x < image.width; ++x) {
        const std::size_t i = static_cast<std::size_t>(y) * image.width + x;
        const double light = scale * std::max(0.0f, values[i]);
        const double shown = curve == ToneCurve::filmic ? filmic(light) : std::min(light, 1.0);
        const double level = 255 * encode_srgb(shown) + (bayer[y & 3][(x + k) & 3] + 0.5) / 16;
        bytes[3 * i + k] = static_cast<std::uint8_t>(std::clamp(level, 0.0, 255.0));
      }
  }
  return bytes;
}

}  // namespace shellgrid
