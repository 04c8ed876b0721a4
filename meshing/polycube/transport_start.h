// SPDX-License-Identifier: AGPL-3.0-or-later
#pragma once
#include <vector>

#include "meshing/core/triangle_mesh.h"
#include "meshing/polycube/boundary_layer.h"
#include "meshing/polycube/polycube_map.h"

namespace shellgrid {

// Where the corners of a polycube's blocks (n×3, in the order of refine_blocks(blocks, 1)) begin when the polycube
// follows the object only roughly: its cubes are transported onto the object's volume with the least sum of squared
// ways, so that an ear finds the ear although it lies cubes apart, and the ways smoothed over neighbouring cubes.
// `surface` is closed, in units of block edges from the polycube's origin, and so is the result.
// Source: [Cuturi2013] entropic transport by Sinkhorn's scaling.
VertexMatrix transport_start(const std::vector<Vec3i>& blocks, const TriangleMesh& surface);

// As map_polycube and add_boundary_layer, for polycubes that follow the object only roughly: once from the lattice and
// once from where the transport puts the blocks' corners; of the two, the valid one, or the one whose boundary and the
// surface are nearer to each other.
LayeredGrid layer_rough_polycube(const std::vector<Vec3i>& blocks, int cells_per_block, const TargetSurface& surface,
                                 const PolycubeMapOptions& options, Progress& progress = no_progress());

}  // namespace shellgrid
