// SPDX-License-Identifier: AGPL-3.0-or-later
// Light paths of one direction each: the judge of what shares them, and the paper's estimator.
#pragma once
#include <memory>

#include "solvers/shell_texture/irradiance_sums.h"
#include "solvers/shell_texture/shell_texture.h"
#include "solvers/shell_texture/slab_walk.h"

namespace shellgrid {

// I_m by the ways that paths are expected to go through voxels; or, `sphere`, I_s and I_m by collisions within a sphere
// of one voxel's radius about each voxel's centre. Source: [STF §5.2, eq. 2]. `walk` and `volume` must outlive it.
std::unique_ptr<IrradianceBatches> direction_paths(const SlabWalk& walk, const BaseVolume& volume,
                                                   const LightDirections& directions, bool sphere,
                                                   std::uint64_t paths_a_batch, std::uint64_t seed);

}  // namespace shellgrid
