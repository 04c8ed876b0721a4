// SPDX-License-Identifier: AGPL-3.0-or-later
#include "synthesis/albedo.h"

#include <algorithm>
#include <cmath>

namespace shellgrid {

double diffuse_reflectance(double reduced_albedo, double ior) {
  const double internal_reflectance = ior > 1 ? -1.440 / (ior * ior) + 0.710 / ior + 0.668 + 0.0636 * ior : 0.0;
  const double a = (1 + internal_reflectance) / (1 - internal_reflectance);
  const double root = std::sqrt(3 * std::max(0.0, 1 - reduced_albedo));
  return reduced_albedo / 2 * (1 + std::exp(-4.0 / 3 * a * root)) * std::exp(-root);
}

double reduced_albedo_of_reflectance(double reflectance, double ior) {
  double lower = 0, upper = 1;
  while (upper - lower > 1e-9) {
    const double middle = (lower + upper) / 2;
    (diffuse_reflectance(middle, ior) < reflectance ? lower : upper) = middle;
  }
  return (lower + upper) / 2;
}

Rgb diffuse_color(const Material& material, double ior) {
  Rgb color = Rgb::Zero();
  for (int c = 0; c < 3; ++c) {
    const float scattering = material.reduced_scattering()[c];
    const float extinction = material.reduced_extinction()[c];
    if (extinction > 0) color[c] = static_cast<float>(diffuse_reflectance(scattering / extinction, ior));
  }
  return color;
}

Rgb display_color(const Rgb& linear) {
  return linear.unaryExpr([](float value) {
    const float x = std::clamp(value, 0.0f, 1.0f);
    return 255 * (x <= 0.0031308f ? 12.92f * x : 1.055f * std::pow(x, 1 / 2.4f) - 0.055f);
  });
}

}  // namespace shellgrid
