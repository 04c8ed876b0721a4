// SPDX-License-Identifier: AGPL-3.0-or-later
#pragma once
#include <cstdint>
#include <vector>

#include "meshing/core/triangle_mesh.h"
#include "meshing/surface/half_edges.h"

namespace shellgrid {

// Nested subsets of a mesh's vertices, each with about a quarter of the one before, evenly spread.
struct VertexHierarchy {
  struct Level {
    std::vector<std::int32_t> vertices;  // rising mesh vertex indices
    std::vector<std::int32_t> nearest;   // n: for each mesh vertex the vertex of this level nearest along edges
  };
  std::vector<Level> levels;  // levels[0] holds every vertex; spacing of levels[l] is about 2^l · spacing
};

// Chooses each level greedily, in an order given by the seed, so that its vertices keep a distance.
// spacing: mean distance of neighbouring vertices, mm. Stops early where a level would have fewer than 4 vertices.
VertexHierarchy build_vertex_hierarchy(const TriangleMesh& mesh, const HalfEdges& half_edges,
                                       const VertexMatrix& normals, double spacing, int level_count,
                                       std::uint64_t seed);

}  // namespace shellgrid
