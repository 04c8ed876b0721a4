// SPDX-License-Identifier: AGPL-3.0-or-later
#pragma once
#include "meshing/core/material.h"

namespace shellgrid {

// Share of light that a half-space returns, by the dipole's total reflectance
// R_d = (α'/2)(1 + e^{−(4/3) A √(3(1−α'))}) e^{−√(3(1−α'))}, A = (1 + F_dr)/(1 − F_dr).
// Source: [JensenBuhler2002], [STF §5.1]; F_dr's constant is 0.668.
// reduced_albedo: α', 0 … 1; ior ≥ 1. Returns 0 … 1, rising with α'.
double diffuse_reflectance(double reduced_albedo, double ior);

// The reduced albedo whose diffuse reflectance is `reflectance` (0 … 1), to 1e-9: how voxel colours become albedos.
// Source: [STF §5.1].
double reduced_albedo_of_reflectance(double reflectance, double ior);

// The colour that a half-space of this material shows under white light, linear RGB; black in free space.
Rgb diffuse_color(const Material& material, double ior);

// Linear 0 … 1 as an sRGB code value 0 … 255.
Rgb display_color(const Rgb& linear);

}  // namespace shellgrid
