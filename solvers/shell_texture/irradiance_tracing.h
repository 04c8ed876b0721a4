// SPDX-License-Identifier: AGPL-3.0-or-later
// The shell texture function of a base volume, by light paths.
#pragma once
#include <cstdint>
#include <functional>
#include <vector>

#include "meshing/core/progress.h"
#include "solvers/diffusion/channel_lanes.h"
#include "solvers/shell_texture/base_volume.h"
#include "solvers/shell_texture/shell_texture.h"

namespace shellgrid {

enum class IrradianceEstimator {
  track_length,  // I_m: expected ways through voxels; I_s: marched, without noise
  sphere         // the paper's: collisions within a sphere of one voxel's radius [STF §5.2]; biased near the surface
};

struct IrradianceOptions {
  IrradianceEstimator estimator = IrradianceEstimator::track_length;
  LightDirections directions;
  double paths = 1;          // of each direction and texel, at least
  double most_paths = 1000;  // at most
  double target_error = 0;   // median relative standard error of I_m over voxels and directions; 0: none
  int march_rays = 8;        // along x and y of a texel, for I_s
  std::uint64_t seed = 0;
  std::function<bool()> interrupted;  // asked between rounds; may be empty
};

// Of each direction, the shares of its light (of the light across the tile), mean of the channels.
struct DirectionBalance {
  double absorbed = 0, left_above = 0, left_below = 0;
};

struct IrradianceReport {
  double paths = 0;                       // of each direction
  double median_error = -1;               // relative standard error of I_m; −1: unknown
  std::vector<DirectionBalance> balance;  // of each direction, then of the light from below
  bool interrupted = false;
};

// Same volume, options: same bits at any thread count. Throws: InputError.
ShellTexture trace_irradiance(const BaseVolume& volume, const IrradianceOptions& options,
                              IrradianceReport* report = nullptr, Progress& progress = no_progress());

}  // namespace shellgrid
