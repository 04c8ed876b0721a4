// SPDX-License-Identifier: AGPL-3.0-or-later
// Shell texture functions as files.
#pragma once
#include <memory>

#include "meshing/formats/mesh_file.h"
#include "meshing/formats/vdb_file.h"
#include "solvers/shell_texture/shell_texture.h"
#include "solvers/shell_texture/shell_texture_lookup.h"

namespace shellgrid {

// Grids `single_LL` of each direction, `multiple_LL` of each direction, `multiple_back`, `error` (relative standard
// error of I_m, root mean square over the directions; −1 where nothing is known), `matter` and `below` (its layers are
// the directions); metadata `size voxel rings turns`. Kernels, if any: grid `kernel` (its number, a texel) and metadata
// `kernel_sizes` (kernels, bands, rings, a ring's width in mm), `kernel_layers`, `kernel_values`. Without loss but for
// the errors of the single directions.
VdbArchive archive_shell_texture(const ShellTexture& texture);
// parts: all of it, or only what passes through the sample's bottom: then `single`, `multiple` and `error` stay empty.
// Throws: InputError where the archive is not what archive_shell_texture wrote.
enum class ShellTextureParts { bottom, all };
ShellTexture restore_shell_texture(const VdbArchive& archive, ShellTextureParts parts = ShellTextureParts::all);
// The function ready to be looked up, without a copy of it between. Throws as above.
std::unique_ptr<ShellTextureLookup> look_up_archive(const VdbArchive& archive);
// The grids that are needed for them.
std::vector<std::string> shell_texture_grids(ShellTextureParts parts);  // empty: all there are

// The voxels' centres, coloured as light from straight above lights them; `quality`: the error.
AttributedMesh view_shell_texture(const ShellTexture& texture);

}  // namespace shellgrid
