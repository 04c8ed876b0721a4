// SPDX-License-Identifier: AGPL-3.0-or-later
#pragma once
#include <vector>

#include "meshing/core/progress.h"
#include "meshing/core/triangle_mesh.h"
#include "meshing/polycube/block_grid.h"

namespace shellgrid {

// A polycube whose cubes are equal blocks of a lattice: always a valid subset of Z³.
struct VoxelPolycube {
  std::vector<Vec3i> blocks;   // lattice coordinates, ascending in (z, y, x)
  Vec3 origin = Vec3::Zero();  // mm, the lower corner of block (0, 0, 0)
  double spacing = 1;          // h: edge of a cell, mm
  int cells_per_block = 1;     // n along each axis: a block holds n³ cells
  int object_genus = 0;        // of the surface
  int genus = 0;               // of the polycube's boundary
  long singular_edges = 0;     // lattice edges of blocks with one or three filled blocks around
  long singular_corners = 0;   // boundary lattice points of blocks whose valence is not 4
  double coverage_p99 = 0;     // of surface samples: distance to the nearest filled block, in cells
  double coverage_max = 0;
};

struct PolycubeOptions {
  double nodes = 1e5;   // wanted: cell centres and boundary nodes of the polygrid
  double blocks = 1e4;  // wanted, unless grid is given
  int grid = 0;         // cells along a block's edge; 0: the power of two nearest to (nodes / blocks)^⅓
  int anneal_sweeps = 400;
};

// Approximates a closed surface by a voxel polycube: a column-parity raster of volume fractions, a search over
// offsets and thresholds for the object's genus, growth into extremities, annealed stairs. The boundary is
// a manifold of one component. Source: [Diffusion §5.1] fig. 4 (a), automatic here.
// Deviates: the paper assembles its polycube by hand.
// Throws: InputError where nodes are so few or the object so thin that no block can be filled.
VoxelPolycube build_voxel_polycube(const TriangleMesh& surface, const PolycubeOptions& options,
                                   Progress& progress = no_progress());

}  // namespace shellgrid
