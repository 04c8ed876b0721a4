// SPDX-License-Identifier: AGPL-3.0-or-later
#pragma once
#include "meshing/surface/half_edges.h"
#include "meshing/surface/vertex_hierarchy.h"

namespace shellgrid {

// A smooth field of unit tangent vectors, one at each vertex (n×3).
// Smooths coarse to fine on the hierarchy: each vector becomes the normalised projection of its neighbours' sum, the
// extrinsic energy of [Jakob2015] without rotational symmetry. `preferred` is the direction that the field starts from
// (any length but 0). The same at any thread count.
VertexMatrix make_direction_field(const TriangleMesh& mesh, const VertexMatrix& normals,
                                  const VertexHierarchy& hierarchy, const Vec3& preferred);

// Index of the field in each face (m): 0 regular, ±1 singular. Their sum is the Euler characteristic of a closed
// surface, exactly. Source: [Knoeppel2013 §6.1.2], with vectors carried by the least rotation between normals.
std::vector<int> direction_field_indices(const TriangleMesh& mesh, const VertexMatrix& normals,
                                         const VertexMatrix& field);

// Turns a tangent vector by the least rotation that takes one unit normal to another.
Vec3 carry_tangent(const Vec3& tangent, const Vec3& from_normal, const Vec3& to_normal);

}  // namespace shellgrid
