// SPDX-License-Identifier: AGPL-3.0-or-later
// Which cells of a polygrid's levels may stand for their children because they lie deep: the composite grid that the
// adaptive solver works on.
#pragma once
#include <array>
#include <cstdint>
#include <vector>

#include "meshing/core/vec.h"
#include "meshing/polycube/polygrid_hierarchy.h"

namespace shellgrid {

// Points and cells of one level, corners numbered by bits: bit k towards + axis k.
struct GridLevel {
  std::vector<Vec3i> lattice;         // of each point
  std::vector<std::int32_t> corners;  // 8 points a cell
  std::vector<Vec3i> cell_lattice;    // of each cell, ascending in (z, y, x)
  std::vector<std::int32_t> parent;   // of each cell: the cell of the next coarser level; empty on the coarsest
  std::vector<char> at_surface;       // of each point: an outer point stands above it

  std::size_t cells() const { return cell_lattice.size(); }
};

// What the composite grid makes of one level.
struct CompositeLevel {
  std::vector<std::array<std::int32_t, 8>> child;  // of each cell, by octant; −1 where there is none. Not on the finest
  std::vector<char> deep;                          // of each cell: it may stand for its children. Not on the finest
  std::vector<char> covered;                       // of each cell: a coarser cell stands for it
  std::vector<Eigen::Vector3f> position;           // of each point, mm from the origin given

  // A cell that stands for its children and for which no other stands.
  bool is_leaf(std::size_t cell) const { return !deep.empty() && deep[cell] && !covered[cell]; }
};

// A cell of level l may stand for its children where `depth` cells of its size or more lie between it and the surface,
// where it has all eight children and these stand for theirs, and where they are not much bent; levels beyond
// `coarsest` points are left alone. A point on the face of such a cell that it has no corner at takes its place, and
// later its value, from the corners': so the elements fit together. Nothing is covered where `depth` is 0 or where
// that would invert a cell. `position`: of the finest level's points, mm. Source: [Diffusion §5.3], where depths are
// set by hand.
std::vector<CompositeLevel> choose_deep_cells(const std::vector<GridLevel>& levels,
                                              const std::vector<PointTransfer>& transfers,
                                              std::vector<Eigen::Vector3f> position, int depth, std::size_t coarsest);

}  // namespace shellgrid
