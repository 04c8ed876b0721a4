// SPDX-License-Identifier: AGPL-3.0-or-later
#pragma once
#include "meshing/polycube/voxel_polycube.h"

namespace shellgrid {

// The voxel polycube whose count of blocks is nearest to options.blocks, each of options.grid³ cells, as the paper
// counts its polygrids: searches the blocks' size. options.nodes does not matter. How many blocks an object takes
// jumps with their size, so that the count is met within a few parts in a hundred. Source: [Diffusion table III].
// Throws: as build_voxel_polycube.
VoxelPolycube build_counted_polycube(const TriangleMesh& surface, PolycubeOptions options,
                                     Progress& progress = no_progress());

// Nodes of the polygrid: cell centres, and one boundary node for each of the cells' outer faces.
long polygrid_nodes(const VoxelPolycube& polycube);

}  // namespace shellgrid
