// SPDX-License-Identifier: AGPL-3.0-or-later
#pragma once
#include <cstdint>

#include "meshing/core/triangle_mesh.h"

namespace shellgrid {

// What a triangle mesh is as a surface, whatever its faults.
struct MeshTopology {
  std::int64_t edges = 0;
  std::int64_t boundary_edges = 0;      // of one face
  std::int64_t non_manifold_edges = 0;  // of more than two faces
  std::int64_t misoriented_edges = 0;   // of two faces that run along it the same way
  std::int64_t degenerate_faces = 0;    // a vertex twice, or no area
  std::int64_t isolated_vertices = 0;   // of no face
  std::int64_t components = 0;          // of faces that share vertices
  std::int64_t euler_characteristic = 0;
  double area = 0;    // mm²
  double volume = 0;  // mm³, signed; of a closed mesh what it encloses
  bool is_closed() const { return edges > 0 && boundary_edges == 0 && non_manifold_edges == 0; }
  bool is_oriented() const { return misoriented_edges == 0; }
  // Of a closed oriented surface: summed over its components.
  std::int64_t genus() const { return components - euler_characteristic / 2; }
};

MeshTopology measure_topology(const TriangleMesh& mesh);

}  // namespace shellgrid
