// SPDX-License-Identifier: AGPL-3.0-or-later
#pragma once
#include "meshing/core/grid_frame.h"
#include "meshing/core/progress.h"
#include "meshing/core/triangle_mesh.h"
#include "meshing/shell/two_level_grid.h"

namespace shellgrid {

// Narrow-band signed distance to a closed surface on a regular grid. Source: [STF §6, fig. 5a].
// The three grids share the frame and the set of active samples: the grid points whose distance is
// within the band. Inactive samples hold the background, except that `distance` of a sample inside
// the object but beyond the band is −inside_band where its leaf is allocated.
struct DistanceField {
  GridFrame frame;
  double inside_band = 0;                     // mm, > 0
  double outside_band = 0;                    // mm, > 0
  TwoLevelGrid<float> distance;               // mm, negative inside; background = outside_band
  TwoLevelGrid<std::int32_t> nearest_vertex;  // mesh vertex nearest to the nearest point; background −1
  TwoLevelGrid<Vec3f> nearest_point;          // mm
};

}  // namespace shellgrid
