// SPDX-License-Identifier: AGPL-3.0-or-later
#pragma once
#include "meshing/core/vec.h"

namespace shellgrid {

// Optical coefficients of one place, per colour channel.
struct Material {
  Rgb extinction = Rgb::Zero();  // σ_t = σ_a + σ_s, mm⁻¹
  Rgb albedo = Rgb::Zero();      // σ_s / σ_t, 0 … 1
  Rgb anisotropy = Rgb::Zero();  // g, mean cosine of Henyey–Greenstein, −1 … 1

  Rgb scattering() const { return albedo * extinction; }
  Rgb absorption() const { return extinction - scattering(); }
  Rgb reduced_scattering() const { return scattering() * (1 - anisotropy); }
  Rgb reduced_extinction() const { return absorption() + reduced_scattering(); }
  Rgb reduced_albedo() const { return reduced_scattering() / reduced_extinction(); }
  // D = 1/(3 σ_t'), mm.
  Rgb diffusion_coefficient() const { return 1 / (3 * reduced_extinction()); }
  // Effective transport coefficient σ_tr = √(3 σ_a σ_t'), mm⁻¹; 1/σ_tr is the diffuse mean free path.
  Rgb transport_coefficient() const { return (3 * absorption() * reduced_extinction()).sqrt(); }

  static Material from_absorption_scattering(const Rgb& absorption, const Rgb& scattering, const Rgb& anisotropy) {
    Material m;
    m.extinction = absorption + scattering;
    m.albedo = (m.extinction > 0).select(scattering / m.extinction, Rgb::Zero());
    m.anisotropy = anisotropy;
    return m;
  }
};

}  // namespace shellgrid
