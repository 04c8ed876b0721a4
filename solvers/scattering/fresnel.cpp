// SPDX-License-Identifier: AGPL-3.0-or-later
#include "solvers/scattering/fresnel.h"

#include <algorithm>
#include <cmath>
#include <string>

#include "meshing/core/error.h"

namespace shellgrid {

double fresnel_reflectance(double cos_incident, double relative_ior) {
  const double c = std::clamp(cos_incident, 0.0, 1.0);
  const double cos_transmitted_squared = 1 - (1 - c * c) / (relative_ior * relative_ior);
  if (cos_transmitted_squared <= 0) return relative_ior == 1 && c > 0 ? 0.0 : 1.0;
  const double t = std::sqrt(cos_transmitted_squared);
  if (c == 0 && relative_ior != 1) return 1;
  const double perpendicular = (c - relative_ior * t) / (c + relative_ior * t);
  const double parallel = (relative_ior * c - t) / (relative_ior * c + t);
  return 0.5 * (perpendicular * perpendicular + parallel * parallel);
}

double fresnel_transmittance(double cos_outside, double ior) {
  return cos_outside <= 0 ? 0.0 : 1 - fresnel_reflectance(cos_outside, ior);
}

DiffuseFresnel diffuse_fresnel(double ior) {
  if (!(ior >= 1) || !std::isfinite(ior))
    throw InputError("refractive index " + std::to_string(ior) + ": expected 1 or more (inside over outside)");
  // Integrated over the outer cosine t, in which everything is smooth: μ² = 1 − (1 − t²)/η², μ dμ = t dt / η².
  // Below the critical cosine R = 1. The substitution t = s² tames grazing angles.
  const double critical_squared = 1 - 1 / (ior * ior);
  const double critical = std::sqrt(critical_squared);
  // Gauss–Legendre, 5 points a panel, on s in [0, 1].
  static const double nodes[5] = {-0.906179845938663992797626878299, -0.538469310105683091036314420700, 0,
                                  0.538469310105683091036314420700, 0.906179845938663992797626878299};
  static const double weights[5] = {0.236926885056189087514264040720, 0.478628670499366468041291514836,
                                    0.568888888888888888888888888889, 0.478628670499366468041291514836,
                                    0.236926885056189087514264040720};
  constexpr int panels = 200;
  double fluence = critical_squared, current = critical_squared * critical, exit = 0;
  for (int p = 0; p < panels; ++p)
    for (int k = 0; k < 5; ++k) {
      const double s = (p + 0.5 + 0.5 * nodes[k]) / panels;
      const double t = s * s, dt = 2 * s * 0.5 * weights[k] / panels;
      const double reflectance = fresnel_reflectance(t, ior);
      const double mu = std::sqrt(1 - (1 - t * t) / (ior * ior));
      fluence += 2 * reflectance * t * dt / (ior * ior);
      current += 3 * mu * reflectance * t * dt / (ior * ior);
      exit += 2 * t * (1 - reflectance) * dt;
    }
  return {fluence, current, (1 + current) / (1 - fluence), exit};
}

double polynomial_diffuse_reflectance(double ior) { return -1.440 / (ior * ior) + 0.710 / ior + 0.668 + 0.0636 * ior; }

double polynomial_boundary_factor(double ior) {
  const double f = polynomial_diffuse_reflectance(ior);
  return (1 + f) / (1 - f);
}

}  // namespace shellgrid
