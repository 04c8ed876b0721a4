// SPDX-License-Identifier: AGPL-3.0-or-later
#pragma once
#include <string>

#include "meshing/polycube/voxel_polycube.h"

namespace shellgrid {

// `polycube.hdf`: one hexahedron a block with the cell array `lattice` (m×3, block coordinates); the file's
// attributes hold spacing, cells_per_block, origin, genera and coverage.
// Throws: InputError for another kind of file, blocks that repeat, or lattice coordinates out of range.
VoxelPolycube read_polycube(const std::string& path);
void write_polycube(const std::string& path, const VoxelPolycube& polycube);

}  // namespace shellgrid
