// SPDX-License-Identifier: AGPL-3.0-or-later
#pragma once
#include <cstdint>
#include <vector>

#include "meshing/core/triangle_mesh.h"
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
  // n×6: w_ji, mm⁻²: Laplacian(f)(i) = Σ_j w_ji (f_j − f_i).
  Eigen::Matrix<double, Eigen::Dynamic, 6, Eigen::RowMajor> weights;
  std::vector<double> weight_condition;     // n: condition number of appendix B's matrix, scaled by the spacing
  std::vector<std::uint8_t> weight_method;  // n: a WeightMethod
};

}  // namespace shellgrid
