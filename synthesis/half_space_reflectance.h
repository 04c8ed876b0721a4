// SPDX-License-Identifier: AGPL-3.0-or-later
#pragma once
#include <vector>

#include "meshing/core/material.h"

namespace shellgrid {

// Share of the light that enters a half-space which leaves it again, under the same radiance from all directions
// outside, by exact transport: isotropic scattering, a smooth boundary with Fresnel reflection. To about 1e-5.
// Chandrasekhar's H function gives the reflection of the medium alone, a linear system its play with the boundary.
// Source: [Chandrasekhar1960 §§13, 28, 38].
// reduced_albedo: 0 … 1; ior ≥ 1, inside over outside. Throws: InputError out of these ranges.
double half_space_reflectance(double reduced_albedo, double ior);

enum class ReflectanceModel {
  dipole,    // [JensenBuhler2002]: good where the albedo is high
  transport  // half_space_reflectance
};

// The reduced albedo of matter that shows a given diffuse reflectance: how colours become albedos; and back, how
// albedos look. Source: [STF §5.1].
class ReflectanceInversion {
 public:
  ReflectanceInversion(ReflectanceModel model, double ior);
  // reflectance: 0 … 1; to about 1e-5.
  double reduced_albedo(double reflectance) const;
  Rgb reduced_albedo(const Rgb& reflectance) const;
  // To about 1e-5. reduced_albedo: 0 … 1.
  double reflectance(double reduced_albedo) const;
  // The colour that a half-space of this material shows, linear RGB; black in free space.
  Rgb color(const Material& material) const;

 private:
  ReflectanceModel model_;
  double ior_;
  std::vector<double> reflectances_;  // at albedos 1 − (i/(n − 1))², falling
};

}  // namespace shellgrid
