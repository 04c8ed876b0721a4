// SPDX-License-Identifier: AGPL-3.0-or-later
// The dipole: how far from where light enters a homogeneous half-space it leaves.
#pragma once
#include <array>

#include "meshing/core/material.h"
#include "solvers/dipole/radial_profile.h"

namespace shellgrid {

// Where the light is that a dipole's real source stands for.
enum class DipoleEntry {
  beam,    // refracted straight down: one reduced mean free path deep, [Jensen2001]
  diffuse  // spread evenly over the hemisphere, as it comes out of a shell: two thirds of one
};

// C of D2.
enum class DipoleBoundary {
  integrated,  // from the Fresnel equations
  polynomial   // Jensen's F_dr, about 10 % high: the papers'
};

// One channel's dipole. Source: [Jensen2001 eq. 4], [ImageSpace eq. 2].
// R_d(r) = α'/4π Σ z (1 + σ_tr d) e^{−σ_tr d} / d³ over the depths z of the real and the virtual source, d² = r² + z².
struct Dipole {
  double reduced_albedo = 1;  // α'
  double decay = 0;           // σ_tr, mm⁻¹
  double real_depth = 1;      // z_r, mm
  double virtual_depth = 1;   // z_v, mm, upwards
  double scale = 1;           // a factor on everything

  Dipole() = default;
  // absorption, reduced_scattering: mm⁻¹, their sum above 0; ior ≥ 1. Throws: InputError.
  Dipole(double absorption, double reduced_scattering, double ior, DipoleEntry entry = DipoleEntry::beam,
         DipoleBoundary boundary = DipoleBoundary::integrated);

  double reflectance(double r) const;  // mm⁻²
  double total() const;                // its integral over the plane
};

// What a body returns of diffuse light that enters it, over what a half-space does: by diffusion's partial currents,
// (1 − 2 D L)/(1 + 2 D L), L = −∂φ/∂n / φ at its surface. Of a half-space L is σ_tr, of a ball with the radius r it is
// σ_tr (coth σ_tr r − 1/(σ_tr r)); r is 3 V/A of any body. `radius` in mm, above 0.
double body_return(const Dipole& dipole, double radius);

// Of the three channels of a material.
std::array<Dipole, 3> dipoles(const Material& material, double ior, DipoleEntry entry = DipoleEntry::beam,
                              DipoleBoundary boundary = DipoleBoundary::integrated);

// Ready to be summed over. averaged: see RadialProfile.
RadialProfile dipole_profile(const std::array<Dipole, 3>& channels, double averaged = 0);

}  // namespace shellgrid
