// SPDX-License-Identifier: AGPL-3.0-or-later
// The Henyey–Greenstein phase function. Angles are between the directions in which light travels before and after:
// cosine 1 goes straight on.
#pragma once
#include <algorithm>
#include <cmath>
#include <numbers>

#include "meshing/core/vec.h"
#include "solvers/transport/path_random.h"

namespace shellgrid {

// Anisotropies nearer to zero than this scatter evenly.
constexpr double isotropic_below = 1e-6;

// Density of the cosine on [−1, 1]: 2π times the phase function. `anisotropy` in (−1, 1).
// Source: [HenyeyGreenstein1941].
inline double henyey_greenstein(double anisotropy, double cosine) {
  const double g = anisotropy, t = 1 + g * g - 2 * g * cosine;
  return 0.5 * (1 - g * g) / (t * std::sqrt(t));
}

// The cosine below which a share u of the light scatters, u in [0, 1).
inline double henyey_greenstein_cosine(double anisotropy, double u) {
  const double g = anisotropy;
  if (std::abs(g) < isotropic_below) return 2 * u - 1;
  const double t = (1 - g * g) / (1 - g + 2 * g * u);
  return std::clamp((1 + g * g - t * t) / (2 * g), -1.0, 1.0);
}

// A unit direction about `axis` (unit, to rounding): its cosine with it, and its azimuth. Errors of length do not grow.
// Source: the basis of [Duff2017].
inline Vec3 direction_about(const Vec3& axis, double cosine, const CosineSine& azimuth) {
  const double sine = std::sqrt(std::max(0.0, 1 - cosine * cosine));
  const double x = axis.x(), y = axis.y(), z = axis.z(), sign = std::copysign(1.0, z), a = -1 / (sign + z),
               b = x * y * a;
  const double along = sine * azimuth.cosine, across = sine * azimuth.sine;
  const Vec3 d(along * (1 + sign * x * x * a) + across * b + cosine * x,
               along * sign * b + across * (sign + y * y * a) + cosine * y,
               -along * sign * x - across * y + cosine * z);
  return d * (1.5 - 0.5 * d.squaredNorm());
}

// Any direction, all alike.
inline Vec3 even_direction(PathRandom& random) {
  const double z = 2 * random.next() - 1, r = std::sqrt(std::max(0.0, 1 - z * z));
  const CosineSine azimuth = random.azimuth();
  return {r * azimuth.cosine, r * azimuth.sine, z};
}

inline Vec3 scattered(const Vec3& direction, double anisotropy, PathRandom& random) {
  if (std::abs(anisotropy) < isotropic_below) return even_direction(random);
  const double cosine = henyey_greenstein_cosine(anisotropy, random.next());
  return direction_about(direction, cosine, random.azimuth());
}

}  // namespace shellgrid
