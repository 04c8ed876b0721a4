// SPDX-License-Identifier: AGPL-3.0-or-later
#pragma once
#include <string>
#include <vector>

#include "meshing/core/material.h"

namespace shellgrid {

// A measured material. The measurement gives reduced scattering, so `material` has anisotropy 0.
struct NamedMaterial {
  std::string name;
  Material material;
  double ior;                // as assumed in the measurement
  Rgb measured_reflectance;  // total diffuse reflectance, published beside the coefficients
};

// Twelve materials. Source: [Jensen2001] figure 5.
const std::vector<NamedMaterial>& named_materials();

// Throws: InputError with the nearest known name.
const NamedMaterial& named_material(const std::string& name);

}  // namespace shellgrid
