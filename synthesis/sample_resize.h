// SPDX-License-Identifier: AGPL-3.0-or-later
#pragma once
#include "synthesis/material_sample.h"

namespace shellgrid {

// The sample beside its mirror images, twice as wide and high: what does not tile does afterwards. Source: [STF §8].
MaterialSample mirror_sample(const MaterialSample& sample);

// Whole periods side by side. times_x, times_y: ≥ 1.
MaterialSample repeat_sample(const MaterialSample& sample, int times_x, int times_y);

// `layers` of them: more continue the bottom layer, fewer cut lower ones off. layers: ≥ 1.
MaterialSample with_layers(const MaterialSample& sample, int layers);

// Part of a sample: `size` voxels from `first` on. Throws: InputError where it reaches beyond.
MaterialSample crop_sample(const MaterialSample& sample, const Vec3i& first, const Vec3i& size);

}  // namespace shellgrid
