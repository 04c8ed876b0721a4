// SPDX-License-Identifier: AGPL-3.0-or-later
// Reflection of unpolarised light at a smooth dielectric surface, and its averages over diffuse light.
#pragma once

namespace shellgrid {

// Fresnel reflectance of unpolarised light that meets a surface at the angle whose cosine is
// `cos_incident` (0 … 1). `relative_ior` is the index of the side it would go to over that of the side
// it comes from; below 1 it returns 1 beyond the critical angle.
double fresnel_reflectance(double cos_incident, double relative_ior);

// F_t: the share of light from outside that passes into an object of index `ior` (inside over outside),
// and equally of light from inside that leaves at the outer angle `cos_outside`.
double fresnel_transmittance(double cos_outside, double ior);

// Averages of the internal reflectance R(μ), μ the cosine inside.
struct DiffuseFresnel {
  double fluence_reflectance = 0;  // R_φ = ∫₀¹ 2μ R dμ
  double current_reflectance = 0;  // R_j = ∫₀¹ 3μ² R dμ
  double boundary_factor = 1;      // C = (1 + R_j) / (1 − R_φ)
  double exit_normalization = 1;   // ∫₀¹ 2μ F_t dμ, μ the cosine outside: that of L = M F_t / (π ·)
};

// Integrates the Fresnel equations, to about 1e-12. Source: PHYSICS D2. `ior` ≥ 1. Throws: InputError.
DiffuseFresnel diffuse_fresnel(double ior);

// Jensen's polynomial F_dr, about 10 % high in C; for the papers' dipole. Deviates from the print of the
// image-space paper, whose constant .0668 is a misprint for .668. Source: [Jensen2001 §2.1].
double polynomial_diffuse_reflectance(double ior);

// C = (1 + F_dr) / (1 − F_dr) with that polynomial. Source: [Diffusion eq. 2].
double polynomial_boundary_factor(double ior);

}  // namespace shellgrid
