// SPDX-License-Identifier: AGPL-3.0-or-later
#pragma once
#include <cstdint>
#include <vector>

#include "meshing/core/progress.h"
#include "meshing/core/triangle_mesh.h"
#include "meshing/core/vec.h"
#include "meshing/polycube/laplacian_weights.h"
#include "meshing/polycube/polygrid_graph.h"
#include "meshing/polycube/polygrid_hierarchy.h"
#include "meshing/polycube/voxel_polycube.h"

namespace shellgrid {

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
  std::vector<PolygridLevel> hierarchy;  // of the graph, coarser and coarser
};

// What a polygrid is worth.
struct PolygridQuality {
  long nodes = 0;           // of the graph: cell centres and boundary nodes
  long cubes = 0;           // blocks of the polycube
  int genus = 0;            // of the boundary
  long inverted_cells = 0;  // with a Jacobian ≤ 0 at a corner or at one of 27 Gauss points
  double scaled_jacobian_min = 0, scaled_jacobian_mean = 0;  // core and layer cells
  double link_length_cv = 0;                                 // deviation over mean of links between cell centres
  double link_angle_mean = 0, link_angle_max = 0;            // degrees between an outer point's link and the normal
  long steep_links = 0;                                      // of them more than 30°
  double layer_thickness_mean = 0;                           // in cells
  double boundary_distance_max = 0;                          // of outer points to the surface, in cells
  long boundary_points = 0;                                  // outer points
  long off_surface = 0;                                      // outer points farther than 1e-4 of the object's size
  double coverage_p99 = 0, coverage_max = 0;                 // of surface samples to the outer boundary, in cells
  double weight_condition_median = 0, weight_condition_max = 0;
  long least_squares_weights = 0;  // nodes whose weights are those of least squares
  long singular_weights = 0;       // nodes whose weights are those of three orthogonal lines
};

struct PolygridOptions {
  double layer_thickness = 0.1;              // in cells
  double condition_limit = ill_conditioned;  // of a node's matrix of appendix B; beyond it, least squares
};

// Makes the polygrid of an object from its polycube: maps the cells, adds the boundary layer, and weighs the
// graph's links. No cell is inverted; where the surface cannot be reached without inverting one, outer points stay off
// it, which the quality says and a warning tells. Source: [Diffusion §5.1, appendix B].
// Throws: InputError for a polycube that is empty, not a manifold or not of this object.
Polygrid build_polygrid(const VoxelPolycube& polycube, const TriangleMesh& surface, const PolygridOptions& options,
                        Progress& progress = no_progress());

PolygridQuality measure_polygrid(const Polygrid& polygrid, const VoxelPolycube& polycube, const TriangleMesh& surface);

// The outer boundary as closed triangles, `quality` the scaled Jacobian of the layer cell or core cell behind,
// whichever is worse, with colours from red (0) to green (1). Its points are the outer points.
AttributedMesh polygrid_view(const Polygrid& polygrid);

}  // namespace shellgrid
