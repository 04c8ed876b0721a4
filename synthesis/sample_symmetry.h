// SPDX-License-Identifier: AGPL-3.0-or-later
#pragma once
#include <cstdint>

#include "synthesis/principal_components.h"

namespace shellgrid {

// How a sample looks when it is turned about its depth.
struct SampleSymmetry {
  int symmetry = 1;         // it looks alike after turns by 360°/symmetry: 1, 2 or 4
  double half_turn = 0;     // unlikeness after a half turn over that of the sample to itself
  double quarter_turn = 0;  // and after quarter turns
};

// Compares windows of the sample, turned, with those as they are: mean distance of one to its nearest, at windows of
// 5×5 texels, at once, twice and four times the step, over the same for windows that are not turned (none near itself).
// The sample counts as symmetric where the first is at most `tolerance` times the second. maps: n×d features of a
// sample that wraps around, texel (x, y) in row y·width + x.
SampleSymmetry find_symmetry(const RowMatrixf& maps, int width, int height, std::uint64_t seed,
                             double tolerance = 1.25);

// n×(25·d): each texel's weighted 5×5 window at distance `step`. Distances fall off with σ = 2 texels.
RowMatrixf weighted_windows(const RowMatrixf& maps, int width, int height, int step);

// Blurs with [1 4 6 4 1]/16 at the given step, wrapping around.
RowMatrixf blur_maps(const RowMatrixf& maps, int width, int height, int step);

}  // namespace shellgrid
