// SPDX-License-Identifier: AGPL-3.0-or-later
#pragma once
#include <vector>

#include "meshing/surface/half_edges.h"
#include "meshing/surface/vertex_hierarchy.h"

namespace shellgrid {

// A mesh with an orthonormal frame at every vertex: texture direction u along `direction`, v along normal × direction.
// Seen from outside, u, v and the outward normal are right-handed; the sample's depth z runs inwards.
struct TexturedSurface {
  TriangleMesh mesh;
  HalfEdges half_edges;
  VertexMatrix normals;      // n×3, unit
  VertexMatrix directions;   // n×3, unit, tangent
  std::vector<float> scale;  // n: how much larger than in the sample a texel is; empty: 1 everywhere

  double texel_length(int vertex, double voxel) const { return scale.empty() ? voxel : voxel * scale[vertex]; }
};

// The vertex of a level nearest to a place given in another vertex's frame.
struct TangentNeighbour {
  std::int32_t vertex = -1;      // −1: the surface ends before
  Vec2f offset = Vec2f::Zero();  // of that vertex, in the frame of the vertex that asks, texels
  // Of the turn that takes components in the asking frame to the neighbour's, times the texels of the latter in one of
  // the former.
  float cosine = 1, sine = 0;
  int turn = 0;  // with frames alike under turns by 360°/symmetry: so many of these come on top of that turn

  Vec2f rotate(const Vec2f& vector) const {
    return {cosine * vector.x() - sine * vector.y(), sine * vector.x() + cosine * vector.y()};
  }
};

// Walks from a vertex along a geodesic to `offset` (texels, in the vertex's frame) and finds the vertex of `level` next
// to the place reached. voxel: length of a texel where the scale is 1, mm.
TangentNeighbour find_tangent_neighbour(const TexturedSurface& surface, const VertexHierarchy::Level& level, int vertex,
                                        const Vec2& offset, double voxel, int symmetry = 1);

}  // namespace shellgrid
