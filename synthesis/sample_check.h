// SPDX-License-Identifier: AGPL-3.0-or-later
#pragma once
#include <string>
#include <vector>

#include "synthesis/material_sample.h"

namespace shellgrid {

// What a base volume must satisfy. Source: [STF §5.2]. Mean free paths are those of the mean coefficients of all
// material voxels, so each material weighs as much as it fills.
struct SampleCheck {
  Rgb diffuse_mean_free_path = Rgb::Zero();  // ℓ_d = 1/√(3 σ_a σ_t'), mm; infinite without absorption
  Rgb mean_free_path = Rgb::Zero();          // 1/σ_t, mm
  double mesostructure_depth = 0;            // mm from the top to the deepest free voxel's bottom
  // Mean step across the wrap-around over the largest mean step between neighbours inside; at most about 1 if tilable.
  double seam_x = 0, seam_y = 0;
  double free_share = 0;  // of voxels
  Vec3i least_size =
      Vec3i::Zero();  // n_x, n_y, n_z that would do with these mean free paths; 0 where they are infinite
  bool tilable() const { return seam_x <= most_seam && seam_y <= most_seam; }
  static constexpr double most_seam = 1.5;
  std::vector<std::string> complaints;  // each says what fails and which size would do; empty if nothing fails
};

// Throws: InputError for a number that is negative where it must not be, not finite or out of range; names the voxel.
void check_coefficients(const MaterialSample& sample);

// Throws: InputError for coefficients that are negative or not finite, albedo or anisotropy out of range, a sample
// without material.
SampleCheck check_sample(const MaterialSample& sample);

// Mean coefficients of the bottom layer: the homogeneous core below the shell. Source: [STF §5.1].
// Throws: InputError where the bottom layer holds no material.
Material bottom_layer_mean(const MaterialSample& sample);

}  // namespace shellgrid
