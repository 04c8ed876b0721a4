// SPDX-License-Identifier: AGPL-3.0-or-later
// The base volume as light sees it: a block of voxels that repeats along x and y.
#pragma once
#include <cstdint>
#include <vector>

#include "meshing/core/material.h"
#include "meshing/core/vec.h"

namespace shellgrid {

// Voxel (x, y, z) is stored at (z·n_y + y)·n_x + x and covers [x, x+1)×[y, y+1)×[z, z+1) voxels; z is depth, 0 on top.
// Source: [STF §4].
struct BaseVolume {
  Vec3i size = Vec3i::Zero();
  double voxel = 1;                                   // edge d_0, mm
  double ior = 1;                                     // inside over outside
  std::vector<float> surface_ior;                     // per voxel, 0 where `ior` holds; or none
  std::vector<Vec3f> extinction, albedo, anisotropy;  // per voxel: σ_t mm⁻¹, 0 … 1, (−1, 1)
  std::vector<std::uint8_t> free;                     // 1: space outside of the matter

  std::size_t voxel_count() const { return static_cast<std::size_t>(size.x()) * size.y() * size.z(); }
  std::size_t texel_count() const { return static_cast<std::size_t>(size.x()) * size.y(); }
  std::size_t index(int x, int y, int z) const { return (static_cast<std::size_t>(z) * size.y() + y) * size.x() + x; }
};

}  // namespace shellgrid
