// SPDX-License-Identifier: AGPL-3.0-or-later
#pragma once
#include <cstdint>
#include <vector>

#include "synthesis/principal_components.h"
#include "synthesis/sample_layers.h"

namespace shellgrid {

// For each texel of `sources`, the k texels of `targets` nearest in appearance, best first, each at least `separation`
// texels from the texel itself and from each other in its layer; −1 where none is left. Exact; of texels equally alike
// the lowest comes first. Source: [Tong2002 §4].
// appearance: a row of 8 for each texel of all layers. Returns k a texel, source after source.
std::vector<std::int32_t> find_candidates(const RowMatrixf& appearance, const SampleLayers& layers,
                                          const std::vector<int>& sources, const std::vector<int>& targets, int k,
                                          int separation);

}  // namespace shellgrid
