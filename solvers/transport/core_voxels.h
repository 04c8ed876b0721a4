// SPDX-License-Identifier: AGPL-3.0-or-later
// An interpolated core as voxels, for media that take each voxel's matter as it is.
#pragma once
#include <functional>

#include "meshing/shell/shell_volume.h"

namespace shellgrid {

// The shell with voxels of its own for everything below it. σ_a, σ_s and σ_s g (so that σ_s' is what the diffusion
// solver's core has, up to the grids) are continued harmonically from the shell's deepest voxels, those within one
// voxel of its bottom, free space left out: on blocks of 2³ voxels, of which those that hold deepest voxels have their
// mean, by conjugate gradients to the relative residual `tolerance`. No value leaves the range of these means. The core
// is what inactive voxels reach from next to the deepest ones, beginning where `inside` says so of their centres.
// Without any deepest voxel the shell's homogeneous core stays. Same bytes at any thread count. Throws: InputError for
// a coefficient that is negative or not finite, or a shell with a gap; NumericalError where the iteration does not
// converge.
ShellVolume with_core_voxels(const ShellVolume& shell, const std::function<bool(const Vec3&)>& inside,
                             double tolerance = 1e-5);

}  // namespace shellgrid
