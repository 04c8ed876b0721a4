// SPDX-License-Identifier: AGPL-3.0-or-later
#pragma once
#include "meshing/core/triangle_mesh.h"
#include "meshing/formats/vdb_file.h"
#include "synthesis/material_sample.h"
#include "synthesis/texton_set.h"

namespace shellgrid {

// A base volume as an archive: grids `extinction albedo anisotropy normal kind`, grid point (x, y, z) for voxel
// (x, y, z), every voxel active, and metadata. Without loss.
VdbArchive archive_sample(const MaterialSample& sample);
// Throws: InputError where the archive is not what archive_sample wrote.
MaterialSample restore_sample(const VdbArchive& archive);
// Whether archive_sample wrote it.
bool is_sample_archive(const VdbArchive& archive);

// What a volume from elsewhere leaves open.
struct VolumeImport {
  double extinction_scale = 1;        // of `density`, mm⁻¹ per unit
  Rgb albedo = Rgb::Constant(0.95f);  // where there is no grid `albedo`
  Rgb anisotropy = Rgb::Zero();       // where there is no grid `anisotropy`
  double least_density = 0;           // voxels with no more than this are free space, unless there is a grid `kind`
  double ior = 1.5;
};

// A base volume from any volume: the box of active samples of `extinction` (vec3s or float), or of `density` (float,
// scaled), with `albedo`, `anisotropy`, `kind`, `normal` where they are there. z is depth, its lowest index on top.
// Throws: InputError where neither grid is there, or its box is empty or too large.
MaterialSample import_sample(const VdbArchive& archive, const VolumeImport& options);

// Refuses a volume of which neither of the two can make a sample, as far as its grids' names and its metadata tell:
// those of read_vdb_outline suffice. Throws: InputError.
void require_sample_grids(const VdbArchive& archive);

// Maps of a texton set as grids one voxel thick: `feature_c appearance_l_c candidate_l_k texton color`. Without loss.
VdbArchive archive_textons(const TextonSet& textons);
// Throws: InputError where the archive is not what archive_textons wrote.
TextonSet restore_textons(const VdbArchive& archive);

}  // namespace shellgrid
