// SPDX-License-Identifier: AGPL-3.0-or-later
#pragma once
#include <vector>

#include "meshing/surface/half_edges.h"
#include "meshing/surface/vertex_hierarchy.h"

namespace shellgrid {

// The field takes this direction at the vertex nearest to the point.
struct DirectionConstraint {
  Vec3 point;                // mm
  Vec3 direction;            // any length but 0; its part in the tangent plane counts
  std::int32_t vertex = -1;  // the vertex itself, where it is known
};

// A smooth field of unit tangent vectors, one at each vertex (n×3).
// Smooths coarse to fine on the hierarchy: each vector becomes the normalised projection of its neighbours' sum, the
// extrinsic energy of [Jakob2015] without rotational symmetry. `preferred` is the direction that the field starts from
// (any length but 0). symmetry: 1, 2 or 4; turns by 360°/symmetry count as the same direction, so that each vector is
// one of so many and neighbours' agree up to such turns [Jakob2015 §3]. Constrained vertices keep their vectors, on
// coarse levels the mean of those in their region; up to 64 of them, wanted at points, draw their surroundings too, as
// strongly as the preferred direction at 0.15 of the object's size. The same at any thread count. Throws: InputError
// for a direction that is zero, or stands across the surface at its point, contradicts another there, or is wanted
// farther than a quarter of the object's size from it.
VertexMatrix make_direction_field(const TriangleMesh& mesh, const VertexMatrix& normals,
                                  const VertexHierarchy& hierarchy, const Vec3& preferred,
                                  const std::vector<DirectionConstraint>& constraints = {}, int symmetry = 1);

// Index of the field in each face (m), in units of 1/symmetry: 0 regular, ±1 singular. Their sum is `symmetry` times
// the Euler characteristic of a closed surface, exactly. Source: [Knoeppel2013 §6.1.2], with vectors carried by the
// least rotation between normals.
std::vector<int> direction_field_indices(const TriangleMesh& mesh, const VertexMatrix& normals,
                                         const VertexMatrix& field, int symmetry = 1);

// Turns a tangent vector by the least rotation that takes one unit normal to another.
Vec3 carry_tangent(const Vec3& tangent, const Vec3& from_normal, const Vec3& to_normal);

}  // namespace shellgrid
