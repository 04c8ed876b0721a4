// SPDX-License-Identifier: AGPL-3.0-or-later
#pragma once
#include <algorithm>
#include <array>
#include <cmath>
#include <cstdint>
#include <numbers>

namespace shellgrid {

// A false colour whose brightness rises steadily from black at 0 to white at 1, as 8-bit sRGB: a helix around the
// grey diagonal, starting blue, one and a half turns. Source: [Green2011].
inline std::array<std::uint8_t, 3> false_colour(double value) {
  const double x = value > 0 ? std::min(value, 1.0) : 0;  // NaN is black
  const double angle = 2 * std::numbers::pi * (0.5 / 3 + 1 - 1.5 * x);
  const double amplitude = x * (1 - x) / 2;
  const double u = amplitude * std::cos(angle), v = amplitude * std::sin(angle);
  const std::array<double, 3> rgb{x - 0.14861 * u + 1.78277 * v, x - 0.29227 * u - 0.90649 * v, x + 1.97294 * u};
  std::array<std::uint8_t, 3> bytes;
  for (std::size_t c = 0; c < 3; ++c)
    bytes[c] = static_cast<std::uint8_t>(std::lround(255 * std::clamp(rgb[c], 0.0, 1.0)));
  return bytes;
}

}  // namespace shellgrid
