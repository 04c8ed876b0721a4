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

// The cells of one level that stand for their children in a composite grid.
struct DeepPart {
  // Of each deep cell of the level its children by octant: the polygrid's cells on level 1, else deep cells of the next
  // finer level.
  std::vector<std::array<std::int32_t, 8>> child;
  std::vector<std::int32_t> deep_cell;   // of each leaf: its number among deep cells
  std::vector<std::int32_t> level_cell;  // of each leaf: its number among the level's cells
  std::vector<std::int32_t> unknown;     // of each point of the leaves: the level's unknown
  // Of each of those points the leaves' points before and after it along y and z; −1 where there is none.
  std::vector<std::array<std::int32_t, 4>> beside;
  ChannelPlanes<float> position;  // of those points, mm from FineGrid::origin
  // Of each leaf D h δ / 4, h its size, δ how far the harmonic mean of D over its children falls below the arithmetic
  // one: what they conduct as one lies between. Empty where no δ exceeds 1e-4.
  std::vector<Float4> spread;
  RunLevel part;  // the leaves alone: couplings, and in `x` the solution that lives here

  bool empty() const { return level_cell.empty(); }
};

// Points of one level that take the mean of points of the next coarser one, because no finer cell is there any more.
struct InterpolatedPoints {
  std::vector<std::int32_t> point;   // the polygrid's on the finest level
  std::vector<std::int64_t> start;   // points + 1
  std::vector<std::int32_t> parent;  // points of the next coarser level
};

// The levels of a polygrid, as its own or as a composite grid's.
struct LevelHierarchy {
  std::vector<RunLevel> levels;  // finest first
  FineGrid fine;
  std::vector<DeepPart> deep;                    // of each level; none on the finest
  std::vector<InterpolatedPoints> interpolated;  // of each level
  std::vector<std::size_t> points;               // of each level, with those that are interpolated
  // Of each level's covered points those at which the next coarser level has one: both.
  std::vector<std::vector<std::pair<std::int32_t, std::int32_t>>> coincident;
  std::size_t skipped = 0;  // points of the polygrid that are no unknowns
};

// Builds levels with all but couplings, until one has no more than `coarsest` unknowns. `depth`: see
// `choose_deep_cells`; 0 for all of the polygrid.
// Throws: InputError where the polygrid's cells, points and hierarchy do not fit together.
LevelHierarchy build_levels(const Polygrid& polygrid, std::size_t coarsest, int depth = 0);

}  // namespace shellgrid
