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

// The points of sampled_distance that are farther than `limit` from the other surface, mm.
std::vector<Vec3> samples_beyond(const TriangleMesh& from, const TriangleMesh& to, double spacing, double limit);

// How well the sharp edges of one closed surface are sharp edges of another.
struct CreaseFigures {
  double length = 0;  // of edges sharper than the angle, mm
  double kept = 1;    // share of it no farther than a quarter of the spacing from an edge of the other surface that is
                      // sharper than 0.6 of the angle
  double distance = 0;  // greatest from there to such an edge, mm; infinite where there is none
};

// angle: degrees between face normals. Both surfaces closed and oriented.
CreaseFigures compare_creases(const TriangleMesh& from, const TriangleMesh& to, double angle, double spacing);

// Distances from points to a surface, mm.
std::vector<float> distances_to_surface(const VertexMatrix& points, const TriangleMesh& surface);

}  // namespace shellgrid
