// SPDX-License-Identifier: AGPL-3.0-or-later
#pragma once
#include "meshing/surface/half_edges.h"

namespace shellgrid {

// Where a straight walk on a mesh ended.
struct SurfaceWalkEnd {
  std::int32_t face = -1;  // −1: the walk met a boundary or a degenerate triangle
  Vec3 position = Vec3::Zero();
  Vec3 direction = Vec3::Zero();  // of the walk in the face's plane, unit
  Vec3 normal = Vec3::Zero();     // of the face, unit
};

// Walks from a vertex along a straight geodesic: straight within triangles, unfolded across edges.
// normal, direction: unit, the latter in the vertex's tangent plane; length ≥ 0, mm.
// Source: [Polthier1998].
SurfaceWalkEnd walk_from_vertex(const TriangleMesh& mesh, const HalfEdges& half_edges, int vertex, const Vec3& normal,
                                const Vec3& direction, double length);

}  // namespace shellgrid
