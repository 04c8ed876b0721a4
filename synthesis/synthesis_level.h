// SPDX-License-Identifier: AGPL-3.0-or-later
#pragma once
#include <array>
#include <vector>

#include "synthesis/tangent_neighbours.h"

namespace shellgrid {

// One level of the synthesis: its vertices, their eight neighbours, and groups that may change at once.
struct SynthesisLevel {
  static constexpr int slots = 8;
  static const std::array<Vec2f, slots> offsets;  // in steps of the level

  std::vector<std::int32_t> vertices;
  std::vector<TangentNeighbour> neighbours;       // 8 a vertex
  std::vector<std::vector<std::int32_t>> groups;  // positions in `vertices`; no neighbour in the own group

  const TangentNeighbour& neighbour(std::size_t position, int slot) const {
    return neighbours[position * slots + slot];
  }
};

// symmetry: of the surface's directions. Groups are chosen greedily, in vertex order.
SynthesisLevel build_synthesis_level(const TexturedSurface& surface, const VertexHierarchy& hierarchy, int level,
                                     double voxel, int symmetry);

}  // namespace shellgrid
