// SPDX-License-Identifier: AGPL-3.0-or-later
// What happens to light at a smooth boundary between two media.
#pragma once
#include <algorithm>
#include <cmath>

#include "meshing/core/vec.h"
#include "solvers/transport/path_random.h"

namespace shellgrid {

// Light that meets a boundary: the shares that are mirrored and pass, and the cosine beyond it.
struct BoundaryMeeting {
  double reflectance = 0;
  double cosine_beyond = 1;
};

// `cosine` with the normal, 0 … 1; `relative_ior` index beyond over index here. Beyond the critical angle all is
// mirrored. The Fresnel equations for unpolarised light.
inline BoundaryMeeting meet_boundary(double cosine, double relative_ior) {
  const double c = std::clamp(cosine, 0.0, 1.0);
  if (relative_ior == 1) return {0, c};
  const double square = 1 - (1 - c * c) / (relative_ior * relative_ior);
  if (square <= 0 || c <= 0) return {1, 0};
  const double t = std::sqrt(square);
  const double perpendicular = (c - relative_ior * t) / (c + relative_ior * t);
  const double parallel = (relative_ior * c - t) / (relative_ior * c + t);
  return {0.5 * (perpendicular * perpendicular + parallel * parallel), t};
}

// Directions are unit; `normal` points against `direction`, so that cosine = −normal·direction ≥ 0.
inline Vec3 mirrored(const Vec3& direction, const Vec3& normal, double cosine) {
  return (direction + 2 * cosine * normal).normalized();
}
inline Vec3 refracted(const Vec3& direction, const Vec3& normal, double cosine, double cosine_beyond,
                      double relative_ior) {
  return ((direction + cosine * normal) / relative_ior - cosine_beyond * normal).normalized();
}

}  // namespace shellgrid
