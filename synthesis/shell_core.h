// SPDX-License-Identifier: AGPL-3.0-or-later
// The core as voxels of the shell's own volume, so that every later stage sees the same one.
#pragma once
#include <vector>

#include "meshing/core/progress.h"
#include "meshing/distance/distance_field.h"
#include "meshing/shell/shell_volume.h"
#include "synthesis/material_sample.h"

namespace shellgrid {

struct CoreStatistics {
  long voxels = 0;
  std::size_t bytes = 0;        // that the volume grew by
  int boundary_triangles = 0;   // mean values: of the core's boundary as it was interpolated from
  double boundary_edge = 0;     // and the edge of the cubes whose vertices were merged, mm
  long synthesized_voxels = 0;  // solid: those near the shell or between slabs; all others tile
  double shell_step = 0;        // solid: mean squared difference of looks between the shell's deepest voxels and the
  double tiling_step = 0;       // core's next to them; the same of a core that tiles right up to the shell; and of
  double sample_step = 0;       // neighbours in the sample
};

// Fills the voxels below the shell with mean value interpolation of the shell's bottom: constants stay constant, and a
// linear course of coefficients goes on linearly. σ_a, σ_s and σ_s g are interpolated, each from the mean of the
// shell's deepest voxels about each vertex of the core's boundary, simplified to about `triangles` faces; in blocks of
// 2³ voxels that share a value. Values stay in the range of the boundary's. Core voxels have `kind` core_voxel_kind and
// a depth beyond the shell's thickness. Throws: InputError for a bottom that holds no matter.
void fill_core_by_mean_values(ShellVolume& shell, const DistanceField& distance, int triangles = 2000,
                              CoreStatistics* statistics = nullptr, Progress& progress = no_progress());

struct SolidCoreOptions {
  int reach = 8;   // voxels below the shell that are synthesised, and about slabs
  int passes = 3;  // at each of the distances 4, 2, 1
  std::uint64_t seed = 0;
};

// Fills the voxels below the shell with the solid: slabs of it lie on each other, each moved sideways at random, since
// it need only repeat in x and y; near the shell, and where slabs meet, each voxel takes the solid's voxel whose 26
// neighbours at distances 4, 2, 1 look most like those about it, of the shell and of the core, so that what the shell
// shows goes on below it. There the solid goes on mirrored beyond its last layer.
// Sought by [Barnes2009] (neighbours' continuations and random voxels). Layers of the solid down to the last with free
// space are left out. Throws: InputError where no layer is left, or its voxel differs from the shell's.
void fill_core_with_solid(ShellVolume& shell, const DistanceField& distance, const MaterialSample& solid,
                          const SolidCoreOptions& options, CoreStatistics* statistics = nullptr,
                          Progress& progress = no_progress());

}  // namespace shellgrid
