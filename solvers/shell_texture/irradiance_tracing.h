// SPDX-License-Identifier: AGPL-3.0-or-later
// The shell texture function of a base volume, by light paths.
#pragma once
#include <cstdint>
#include <functional>
#include <vector>

#include "meshing/core/progress.h"
#include "solvers/shell_texture/base_volume.h"
#include "solvers/shell_texture/irradiance_sums.h"
#include "solvers/shell_texture/shell_texture.h"

namespace shellgrid {

enum class IrradianceEstimator {
  shared_walks,  // I_m by walks that serve all directions; I_s marched
  track_length,  // I_m by expected ways through voxels, each direction for itself: the judge; I_s marched
  sphere         // the paper's: collisions within a sphere of one voxel's radius [STF §5.2]; biased near the surface
};

struct IrradianceOptions {
  IrradianceEstimator estimator = IrradianceEstimator::shared_walks;
  LightDirections directions;
  double paths = 16;        // a texel, at least: of each direction, or in all where they are shared
  double most_paths = 1e5;  // a texel, at most
  // Median relative error of I_m over voxels and directions; 0: none. Smoothed, also three times that of layers' sums.
  double target_error = 0;
  bool smooth = true;         // of shared walks: shrink what their halves do not agree on [irradiance_smoothing.h]
  int march_rays = 8;         // along x and y of a texel, at most, for I_s
  double march_error = 0.01;  // rays double until I_s changes by less
  std::uint64_t seed = 0;
  std::function<bool()> interrupted;                      // asked between batches; may be empty
  std::function<void(const IrradianceSums&)> checkpoint;  // gets the sums about once a minute; may be empty
};

// Of each direction, the shares of its light (of the light across the tile), mean of the channels.
struct DirectionBalance {
  double absorbed = 0, left_above = 0, left_below = 0;
};

struct IrradianceReport {
  double paths = 0, back_paths = 0;       // in all, or of each direction; from below
  double median_error = -1;               // relative error of I_m; −1: unknown
  double back_error = -1;                 // of I_m(ω_b)
  int march_rays = 0;                     // rays a texel, of the direction with most
  std::vector<DirectionBalance> balance;  // of each direction, then of the light from below
  bool interrupted = false;
};

// Sums for this volume and these options, without paths yet.
IrradianceSums empty_sums(const BaseVolume& volume, const IrradianceOptions& options);

// Goes on from `sums`: the result is a function of volume, options and the number of batches alone, at any thread
// count, however often it was interrupted. The error is judged where it may have come to its target, after numbers of
// batches that grow by a sixteenth.
// Throws: InputError; also where it was interrupted before the first batches had ended.
ShellTexture trace_irradiance(const BaseVolume& volume, const IrradianceOptions& options, IrradianceSums& sums,
                              IrradianceReport* report = nullptr, Progress& progress = no_progress());
ShellTexture trace_irradiance(const BaseVolume& volume, const IrradianceOptions& options,
                              IrradianceReport* report = nullptr, Progress& progress = no_progress());

}  // namespace shellgrid
