// SPDX-License-Identifier: AGPL-3.0-or-later
#pragma once
#include <cstdint>
#include <string>
#include <vector>

#include "meshing/core/material.h"
#include "meshing/core/vec.h"

namespace shellgrid {

enum class VoxelKind : std::uint8_t { free_space = 0, interior = 1, surface = 2 };

// The base volume V_b: a small tilable block of material. Source: [STF §4].
// Voxel (x, y, z) is stored at (z·n_y + y)·n_x + x. x and y are the texture directions and wrap around; z
// is depth, 0 at the top (the object's surface), growing inwards. The voxel covers
// [x, x+1)×[y, y+1)×[z, z+1) in units of `voxel`.
struct MaterialSample {
  Vec3i size = Vec3i::Zero();                         // n_x, n_y, n_z
  double voxel = 1;                                   // edge d_0, mm
  double ior = 1;                                     // refractive index inside over outside
  std::vector<Vec3f> extinction, albedo, anisotropy;  // per voxel, RGB; zero in free space
  std::vector<VoxelKind> kind;
  std::vector<Vec3f> normal;  // outward unit normal of the mesostructure surface where kind is `surface`, else zero
  // Relative refractive index of each surface voxel, zero elsewhere; empty where all of them have `ior`.
  std::vector<float> surface_ior;

  std::size_t voxel_count() const { return static_cast<std::size_t>(size.x()) * size.y() * size.z(); }
  std::size_t index(int x, int y, int z) const { return (static_cast<std::size_t>(z) * size.y() + y) * size.x() + x; }
  Material material(std::size_t voxel_index) const {
    return {extinction[voxel_index].array(), albedo[voxel_index].array(), anisotropy[voxel_index].array()};
  }
};

}  // namespace shellgrid
