// SPDX-License-Identifier: AGPL-3.0-or-later
// Solutions of D1 with D2 on paper, to test the grids against. One channel; lengths mm, coefficients mm⁻¹.
#pragma once

namespace shellgrid {

// Absorption and reduced scattering of one material.
struct DiffusionCoefficients {
  double absorption = 0;
  double reduced_scattering = 1;

  double diffusion() const { return 1 / (3 * (absorption + reduced_scattering)); }  // D, mm
  double decay() const;                                                             // k = √(σ_a / D), mm⁻¹
};

// A slab 0 ≤ z ≤ thickness under irradiance q at z = 0 and at z = thickness. Source: PHYSICS, closed forms.
struct SlabSolution {
  SlabSolution(const DiffusionCoefficients& material, double thickness, double ior, double irradiance_at_zero,
               double irradiance_at_thickness);
  double fluence(double z) const;
  double exitance_at_zero = 0, exitance_at_thickness = 0;  // M of D3

 private:
  double decay_, thickness_, a_, b_;
};

// The same slab lit through z = 0 by a beam of the power `irradiance` per area along z that has passed the surface and
// becomes diffuse at its first collision: q = 0, Q = σ_s' e^{−σ_t' z}. The beam's mirror image at the far side is left
// out. Source: PHYSICS "Where light enters".
struct BeamSlabSolution {
  BeamSlabSolution(const DiffusionCoefficients& material, double thickness, double ior, double irradiance);
  double fluence(double z) const;  // of the diffuse light
  double exitance_at_zero = 0, exitance_at_thickness = 0;

 private:
  double decay_, extinction_, thickness_, a_, b_, particular_;
};

// A ball under uniform irradiance.
struct SphereSolution {
  SphereSolution(const DiffusionCoefficients& material, double radius, double ior, double irradiance);
  double fluence(double r) const;
  double exitance = 0;

 private:
  double decay_, scale_, radius_;
};

// A ball of two materials that meet at the radius `interface`, under uniform irradiance.
struct TwoLayerSphereSolution {
  TwoLayerSphereSolution(const DiffusionCoefficients& inner, const DiffusionCoefficients& outer, double interface,
                         double radius, double ior, double irradiance);
  double fluence(double r) const;
  double exitance = 0;

 private:
  double inner_decay_, outer_decay_, interface_, radius_, inner_scale_, growing_, falling_;
};

// Jensen's dipole: diffuse reflectance per area at the distance r of a half-space lit in a point, mm⁻².
// Source: [Jensen2001 eq. 4]; C after the polynomial.
double dipole_reflectance(const DiffusionCoefficients& material, double ior, double r);

// Its integral over the plane. Source: [Jensen2001 §2.4].
double dipole_total_reflectance(double reduced_albedo, double ior);

}  // namespace shellgrid
