// SPDX-License-Identifier: AGPL-3.0-or-later
#pragma once
#include <cstdint>
#include <vector>

#include "meshing/polycube/hexahedra_optimization.h"

namespace shellgrid {

// The cells that hold each point.
class CellsOfPoints {
 public:
  CellsOfPoints(const std::vector<LatticeHexahedron>& cells, std::size_t point_count);
  const std::int32_t* begin(std::int32_t point) const { return cells_.data() + first_[point]; }
  const std::int32_t* end(std::int32_t point) const { return cells_.data() + first_[point + 1]; }

 private:
  std::vector<std::int32_t> first_, cells_;
};

// A part of a hexahedral mesh as a mesh of its own.
struct HexahedraRegion {
  std::vector<std::int32_t> cells;       // ascending
  std::vector<std::int32_t> points;      // of the whole mesh, by local index
  std::vector<LatticeHexahedron> local;  // the cells with local indices
  std::vector<std::uint8_t> locked;      // points that cells outside the region hold as well
};

// The connected parts of `seeds` and `rings` of cells around them, in ascending order of their first cells.
std::vector<HexahedraRegion> regions_around(const std::vector<LatticeHexahedron>& cells, const CellsOfPoints& around,
                                            const std::vector<std::int32_t>& seeds, int rings);

}  // namespace shellgrid
