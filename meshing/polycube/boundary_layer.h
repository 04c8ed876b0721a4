// SPDX-License-Identifier: AGPL-3.0-or-later
#pragma once
#include <vector>

#include "meshing/core/progress.h"
#include "meshing/polycube/layered_grid.h"

namespace shellgrid {

// Adds the layer: outer points at the surface points nearest to the core's boundary, so that links run
// along the surface's normal. Cells that this inverts, or that are inverted between their corners, are
// mended together with three rings around them; where the surface cannot be kept the outer points stay as near
// as is valid. `scale` is the number of cells in the surface's unit.
LayeredGrid add_boundary_layer(LatticeGrid core, const TargetSurface& surface, double scale, double thickness,
                               Progress& progress = no_progress());

// The polycube's lattice with a layer on top, drawn towards the surface as far as every cell stays valid at every step.
// It always ends valid where every boundary point sees all its faces; elsewhere the layer has to be mended first, and
// the result may hold inverted cells.
LayeredGrid layer_on_lattice(const std::vector<Vec3i>& blocks, int refinement, const TargetSurface& surface,
                             double scale, double thickness);

}  // namespace shellgrid
