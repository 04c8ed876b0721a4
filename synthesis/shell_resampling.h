// SPDX-License-Identifier: AGPL-3.0-or-later
#pragma once
#include <vector>

#include "meshing/distance/distance_field.h"
#include "meshing/shell/shell_volume.h"
#include "synthesis/material_sample.h"

namespace shellgrid {

// A surface that carries a sample: what sg-synthesize writes.
struct TexturedMesh {
  TriangleMesh mesh;
  VertexMatrix normals;           // n×3, unit
  VertexMatrix directions;        // n×3, unit, tangent: texture u; texture v is normal × direction
  std::vector<Vec2f> coordinate;  // n, texels
};

struct ShellStatistics {
  long leaves = 0;           // allocated
  long possible_leaves = 0;  // cells of the top array
  long voxels = 0;           // active
  long free_voxels = 0;      // of these, free space
  std::size_t bytes = 0;     // of all grids
  double skipped_share = 0;  // of the distance band's samples that no shell voxel was made of
};

// Resamples the shell on the distance field's grid: each grid point inside the object no deeper than `thickness` gets
// the texture coordinate (t_u, t_v, d/d_0) of the vertex nearest to its nearest point, and the sample's voxel there.
// Leaves without such points are not allocated. Mesostructure normals turn into the object's frame.
// Source: [STF §6, fig. 5].
// thickness: mm, > 0. Throws: InputError where voxel sizes differ, the band is thinner than the shell, or the distance
// field belongs to another mesh.
ShellVolume resample_shell(const TexturedMesh& mesh, const DistanceField& distance, const MaterialSample& sample,
                           const Material& core, double thickness, ShellStatistics* statistics = nullptr,
                           Progress& progress = no_progress());

// The sample's voxel at a shell coordinate: texels wrap around, depths beyond the sample give its bottom layer.
std::size_t sample_voxel(const MaterialSample& sample, const Vec3f& texture_coordinate);

}  // namespace shellgrid
