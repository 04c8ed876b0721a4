// SPDX-License-Identifier: AGPL-3.0-or-later
#pragma once
#include <vector>

#include "meshing/core/grid_frame.h"
#include "meshing/core/triangle_mesh.h"

namespace shellgrid {

// The boundary of a set of voxels as a smooth surface: one vertex in each cell of eight voxel centres of both kinds,
// two triangles across each pair of neighbours of which one belongs. Vertices are drawn towards their neighbours but
// stay within their cells, so that single voxels and walls of one voxel keep their place. Closed, outward normals;
// empty where there are no voxels. Voxels in any order, without repetition; those of a frame, mm.
// Source: surface nets [Gibson1998], smoothed as [Taubin1995].
TriangleMesh voxel_boundary(const GridFrame& frame, const std::vector<Vec3i>& voxels);

}  // namespace shellgrid
