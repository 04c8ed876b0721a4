// SPDX-License-Identifier: AGPL-3.0-or-later
#pragma once
#include <string>

#include "meshing/polycube/given_polycube.h"

namespace shellgrid {

// Reads the cubes of a user's own polycube by the file's extension:
//   .json  a list of [x, y, z], or {"cubes": that list, "origin": [x, y, z] in mm, "edge": mm};
//   .txt   three integers a line; `#` begins a comment;
//   .hdf   a polycube.hdf, of which the blocks and their place are taken;
//   .ply .off .obj .stl  a closed surface of axis-aligned cubes;
//   .vdb   the active voxels above 0 of its first float or int32 grid.
// Throws: InputError for another extension, a malformed file, no cubes.
CubeList read_cube_list(const std::string& path);

}  // namespace shellgrid
