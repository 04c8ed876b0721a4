// SPDX-License-Identifier: AGPL-3.0-or-later
// Each kind of procedural material fills an allocated sample; the kinds that are no solid blocks mark its surface too.
#pragma once
#include <algorithm>

#include "synthesis/procedural_sample.h"

namespace shellgrid {

inline double smooth_step(double x) {
  x = std::clamp(x, 0.0, 1.0);
  return x * x * (3 - 2 * x);
}

void fill(MaterialSample& sample, const MarblePattern& pattern, const SampleDefinition& definition);
void fill(MaterialSample& sample, const SpotsPattern& pattern, const SampleDefinition& definition);
void fill(MaterialSample& sample, const LayersPattern& pattern, const SampleDefinition& definition);
void fill(MaterialSample& sample, const BumpsPattern& pattern, const SampleDefinition& definition);
void fill(MaterialSample& sample, const WoodPattern& pattern, const SampleDefinition& definition);
void fill(MaterialSample& sample, const CellsPattern& pattern, const SampleDefinition& definition);
void fill(MaterialSample& sample, const GrassPattern& pattern, const SampleDefinition& definition);
void fill(MaterialSample& sample, const WeavePattern& pattern, const SampleDefinition& definition);

// How deep a pattern's mesostructure needs the sample to be, mm; 0 for solid blocks. Throws: InputError where yarns do
// not make whole repeats.
double needed_depth(const BumpsPattern& pattern, double voxel);
double needed_depth(const GrassPattern& pattern, double voxel);
double needed_depth(const WeavePattern& pattern, double voxel);
template <class Solid>
double needed_depth(const Solid&, double) {
  return 0;
}

}  // namespace shellgrid
