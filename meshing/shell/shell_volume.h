// SPDX-License-Identifier: AGPL-3.0-or-later
#pragma once
#include "meshing/core/grid_frame.h"
#include "meshing/core/material.h"
#include "meshing/shell/two_level_grid.h"

namespace shellgrid {

// `kind` of a voxel below the shell, where the core is made of voxels too.
constexpr std::int32_t core_voxel_kind = 3;

// The object's material: shell voxels over a core. All grids share one frame and one set of active
// samples. Where a point lies inside the object and its sample is inactive, the core applies.
// Source: [STF §6, fig. 5].
struct ShellVolume {
  GridFrame frame;
  TwoLevelGrid<Vec3f> texture_coordinate;  // (t_u, t_v, d/d_0): texels, texels, depth in voxels (0 at the surface)
  TwoLevelGrid<Vec3f> extinction;          // mm⁻¹, RGB
  TwoLevelGrid<Vec3f> albedo;              // RGB
  TwoLevelGrid<Vec3f> anisotropy;          // RGB
  TwoLevelGrid<Vec3f> normal;              // of the mesostructure surface where `kind` is 2, else zero
  TwoLevelGrid<std::int32_t> kind;  // VoxelKind of synthesis/material_sample.h: 0 free space, 1 interior, 2 surface;
                                    // or core_voxel_kind
  // Relative refractive index of each mesostructure surface voxel; without leaves where all of them have `ior`.
  TwoLevelGrid<float> surface_ior;
  Material core;                   // the homogeneous core
  bool core_interpolated = false;  // the core continues the bottom layer instead; `core` is then its mean
  double thickness = 0;            // of the shell, mm
  double ior = 1;                  // refractive index inside over outside
};

}  // namespace shellgrid
