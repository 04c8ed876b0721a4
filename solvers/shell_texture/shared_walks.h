// SPDX-License-Identifier: AGPL-3.0-or-later
// Light walks that serve all directions at once.
#pragma once
#include <memory>

#include "solvers/shell_texture/beam_field.h"
#include "solvers/shell_texture/irradiance_sums.h"

namespace shellgrid {

// After the first collision a walk does not know which direction its light came from: begun by a beam of any direction
// it counts for each direction by the ratio of densities with which that direction and all together scatter light
// there, to where the walk goes. The ratio is of the marched field: of the voxel's light, of its place within the voxel
// (linear, so that the direction's mean place is right) and, where matter scatters unevenly, of the phase function
// about the mean course of the direction's light. The sum over directions is right whatever the field is.
// Beams choose directions in turn, entry points from a shifted lattice, and always collide. Light from below has walks
// of its own. `walk` and `field` (with sources) must outlive it.
std::unique_ptr<IrradianceBatches> shared_walks(const SlabWalk& walk, const BeamField& field,
                                                const LightDirections& directions, std::uint64_t walks_a_batch,
                                                std::uint64_t seed);

}  // namespace shellgrid
