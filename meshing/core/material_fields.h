// SPDX-License-Identifier: AGPL-3.0-or-later
// What of a material may be averaged: sums of places' matter keep these, not albedo or anisotropy.
#pragma once
#include "meshing/core/material.h"

namespace shellgrid {

using MaterialFields = Eigen::Array<double, 9, 1>;  // σ_a, σ_s, σ_s g of three channels

inline MaterialFields fields_of(const Material& m) {
  MaterialFields f;
  f << m.absorption().max(0.0f).cast<double>(), m.scattering().cast<double>(),
      (m.scattering() * m.anisotropy).cast<double>();
  return f;
}

inline Material material_of(const MaterialFields& f) {
  const Rgb scattering = f.segment<3>(3).cast<float>();
  const Rgb turned = f.segment<3>(6).cast<float>();
  Material m = Material::from_absorption_scattering(f.segment<3>(0).cast<float>(), scattering,
                                                    (scattering > 0).select(turned / scattering, Rgb::Zero()));
  m.albedo = m.albedo.min(1.0f);
  return m;
}

}  // namespace shellgrid
