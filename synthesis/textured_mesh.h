// SPDX-License-Identifier: AGPL-3.0-or-later
#pragma once
#include <string>

#include "meshing/core/triangle_mesh.h"
#include "synthesis/shell_resampling.h"
#include "synthesis/surface_synthesis.h"

namespace shellgrid {

// The mesh with properties `texture_u texture_v` (texels), `direction_x direction_y direction_z`, `s t` (u/n_x, v/n_y),
// `quality` (coherence) and `red green blue` (the sample's topmost material).
AttributedMesh attach_texture(const SurfaceTexture& texture, const TextonSet& textons);

// Reads these properties back, and where they are there `sample` and `scale`. name: the file's, for messages.
// Throws: InputError where one is missing or not finite, or a direction is zero.
TexturedMesh detach_texture(const AttributedMesh& mesh, const std::string& name);

// Views: closed meshes with `red green blue` and `quality`.
// The outside of the sample's material, coloured by diffuse reflectance; quality: depth, mm.
AttributedMesh view_sample(const MaterialSample& sample);
// A slab with the appearance's first components as colours on top and textons below; quality: the texton's label.
AttributedMesh view_textons(const TextonSet& textons);
// The mesh, coloured by the first shell voxel with matter below each vertex, shaded by relief; quality: reduced
// extinction there (green), mm⁻¹.
AttributedMesh view_shell(const TexturedMesh& mesh, const ShellVolume& shell);

// Share of the vertices below which the shell, with relief, holds free space down to its bottom: where the object is
// thinner than the relief is deep, and where the sample has holes.
double share_without_matter(const TexturedMesh& mesh, const ShellVolume& shell);

}  // namespace shellgrid
