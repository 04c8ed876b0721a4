// SPDX-License-Identifier: AGPL-3.0-or-later
#pragma once
#include <cstdint>
#include <vector>

#include "meshing/core/progress.h"
#include "synthesis/material_sample.h"
#include "synthesis/sample_layers.h"
#include "synthesis/sample_symmetry.h"

namespace shellgrid {

// What synthesis knows of one or several samples: for each texel T(x, y), a stack of n_z voxels, short vectors whose
// distances say how alike two places look, also two of different samples. Texels stand as `layers` says.
struct TextonSet {
  static constexpr int dimension = 8;  // of an appearance vector, padded with zeros

  // Level l compares neighbourhoods 2^l times as wide.
  struct Level {
    std::vector<float> appearance;         // n·8: a texel's weighted 5×5 window at distance 2^l, reduced
    std::vector<std::int32_t> candidates;  // n·(k·samples): texels that look most alike, best first, k of each sample
  };
  SampleLayers layers;
  double voxel = 1;                   // d_0, mm
  int candidate_count = 0;            // k
  std::vector<Level> levels;          // finest first
  std::vector<float> features;        // n·8: a texel's own voxel stack, reduced, without its neighbours
  std::vector<std::int32_t> textons;  // n: label of the texel's texton
  int texton_count = 0;
  std::vector<Vec3f> color;  // n: sRGB code values 0 … 255 of the topmost material

  int texel_count() const { return layers.texel_count(); }
  int candidates_each() const { return candidate_count * layers.sample_count; }
};

struct TextonOptions {
  int candidate_count = 3;    // k, 1 … 8
  int separation = 5;         // least distance between a texel and its candidates, and between these, texels
  int texton_count = 400;     // clusters
  bool quantize = false;      // replace each appearance by its texton's centre, as the paper does
  int least_coarse_size = 8;  // texels across the coarsest level
  int symmetry = 1;           // turns by 360°/symmetry under which the samples may be laid: 1, 2, 4; 0 recognises them
  std::uint64_t seed = 0;
};

struct TextonStatistics {
  double feature_variance_kept = 0;              // share of the stacks' variance that the features carry
  std::vector<double> appearance_variance_kept;  // the same of the windows, by level
  double texton_error = 0;                       // mean squared distance to the texton's centre over the variance
  std::vector<SampleSymmetry> symmetry;          // of each sample, where it was to be recognised
};

// Features (log σ_t', diffuse reflectance of α', occupancy of each voxel of a stack) → principal components →
// Gaussian stack → 5×5 windows → principal components; textons by K-means; candidates by exact search. Several samples
// share their components and may be each other's candidates; a thinner one's bottom layer goes on below.
// Source: [STF §6], [LefebvreHoppe2006 §3], [Tong2002 §4].
// Deviates: α' enters as the reflectance it causes, since equal steps of α' near one look very unequal.
// Throws: InputError where a sample is too small for the candidates, or the samples' voxels differ.
TextonSet make_textons(const std::vector<const MaterialSample*>& samples, const TextonOptions& options,
                       TextonStatistics* statistics = nullptr, Progress& progress = no_progress());
TextonSet make_textons(const MaterialSample& sample, const TextonOptions& options,
                       TextonStatistics* statistics = nullptr, Progress& progress = no_progress());

// sRGB colours 0 … 255 of the topmost material voxel of each texel: what the sample looks like from above.
std::vector<Vec3f> top_colors(const MaterialSample& sample);

}  // namespace shellgrid
