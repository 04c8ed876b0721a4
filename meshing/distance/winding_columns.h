// SPDX-License-Identifier: AGPL-3.0-or-later
#pragma once
#include <cstdint>
#include <vector>

#include "meshing/core/grid_frame.h"
#include "meshing/core/triangle_mesh.h"

namespace shellgrid {

// Where the grid's lines along z cross a closed surface: tells inside from outside at every grid point, by winding
// number. Corners are rounded to 2⁻²⁰ of a voxel in x and y; which triangles a line meets is then decided exactly, and
// a line through an edge or corner counts as shifted by an infinitesimal (ε, ε²): no line leaks.
class WindingColumns {
 public:
  // Lines (i, j) with lower ≤ (i, j) ≤ upper in x and y. The mesh must be closed; it may have cavities.
  WindingColumns(const TriangleMesh& mesh, const GridFrame& frame, const Vec3i& lower, const Vec3i& upper);

  // Whether the grid point lies inside. Lines beyond the range lie outside.
  bool inside(int i, int j, int k) const {
    bool result = false;
    inside(i, j, k, 1, &result);
    return result;
  }
  // The same for grid points (i, j, k) … (i, j, k + count − 1).
  void inside(int i, int j, int k, int count, bool* result) const;

 private:
  struct Crossing {
    double z;           // in grid intervals
    std::int32_t turn;  // +1 into the object, −1 out of it, upwards
  };

  int lower_i_, lower_j_, count_i_, count_j_;
  std::vector<std::int64_t> first_;  // of each line's crossings; lines in order (i, j)
  std::vector<Crossing> crossings_;  // upwards in each line
};

}  // namespace shellgrid
