// SPDX-License-Identifier: AGPL-3.0-or-later
#pragma once
#include <array>
#include <cstdint>
#include <vector>

#include "meshing/core/progress.h"
#include "meshing/polycube/hexahedra_optimization.h"
#include "meshing/polycube/target_surface.h"
#include "meshing/polycube/voxel_polycube.h"

namespace shellgrid {

// The cells of a polycube at some refinement, and where their corners stand.
struct LatticeGrid {
  struct BoundaryQuad {
    std::array<std::int32_t, 4> corners;  // counter-clockwise seen from outside
    std::int32_t cell;                    // the only cell behind it
    std::int32_t side;                    // of that cell: 0 … 5 are −x +x −y +y −z +z
  };
  std::vector<Vec3i> cell_lattice;           // m: lower corners, ascending in (z, y, x)
  std::vector<LatticeHexahedron> cells;      // m
  std::vector<Vec3i> point_lattice;          // n
  std::vector<BoundaryQuad> boundary_quads;  // k
  VertexMatrix points;                       // n×3
};

// Each block becomes `refinement`³ cells; points stand at their lattice coordinates.
LatticeGrid refine_blocks(const std::vector<Vec3i>& blocks, int refinement);

// Outward area-weighted normals of the boundary at its points (n×3), zero elsewhere; not normalised.
VertexMatrix boundary_normals(const LatticeGrid& grid);

// Of each of the given boundary points a unit vector whose least product with the normals of the boundary's corners
// there is large: where it is positive, all faces there can be seen from that direction.
std::vector<Vec3> visible_normals(const LatticeGrid& grid, const std::vector<std::int32_t>& points);

// Where samples of an object's surface, moved inwards by `depth`, lie more than a quarter of a cell from a grid's
// boundary: attractions of the nearest faces of `boundary` to them. `boundary` and `depth` are in cells, of which
// `scale` make the samples' unit.
std::vector<QuadAttraction> pulls_to_uncovered(const TriangleMesh& boundary,
                                               const std::vector<TargetSurface::Sample>& samples, double scale,
                                               double depth, double weight);

// The polycube's boundary in mm as closed triangles without unused points.
TriangleMesh polycube_surface(const VoxelPolycube& polycube);

struct PolycubeMapOptions {
  double layer_thickness = 0.1;  // depth at which the core's boundary is sought, in cells
  int coarse_steps = 8;
  int coarse_iterations = 30;
  int fine_steps = 4;
  int fine_iterations = 15;
  VertexMatrix start;  // of the blocks' corners, in block edges, in the order of refine_blocks; empty: on the lattice
};

// Maps a polycube into an object: coarse to fine, cells keep their shape and positive Jacobians while
// the boundary is drawn to the surface. `surface` is in units of block edges from the polycube's origin,
// the result in units of cells. The cells' corner Jacobians are positive.
// Source: [Diffusion §5.1] fig. 4 (d)–(f).
// Deviates: distortion energy of [Garanzha2021] instead of the variance of link lengths, which does not keep cells from
// inverting.
LatticeGrid map_polycube(const std::vector<Vec3i>& blocks, int cells_per_block, const TargetSurface& surface,
                         const PolycubeMapOptions& options, Progress& progress = no_progress());

}  // namespace shellgrid
