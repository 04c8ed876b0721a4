// SPDX-License-Identifier: AGPL-3.0-or-later
// The shell texture function: how light from any direction reaches each voxel of the base volume.
#pragma once
#include <cmath>
#include <numbers>
#include <vector>

#include "meshing/core/vec.h"
#include "solvers/shell_texture/irradiance_kernels.h"

namespace shellgrid {

// Directions towards the light over the upper hemisphere, in rings of equal steps of elevation; then the light from
// below. Source: [STF §5.2] (72 = 6×12).
struct LightDirections {
  int rings = 6, turns = 12;

  int count() const { return rings * turns; }
  int back() const { return count(); }  // number of the light from below
  // In the sample's frame: x and y along the texture, z up, out of the matter.
  Vec3 direction(int l) const {
    const double polar = (l / turns + 0.5) * std::numbers::pi / (2 * rings);
    const double azimuth = (l % turns) * 2 * std::numbers::pi / turns;
    return {std::sin(polar) * std::cos(azimuth), std::sin(polar) * std::sin(azimuth), std::cos(polar)};
  }
};

// Share of matter from which on a voxel has values: of less the share itself is known too badly.
constexpr float least_matter = 0.02f;

// Fluence for light of unit irradiance on a plane across its direction: of light that was only refracted (I_s), and of
// light that was scattered or mirrored (I_m). The light from below is the mean over the lower hemisphere's directions,
// all of it in I_m: for radiance L from below the fluence is 2π L I_m(ω_b). Source: [STF eq. 2].
struct ShellTexture {
  Vec3i size = Vec3i::Zero();
  double voxel = 1;  // mm
  LightDirections directions;
  std::vector<Vec3f> single;    // voxels × directions: at direction · voxels + voxel
  std::vector<Vec3f> multiple;  // voxels × (directions + 1)
  std::vector<float> error;     // as `multiple`: relative error of the channels' mean, 1 σ; −1 unknown
  std::vector<float> matter;    // per voxel: share of it that is matter
  // Texels × (directions + 1): irradiance that passes down through the bottom, for unit irradiance across the
  // direction; from below for unit irradiance on the bottom, what comes back. At direction · texels + texel.
  std::vector<Vec3f> below;
  IrradianceKernels kernels;  // may be none

  std::size_t voxel_count() const { return matter.size(); }
  std::size_t texel_count() const { return static_cast<std::size_t>(size.x()) * size.y(); }
  std::size_t at(int direction, std::size_t voxel_index) const { return direction * voxel_count() + voxel_index; }
};

}  // namespace shellgrid
