// SPDX-License-Identifier: AGPL-3.0-or-later
#pragma once
#include <cstdint>
#include <vector>

#include "meshing/core/vec.h"

namespace shellgrid {

// A finite window of Z³ whose blocks are filled or empty; everything outside is empty, and so is the
// outermost layer.
struct BlockGrid {
  Vec3i size = Vec3i::Zero();
  std::vector<std::uint8_t> filled;

  BlockGrid() = default;
  explicit BlockGrid(const Vec3i& counts)
      : size(counts), filled(static_cast<std::size_t>(counts.x()) * counts.y() * counts.z(), 0) {}

  std::size_t index(int i, int j, int k) const { return (static_cast<std::size_t>(k) * size.y() + j) * size.x() + i; }
  std::size_t index(const Vec3i& b) const { return index(b.x(), b.y(), b.z()); }
  Vec3i place(std::size_t index) const {
    return {static_cast<int>(index % size.x()), static_cast<int>(index / size.x() % size.y()),
            static_cast<int>(index / size.x() / size.y())};
  }
  bool contains(const Vec3i& b) const { return (b.array() >= 0).all() && (b.array() < size.array()).all(); }
  // In the interior of the window, where blocks may be filled.
  bool may_fill(const Vec3i& b) const { return (b.array() >= 1).all() && (b.array() < size.array() - 1).all(); }
  bool at(const Vec3i& b) const { return contains(b) && filled[index(b)]; }
  std::size_t count() const;
};

// The eight blocks around the lattice point `corner` (the lower corner of block `corner`): bit k is the
// block corner − 1 + (k & 1, k >> 1 & 1, k >> 2).
int window_at(const BlockGrid& grid, const Vec3i& corner);

// The window at one of the eight corners (bit per axis) of the middle one of 27 blocks, bit x + 3y + 9z.
int window_of(unsigned around, int corner);

// Whether the boundary of the union is a manifold at a lattice point with these eight blocks: filled and
// empty blocks are each connected through faces. Source: [Latecki1997] well-composed sets.
bool is_well_composed(int window);

// Valence of the lattice point in the boundary's quadrilaterals, 0 away from the boundary.
int boundary_valence(int window);
// Whether some direction has a positive product with the outward normals of all boundary faces there.
bool has_visible_normal(int window);

// Whether flipping a block keeps the topology of the union: the part of its surface that touches filled
// blocks is connected with Euler characteristic 1, and all eight windows stay well-composed.
bool is_simple_flip(const BlockGrid& grid, const Vec3i& block);
// The same for the 27 blocks around, bit x + 3y + 9z; the block itself is bit 13.
bool is_simple_flip(unsigned around);

// Euler characteristic of the boundary surface, which must be a manifold: 2 − 2 genus for one component.
long boundary_euler_characteristic(const BlockGrid& grid);

// Keeps the largest face-connected component and fills cavities.
void keep_largest_component(BlockGrid& grid);
void fill_cavities(BlockGrid& grid);

// Adds blocks until the boundary is a manifold all of whose points see their faces: a thin layer then fits on the
// lattice without any optimisation. Ascending in (z, y, x) like the blocks given.
std::vector<Vec3i> fill_to_visible(const std::vector<Vec3i>& blocks);

// Blocks of the boundary where the surface is not a manifold.
std::size_t count_ill_composed(const BlockGrid& grid);

// Singular edges (one or three of the four blocks around a lattice edge are filled) and corners (lattice points of
// the boundary whose valence is not 4).
struct SingularityCounts {
  long edges = 0;
  long corners = 0;
};
SingularityCounts count_singularities(const BlockGrid& grid);

}  // namespace shellgrid
