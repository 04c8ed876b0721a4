// SPDX-License-Identifier: AGPL-3.0-or-later
// Noise taken from a function of place and direction that walks have told twice over.
#pragma once
#include <vector>

#include "meshing/core/vec.h"

namespace shellgrid {

// Where and of what a function has values. Voxels (i, j, k) with i fastest; the slab repeats along i and j.
struct FunctionGrid {
  Vec3i size = Vec3i::Zero();
  int rings = 1, turns = 1;   // of directions; those of a ring one after the other, evenly around
  std::vector<float> weight;  // by voxel: how much of it counts; 0: it has no values
};

struct SmoothedFunction {
  std::vector<float> value;  // as what it was made of
  // Voxels × directions: root of the expected squared error of the mean over the channels, noise and what smoothing
  // takes away together; the mean of its square over the ring and nearby voxels.
  std::vector<float> error;
};

// `first` and `second`: independent estimates of one function, at (3 voxel + channel) · directions +
// direction. The function is told by the waves around each ring and by the channels' mean and differences, each of
// them by details on three scales, after division by a smooth magnitude; a detail keeps the share S / (S + N), with S
// the mean of the halves' product nearby and N the variance of their mean, so that what halves agree on stays as it is;
// then the same with S told by what was kept, of a smaller place.
// Each layer's means over the voxels, by their weights, stay what they are, of each channel and direction. Error: with
// F of a half's details and y as given, E[(F₁ − y₂)(F₂ − y₁) + (F₁ − F₂)(y₁ − y₂)] is the squared bias and
// (F₁ − F₂)² share (1 − share) the noise left in the mean, but for the shares, which both halves tell: a few per cent.
// Sources: shrinkage of wavelets [Wiener1949; Starck2007], twice [Ghael1997]; two halves as each other's judge
// [Rousselle2012]. `first_share`: of what both are made of, the first's. The same at any thread count.
SmoothedFunction smooth_function(const FunctionGrid& grid, const std::vector<float>& first,
                                 const std::vector<float>& second, float first_share = 0.5f);

}  // namespace shellgrid
