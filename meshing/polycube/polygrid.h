// SPDX-License-Identifier: AGPL-3.0-or-later
#pragma once
#include <cstdint>
#include <vector>

#include "meshing/core/vec.h"

namespace shellgrid {

// The polygrid as a graph, as the paper draws it: the nodes are cell centres and, one for each face
// where a cell has no neighbour, boundary nodes on the surface. Each interior node has six links, each
// boundary node one. Source: [Diffusion §5.1, fig. 4, 5; appendix B].
struct PolygridGraph {
  VertexMatrix interior;                     // n×3, mm
  VertexMatrix boundary;                     // b×3, mm, on the surface
  VertexMatrix boundary_normal;              // b×3, unit, outward
  std::vector<std::int32_t> boundary_owner;  // b: the interior node that the boundary node is linked to
  std::vector<double> boundary_distance;     // b: length of that link d_ji, mm
  // n×6 in the order −x +x −y +y −z +z of the lattice: an interior node's index, or −1 − (boundary node's index).
  Eigen::Matrix<std::int32_t, Eigen::Dynamic, 6, Eigen::RowMajor> links;
  // n×6: w_ji of appendix B, mm⁻²: Laplacian(f)(i) = Σ_j w_ji (f_j − f_i).
  Eigen::Matrix<double, Eigen::Dynamic, 6, Eigen::RowMajor> weights;
  std::vector<double> weight_condition;  // n: condition number of appendix B's matrix, scaled by the spacing
};

// A hexahedral grid of an object: a subset of Z³, mapped into the object, and one thin layer of
// hexahedra at the surface. The layer's outer points lie on the surface; each is linked to exactly one
// inner point, its twin, along the inward normal. Source: [Diffusion §5.1].
struct Polygrid {
  VertexMatrix points;  // n×3, mm
  HexMatrix
      cells;  // m×8 in VTK_HEXAHEDRON order (0–3 bottom counter-clockwise seen from above, 4–7 top), positive Jacobians
  std::vector<std::uint8_t> cell_layer;  // m: 0 core cell, 1 thin boundary layer
  Eigen::Matrix<std::int32_t, Eigen::Dynamic, 3, Eigen::RowMajor>
      point_lattice;                     // n×3: coordinates in Z³; an outer point has its twin's
  std::vector<std::int32_t> outer_twin;  // n: of an outer point the index of its inner twin, else −1
  QuadMatrix boundary_quads;             // k×4 outer points, counter-clockwise seen from outside
  VertexMatrix point_normal;             // n×3: outward unit normal of the surface at outer points, zero elsewhere
  Eigen::Matrix<std::int32_t, Eigen::Dynamic, 3, Eigen::RowMajor>
      cell_lattice;    // m×3: lower corner of a core cell in Z³; of a layer cell, that of the core cell it covers
  double spacing = 0;  // h, target edge length of core cells, mm
  PolygridGraph graph;
};

}  // namespace shellgrid
