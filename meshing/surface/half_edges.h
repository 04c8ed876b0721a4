// SPDX-License-Identifier: AGPL-3.0-or-later
#pragma once
#include <vector>

#include "meshing/core/triangle_mesh.h"

namespace shellgrid {

// Adjacency of a triangle mesh. Half-edge 3·f + k runs from corner k to corner k+1 of face f.
struct HalfEdges {
  std::vector<std::int32_t> twin;      // 3m: the opposite half-edge, −1 at a boundary
  std::vector<std::int32_t> outgoing;  // n: a half-edge that leaves the vertex, the first counter-clockwise at a
                                       // boundary; −1 where no face touches it

  static std::int32_t next(std::int32_t h) { return h % 3 == 2 ? h - 2 : h + 1; }
  static std::int32_t previous(std::int32_t h) { return h % 3 == 0 ? h + 2 : h - 1; }
  static std::int32_t face(std::int32_t h) { return h / 3; }
  static std::int32_t from(const TriangleMesh& mesh, std::int32_t h) { return mesh.faces(h / 3, h % 3); }
  static std::int32_t to(const TriangleMesh& mesh, std::int32_t h) { return mesh.faces(h / 3, (h % 3 + 1) % 3); }

  // Calls visit(h) for the outgoing half-edges of a vertex, counter-clockwise, one for each face around it.
  template <class Visit>
  void for_each_outgoing(int vertex, const Visit& visit) const {
    const std::int32_t first = outgoing[vertex];
    for (std::int32_t h = first; h >= 0;) {
      visit(h);
      h = twin[previous(h)];
      if (h == first) break;
    }
  }
};

// Throws: InputError where an edge has more than two faces, or two of the same direction.
HalfEdges build_half_edges(const TriangleMesh& mesh);

// Unit normals of the vertices, weighted by the angles of their faces; (0, 0, 1) where no face says otherwise.
VertexMatrix vertex_normals(const TriangleMesh& mesh);

// Mean length of the edges, mm; 0 without faces.
double mean_edge_length(const TriangleMesh& mesh);

}  // namespace shellgrid
