// SPDX-License-Identifier: AGPL-3.0-or-later
#include "solvers/dipole/dipole.h"

#include <cmath>
#include <numbers>

#include "meshing/core/error.h"
#include "solvers/scattering/fresnel.h"

namespace shellgrid {

Dipole::Dipole(double absorption, double reduced_scattering, double ior, DipoleEntry entry, DipoleBoundary boundary) {
  const double extinction = absorption + reduced_scattering;
  if (!(absorption >= 0) || !(reduced_scattering >= 0) || !(extinction > 0) || !std::isfinite(extinction))
    throw InputError("a dipole needs absorption and scattering of at least 0, and one of them above it");
  const double factor =
      boundary == DipoleBoundary::polynomial ? polynomial_boundary_factor(ior) : diffuse_fresnel(ior).boundary_factor;
  reduced_albedo = reduced_scattering / extinction;
  decay = std::sqrt(3 * absorption * extinction);
  real_depth = (entry == DipoleEntry::diffuse ? 2.0 / 3 : 1.0) / extinction;
  virtual_depth = real_depth + 4 * factor / (3 * extinction);
}

double Dipole::reflectance(double r) const {
  const auto source = [&](double depth) {
    const double distance = std::hypot(r, depth);
    return depth * (1 + decay * distance) * std::exp(-decay * distance) / (distance * distance * distance);
  };
  return scale * reduced_albedo / (4 * std::numbers::pi) * (source(real_depth) + source(virtual_depth));
}

double Dipole::total() const {
  return scale * reduced_albedo / 2 * (std::exp(-decay * real_depth) + std::exp(-decay * virtual_depth));
}

double body_return(const Dipole& dipole, double radius) {
  if (!(radius > 0)) throw InputError("a body's size is above 0");
  const double step = 2 * std::sqrt(std::max(0.0, 1 - dipole.reduced_albedo) / 3);  // 2 D σ_tr
  const double x = dipole.decay * radius;
  const double slope = x < 1e-3 ? x / 3 : 1 / std::tanh(x) - 1 / x;
  const auto returned = [](double loss) { return (1 - loss) / (1 + loss); };
  return step < 1 ? returned(step * slope) / returned(step) : 1;
}

std::array<Dipole, 3> dipoles(const Material& material, double ior, DipoleEntry entry, DipoleBoundary boundary) {
  std::array<Dipole, 3> channels;
  for (int c = 0; c < 3; ++c)
    channels[c] = Dipole(material.absorption()[c], material.reduced_scattering()[c], ior, entry, boundary);
  return channels;
}

RadialProfile dipole_profile(const std::array<Dipole, 3>& channels, double averaged) {
  RadialProfile::Channels profile;
  for (int c = 0; c < 3; ++c) {
    profile[c].value = [dipole = channels[c]](double r) { return dipole.reflectance(r); };
    profile[c].decay = channels[c].decay;
    profile[c].width = channels[c].real_depth;
  }
  return RadialProfile(profile, averaged);
}

}  // namespace shellgrid
