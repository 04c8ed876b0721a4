// SPDX-License-Identifier: AGPL-3.0-or-later
#pragma once
#include <cstdint>
#include <vector>

#include "synthesis/principal_components.h"

namespace shellgrid {

// For each texel of a sample that wraps around, the k texels nearest in appearance, best first, each at least
// `separation` texels from the texel itself and from each other; −1 where none is left. Exact; of texels equally alike
// the lowest comes first. Source: [Tong2002 §4].
// appearance: width·height rows of 8; texel (x, y) stands at y·width + x.
std::vector<std::int32_t> find_candidates(const RowMatrixf& appearance, int width, int height, int k, int separation);

}  // namespace shellgrid
