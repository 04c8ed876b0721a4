// SPDX-License-Identifier: AGPL-3.0-or-later
#pragma once
#include <vector>

#include "meshing/core/triangle_mesh.h"

namespace shellgrid {

// A place that should have this distance to a surface, mm.
struct PlaceAtDistance {
  Vec3 point;
  double distance;
};

// By how much the places' distances to the mesh differ from what they should be, mm: the value that a share `share`
// (0 … 1) of them does not exceed. 0 without places. Throws: InputError for a mesh without faces.
double distance_deviation(const std::vector<PlaceAtDistance>& places, const TriangleMesh& mesh, double share);

}  // namespace shellgrid
