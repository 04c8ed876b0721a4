// SPDX-License-Identifier: AGPL-3.0-or-later
#pragma once
#include <vector>

#include "meshing/polycube/block_grid.h"
#include "meshing/polycube/block_parts.h"

namespace shellgrid {

// Gives a polycube of one component the wanted genus: where handles are missing, tunnels are drilled or bridges built
// near `places` (in blocks, of the object's handles); where there are too many, tunnels are filled and bridges cut
// anywhere, always by the few blocks that change the object's volume least. The boundary stays a manifold of one
// component. Returns the genus reached, which may fall short.
int repair_genus(BlockGrid& grid, int genus, const std::vector<Vec3>& places, const BlockParts& parts);

}  // namespace shellgrid
