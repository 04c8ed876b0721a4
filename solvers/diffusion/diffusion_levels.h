// SPDX-License-Identifier: AGPL-3.0-or-later
// The multigrid levels of a polygrid: who couples with whom, without material.
#pragma once
#include <cstdint>
#include <vector>

#include "meshing/polycube/polygrid.h"
#include "solvers/diffusion/run_level.h"

namespace shellgrid {

// The finest cells in runs along x, as their elements are computed: 16 at a time.
struct FineCellRun {
  std::int32_t first, length;           // in `FineGrid::cell`
  std::array<std::int32_t, 4> unknown;  // of the first cell's corners 0, 2, 4, 6
  std::int32_t x;                       // of the first cell
  bool regular;                         // corners and parents follow each other
};

// What only the finest level has.
struct FineGrid {
  std::vector<std::int32_t> cell;  // the polygrid's cell of each core cell, ascending in (z, y, x)
  std::vector<FineCellRun> runs;
  std::vector<std::int32_t> slab_start;      // runs of slabs that share z / 2
  std::vector<std::int32_t> layer_cell;      // the polygrid's cells of the thin layer, by the core cell they cover
  std::vector<std::int32_t> layer_boundary;  // of each: its core cell's place in LevelCells::boundary
  std::vector<std::array<std::uint8_t, 8>>
      layer_node;                 // of each: its corners as corners of the core cell, + 8 for outer
  ChannelPlanes<float> position;  // of inner unknowns, mm from `origin`
  Vec3 origin = Vec3::Zero();
  std::vector<std::int32_t> outer_point;  // the polygrid's point of each outer unknown
};

// Builds levels with all but couplings, until one has no more than `coarsest` unknowns.
// Throws: InputError where the polygrid's cells, points and hierarchy do not fit together.
std::vector<RunLevel> build_levels(const Polygrid& polygrid, std::size_t coarsest, FineGrid& fine);

}  // namespace shellgrid
