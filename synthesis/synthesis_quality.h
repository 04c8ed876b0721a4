// SPDX-License-Identifier: AGPL-3.0-or-later
#pragma once
#include "synthesis/surface_synthesis.h"

namespace shellgrid {

// How well a surface shows its sample. A window is the 5×5 places a texel apart around a vertex; its distance is that
// to the nearest window of the sample, over the variance of windows.
struct SynthesisQuality {
  double window_distance = 0;  // mean over vertices drawn by hash
  double random = 0;           // the same for texels drawn at random: the worst
  double tiling = 0;           // the same for an exact copy of the sample on this mesh: the best
  double coherence = 0;        // mean share of neighbours that continue a vertex's patch
  double texel_entropy = 0;    // of the texels' use, over its greatest possible value; low where few are repeated
  int patches = 0;             // connected sets of vertices that continue each other
  double median_patch = 0;     // vertices of the patch that the median vertex lies in
};

// vertex_count: how many windows are compared.
SynthesisQuality measure_synthesis(const SurfaceTexture& texture, const TextonSet& textons, int vertex_count = 256,
                                   std::uint64_t seed = 0);

}  // namespace shellgrid
