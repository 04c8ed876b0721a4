// SPDX-License-Identifier: AGPL-3.0-or-later
#pragma once
#include <vector>

#include "synthesis/half_space_reflectance.h"
#include "synthesis/material_sample.h"
#include "synthesis/solid_synthesis.h"

namespace shellgrid {

// How colours become matter.
struct ColorMaterial {
  Rgb extinction = Rgb::Ones();  // σ_t everywhere, mm⁻¹
  Rgb anisotropy = Rgb::Zero();
  ReflectanceModel model = ReflectanceModel::transport;
  double brightest = 0.95;  // brighter colours count as this, so that all of them absorb something
};

// Matter that shows this diffuse reflectance (linear, 0 … 1).
Material material_of_color(const Rgb& color, const ColorMaterial& matter, const ReflectanceInversion& inversion);

// A solid block of matter: an albedo for each voxel's colour. Source: [STF §5.1].
MaterialSample material_of_colors(const Vec3i& size, const std::vector<Rgb>& colors, double voxel, double ior,
                                  const ColorMaterial& matter);

// The slices of a sample along all three axes as views: what they look like and how they extinguish. Throws: InputError
// where it holds free space, which a solid does not.
SolidExemplar exemplar_of_sample(const MaterialSample& sample);

// A solid of the sample's voxels.
MaterialSample material_of_texels(const MaterialSample& sample, const SolidTexture& solid);

}  // namespace shellgrid
