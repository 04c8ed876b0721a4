// SPDX-License-Identifier: AGPL-3.0-or-later
#pragma once
#include <vector>

#include "meshing/distance/distance_field.h"
#include "meshing/shell/shell_volume.h"
#include "synthesis/material_sample.h"
#include "synthesis/shell_coordinates.h"

namespace shellgrid {

struct ShellStatistics {
  long leaves = 0;           // allocated
  long possible_leaves = 0;  // cells of the top array
  long voxels = 0;           // active
  long free_voxels = 0;      // of these, free space
  std::size_t bytes = 0;     // of all grids
  double skipped_share = 0;  // of the distance band's samples that no shell voxel was made of
  // Against nearest coordinates: zero where these were asked for.
  double incoherent_share = 0;      // of voxels: below triangles whose vertices do not continue each other
  double changed_share = 0;         // that are another voxel of the sample
  double extinction_rms = 0;        // root mean square difference of σ_t', mm⁻¹, of all voxels and channels
  double albedo_rms = 0;            // and of α'
  double extinction_deviation = 0;  // standard deviations of σ_t' and α' over the shell, to compare with
  double albedo_deviation = 0;
};

// Resamples the shell on the distance field's grid: each grid point inside the object no deeper than `thickness` gets
// the texture coordinate (t_u, t_v, d/d_0) of its nearest point of the surface, by `coordinates`, and the sample's
// voxel there. Leaves without such points are not allocated. Mesostructure normals turn into the object's frame.
// Source: [STF §6, fig. 5].
// samples: at least one, by the mesh's numbers, of one voxel size; depth counts in voxels whatever the scale.
// thickness: mm, > 0. Throws: InputError where voxel sizes differ, the band is thinner than the shell, or the distance
// field belongs to another mesh.
ShellVolume resample_shell(const TexturedMesh& mesh, const DistanceField& distance,
                           const std::vector<const MaterialSample*>& samples, const Material& core, double thickness,
                           ShellCoordinates coordinates, ShellStatistics* statistics = nullptr,
                           Progress& progress = no_progress());

// The sample's voxel at a shell coordinate: texels wrap around, depths beyond the sample give its bottom layer.
std::size_t sample_voxel(const MaterialSample& sample, const Vec3f& texture_coordinate);

}  // namespace shellgrid
