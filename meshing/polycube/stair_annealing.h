// SPDX-License-Identifier: AGPL-3.0-or-later
#pragma once
#include <vector>

#include "meshing/polycube/block_cover.h"
#include "meshing/polycube/block_grid.h"
#include "meshing/polycube/block_parts.h"

namespace shellgrid {

// Straightens a polycube's stairs by simple flips at a falling temperature: singular edges, corners by their excess
// valence, and what a block's state costs. Flips that would leave a sample of the surface without cover from inside or
// outside, or join parts that are apart, are left out. The topology stays as it is.
// `fill_cost` is of each block, indexed as in the grid: what filling it costs, and emptying it brings.
void anneal_stairs(BlockGrid& grid, const std::vector<double>& fill_cost, const std::vector<std::size_t>& blocks,
                   const BlockParts& parts, BlockCover& inner, BlockCover& outer, int sweeps);

}  // namespace shellgrid
