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

enum class SignRule {
  closed,          // the surface must be closed and oriented; inside is what it winds around
  winding_number,  // any triangles that look outward, with gaps, doubled or crossing: inside is where the generalised
                   // winding number is one half or more
};

struct DistanceOptions {
  double voxel = 0.4;         // grid interval d_0, mm
  double inside_band = 4.8;   // mm, > 0
  double outside_band = 0.8;  // mm, > 0
  SignRule sign = SignRule::closed;
};

// How much of the grid was visited.
struct DistanceStatistics {
  std::int64_t active_samples = 0;
  std::int64_t visited_samples = 0;   // whose nearest point was looked for
  std::int64_t compared_pairs = 0;    // of a sample and a face, edge or vertex
  std::int64_t possible_samples = 0;  // in the leaves that cover the object and its outside band
  std::int64_t allocated_leaves = 0;
  std::int64_t possible_leaves = 0;
  double skipped() const { return 1 - static_cast<double>(visited_samples) / static_cast<double>(possible_samples); }
};

// Computes the field around a closed, outward surface; grid points are voxel·(i, j, k). The nearest point is exact to
// rounding; the sign is the winding number along z, so sharp edges, needles and thin walls do not disturb it. The
// nearest vertex is the lowest of all mesh vertices nearest to the nearest point.
// With SignRule::winding_number the surface may be any heap of triangles, and the nearest point is exact still.
// Throws: InputError for a surface that is not closed, oriented and outward where it must be; that has no faces or
// looks inward; for too many samples.
DistanceField compute_distance_field(const TriangleMesh& mesh, const DistanceOptions& options,
                                     DistanceStatistics& statistics, Progress& progress = no_progress());

}  // namespace shellgrid
