// SPDX-License-Identifier: AGPL-3.0-or-later
#pragma once
#include <vector>

#include "meshing/distance/distance_field.h"
#include "meshing/shell/shell_volume.h"

namespace shellgrid {

// The grid points inside the object that the shell leaves out, leaf by leaf. The distance field is the one that the
// shell was made from.
std::vector<Vec3i> find_core_voxels(const DistanceField& distance, const ShellVolume& shell);

// Makes them part of the shell's volume, of no matter yet, of `kind` core_voxel_kind and deeper than any shell.
void allocate_core(ShellVolume& shell, const std::vector<Vec3i>& core);

// Of an allocated voxel; different voxels at the same time are no harm.
void set_core_voxel(ShellVolume& shell, const Vec3i& voxel, const Material& material);

std::size_t shell_bytes(const ShellVolume& shell);

}  // namespace shellgrid
