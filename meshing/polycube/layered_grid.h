// SPDX-License-Identifier: AGPL-3.0-or-later
#pragma once
#include <vector>

#include "meshing/polycube/polycube_map.h"

namespace shellgrid {

// A core grid and the thin layer around it, in units of cells.
struct LayeredGrid {
  LatticeGrid core;
  VertexMatrix points;                   // core points, then one outer point for each boundary point of the core
  std::vector<std::int32_t> twin;        // of each outer point: the core point it is linked to
  std::vector<LatticeHexahedron> layer;  // one cell a boundary quadrilateral; its third axis points outwards
};

// Core and layer with the outer points still at their twins.
LayeredGrid with_flat_layer(LatticeGrid core);

// Core cells, then layer cells.
std::vector<LatticeHexahedron> all_cells(const LayeredGrid& grid);

// Cells (core first, then layer) whose least Jacobian at corners or Gauss points is not positive.
std::vector<std::int32_t> inverted_cells(const LayeredGrid& grid);

}  // namespace shellgrid
