// SPDX-License-Identifier: AGPL-3.0-or-later
#pragma once
#include "meshing/core/triangle_mesh.h"

namespace shellgrid {

// Interpolates values at the vertices of a closed triangle mesh to a point inside by mean value coordinates: constants
// and linear functions come back exactly, whatever the triangles. Where the mesh is not convex some weights are
// negative, so values may leave the range of the vertices'.
// Source: [Ju2005].
// boundary: closed as a cycle (each edge is passed as often one way as the other; parts and folds are no harm),
// outward; values: one row a vertex. Returns one row; the nearest vertex's where the weights cancel.
Eigen::RowVectorXd mean_value(const TriangleMesh& boundary, const Eigen::MatrixXd& values, const Vec3& point);

// Merges the vertices of each cube of a lattice into their mean and leaves out what of the triangles becomes a line or
// meets its like turned round: a closed mesh stays a cycle. Source: [RossignacBorrel1993].
// edge: of the cubes, mm, > 0; cluster: for each vertex of `mesh` the one that it went into.
TriangleMesh cluster_vertices(const TriangleMesh& mesh, double edge, std::vector<std::int32_t>& cluster);

}  // namespace shellgrid
