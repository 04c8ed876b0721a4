// SPDX-License-Identifier: AGPL-3.0-or-later
#pragma once
#include <vector>

#include "meshing/core/triangle_mesh.h"

namespace shellgrid {

struct EdgeStatistics {
  double mean = 0, deviation = 0;  // mm; deviation is the standard one
  double least = 0, greatest = 0;  // mm
  double variation() const { return deviation / mean; }
};

// Lengths of the edges of a closed mesh, each once.
EdgeStatistics measure_edges(const TriangleMesh& mesh);

// Greatest distance from one surface to another, at the vertices of `from` and at points spread over its faces, one in
// every spacing²/2 of area and at least one a face, mm. One side of the sampled Hausdorff distance.
double sampled_distance(const TriangleMesh& from, const TriangleMesh& to, double spacing);

// Distances from points to a surface, mm.
std::vector<float> distances_to_surface(const VertexMatrix& points, const TriangleMesh& surface);

}  // namespace shellgrid
