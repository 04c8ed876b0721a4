// SPDX-License-Identifier: AGPL-3.0-or-later
// Where light that has not been scattered yet reaches the voxels of a slab: marched, from each direction.
#pragma once
#include <cstdint>
#include <vector>

#include "meshing/core/progress.h"
#include "solvers/shell_texture/shell_texture.h"
#include "solvers/shell_texture/slab_walk.h"

namespace shellgrid {

struct BeamOptions {
  LightDirections directions;
  int rays = 8;         // along each side of a texel, at most
  double error = 0.01;  // rays double until the last half's fluence differs by less from the mean, in sum of magnitudes
  std::uint64_t seed = 0;
  bool sources = true;  // gather what shared walks need
};

// Receivers are the voxels, then the texels of the bottom, then all that is above. Of voxels the lengths of beams are
// summed, mm³ for unit irradiance across the direction, of the others the power, mm².
struct BeamField {
  std::size_t voxels = 0, texels = 0;
  int directions = 0, rays_a_texel = 0;  // most of any direction
  // directions × voxels, at direction · voxels + voxel: of light that was only refracted, and of light that was
  // mirrored; then power through the bottom's texels; then what left above.
  std::vector<Vec3f> single, mirrored, below, above;

  // What scatters for the first time, by voxel. Channel c of direction l is at c · directions + l. Positions are within
  // the voxel, in units of it, `spread` the deviation of the light of all directions together, each weighted by
  // 1 / cosine, `middle` its mean; `shift` (mean of the direction's light − middle) / spread.
  struct Mixture {
    float source[3] = {}, middle[3][3] = {}, inverse_spread[3][3] = {};  // by channel, axis
  };
  std::vector<float> source;        // voxels × 3 directions: mm² for unit irradiance
  std::vector<std::int16_t> shift;  // voxels × 9 directions, at (3 c + axis) · directions + l, in units of shift_unit
  std::vector<std::int16_t> course;  // voxels × 3 directions: mean course of the light, in units of course_unit
  std::vector<Mixture> mixture;
  static constexpr float shift_unit = 1.0f / 2048, course_unit = 1.0f / 32000;
};

// The same at any thread count.
BeamField march_beams(const SlabWalk& walk, const BeamOptions& options, Progress& progress = no_progress());

}  // namespace shellgrid
