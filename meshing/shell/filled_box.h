// SPDX-License-Identifier: AGPL-3.0-or-later
#pragma once
#include "meshing/shell/two_level_grid.h"

namespace shellgrid {

// A box of active samples [0, size) filled by value(x, y, z).
template <class T, class Value>
TwoLevelGrid<T> filled_box(const Vec3i& size, const T& background, const Value& value) {
  TwoLevelGrid<T> grid(Vec3i::Zero(), (size.array() + 7) / 8, background);
  for (int x = 0; x < size.x(); ++x)
    for (int y = 0; y < size.y(); ++y)
      for (int z = 0; z < size.z(); ++z) grid.set(x, y, z, value(x, y, z));
  return grid;
}

}  // namespace shellgrid
