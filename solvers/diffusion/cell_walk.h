// SPDX-License-Identifier: AGPL-3.0-or-later
// Follows a straight line through a polygrid's cells.
#pragma once
#include <array>
#include <cstdint>
#include <vector>

#include "solvers/diffusion/trilinear_cell.h"

namespace shellgrid {

// Which cells and which boundary quads lie behind the faces of each cell. Faces 2k and 2k + 1 are those where
// the reference coordinate k is 0 and 1.
struct CellNeighbours {
  std::vector<std::array<std::int32_t, 6>> cell;  // −1 where none
  std::vector<std::array<std::int32_t, 6>> quad;  // −1 where none
  // Of each boundary quad: the cell behind it, and the reference coordinates of its corners there.
  std::vector<std::int32_t> quad_cell;
  std::vector<std::array<Vec3, 4>> quad_corners;

  // Throws: InputError where a face has three cells or a quad none.
  explicit CellNeighbours(const Polygrid& polygrid);
};

// A place in a cell.
struct CellPlace {
  std::int32_t cell = 0;
  Vec3 reference = Vec3::Zero();  // 0 … 1 in each coordinate
};

enum class WalkEnd { inside, surface, lost };

// Moves `place` to the point, from cell to cell. Where the way leaves the grid, `surface` is returned, `place` is in
// the last cell with the reference coordinates of the point, one of them beyond 0 … 1, and `face` is the
// face left by. Where strongly bent cells lead the walk astray, the cells about the start are searched; `lost`: without
// success, `place` being unchanged.
WalkEnd walk_to(const Polygrid& polygrid, const CellNeighbours& neighbours, const Vec3& point, CellPlace& place,
                int& face);

// How far, mm, a straight way that ends at `outside`, beyond a face of its cell, has gone since it passed that; to
// first order, and any number where it runs along the face.
double way_past_face(const Polygrid& polygrid, const CellPlace& outside, int face, const Vec3& direction);

// Outward unit normal of a cell's face at reference coordinates.
Vec3 face_normal(const Polygrid& polygrid, const CellPlace& place, int face);

}  // namespace shellgrid
