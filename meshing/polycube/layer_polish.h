// SPDX-License-Identifier: AGPL-3.0-or-later
#pragma once
#include "meshing/polycube/layered_grid.h"
#include "meshing/polycube/target_surface.h"

namespace shellgrid {

// Moves single points around the worst cells where that makes these better: what a descent of an energy summed over
// cells leaves. By pattern search (Freitag & Plassmann 2000 optimise the worst of the cells around a point, too), every
// step of which lowers the sum of squared shortfalls of the scaled Jacobians around from `wanted`, of the links from
// the surface's normal, and of outer points from the surface; outer points move along the surface. Valid cells stay
// valid. At most `most_cells` cells, the worst first.
void polish_worst_cells(LayeredGrid& grid, const TargetSurface& surface, double scale, double thickness, double wanted,
                        std::size_t most_cells);

}  // namespace shellgrid
