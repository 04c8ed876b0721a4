// SPDX-License-Identifier: AGPL-3.0-or-later
#pragma once
#include <vector>

#include "synthesis/surface_synthesis.h"

namespace shellgrid {

// Distances of windows, places×places points `step` texels apart around a vertex, to the nearest window of the sample,
// over the variance of the sample's windows; means over vertices drawn by hash.
struct WindowDistance {
  int places = 5, step = 1;
  double synthesized = 0;
  double random = 0;  // of texels drawn at random: the worst
  double tiling = 0;  // of an exact copy of the sample on this mesh: the best
};

// How well a surface shows its sample.
struct SynthesisQuality {
  double window_distance = 0, random = 0, tiling = 0;  // of 5×5 windows of neighbouring texels
  std::vector<WindowDistance> wider;                   // of 7×7 windows, and of 7×7 points over `wide` texels
  double at_singularities = 0;                         // window_distance within 3 texels of the field's singularities
  double elsewhere = 0;                                // and of all other vertices; both 0 without singularities
  // χ² = Σ (p − q)² / (p + q) between the textons' shares p of the surface and q of the sample: 0 alike, 2 disjoint.
  double texton_chi_squared = 0;
  // Root mean square difference of the features' autocorrelation, 1, 2, 4 and 8 texels along u, v and both diagonals.
  double autocorrelation_error = 0;
  double coherence = 0;      // mean share of neighbours that continue a vertex's patch
  double texel_entropy = 0;  // of the texels' use, over its greatest possible value; low where few are repeated
  double patch_entropy = 0;  // of the vertices' patches, over its greatest value: 0 one patch, 1 all alone
  int patches = 0;           // connected sets of vertices that continue each other
  double median_patch = 0;   // vertices of the patch that the median vertex lies in
};

struct QualityOptions {
  int windows = 256;  // vertices at which windows are compared
  int wide = 0;       // texels across the widest window; 0 takes half of the sample's lesser side
  std::uint64_t seed = 0;
};

// For each of the vertices the distance of its 5×5 window to the samples' nearest, over their variance.
std::vector<double> window_distances(const SurfaceTexture& texture, const TextonSet& textons,
                                     const std::vector<int>& vertices);

// Source: [STF §6] for what is compared; the figures are our own.
SynthesisQuality measure_synthesis(const SurfaceTexture& texture, const TextonSet& textons,
                                   const QualityOptions& options = {});

}  // namespace shellgrid
