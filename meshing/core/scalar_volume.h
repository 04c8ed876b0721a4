// SPDX-License-Identifier: AGPL-3.0-or-later
#pragma once
#include <cstddef>
#include <vector>

#include "meshing/core/vec.h"

namespace shellgrid {

// A measured value at each point of a regular grid: value (x, y, z) is stored at (z·n_y + y)·n_x + x.
struct ScalarVolume {
  Vec3i size = Vec3i::Zero();
  Vec3 spacing = Vec3::Ones();  // between grid points, mm
  std::vector<float> values;

  std::size_t count() const { return static_cast<std::size_t>(size.x()) * size.y() * size.z(); }
  float at(int x, int y, int z) const { return values[(static_cast<std::size_t>(z) * size.y() + y) * size.x() + x]; }
};

}  // namespace shellgrid
