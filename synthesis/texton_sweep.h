// SPDX-License-Identifier: AGPL-3.0-or-later
#pragma once
#include <vector>

#include "synthesis/tangent_neighbours.h"
#include "synthesis/texton_set.h"

namespace shellgrid {

struct TextonSweepOptions {
  int neighbourhood = 7;  // places across a neighbourhood, texels, odd
  int coherence = 5;      // k: windows of the texton map most like a neighbour's, each a candidate
  std::uint64_t seed = 0;
};

// The paper's way: vertex after vertex, in the order of their distance from a first one, takes the texel whose
// surroundings in the texton map are most like what is there already around the vertex. Its surroundings are flattened
// to the tangent plane and their textons interpolated on a grid; distances of textons come from a table of dot
// products; candidates are the continuations of the neighbours there and of the k places most like these. Source: [STF
// §6], [Tong2002 §4]. Deviates: the labels are the clusters of the level's appearance vectors, which stand for the
// filters of [Tong2002 §3]. place: n, of every mesh vertex, is filled. Returns how many neighbourhoods were compared.
// Throws: InputError for several samples, or textons that hold turned layers.
long sweep_textons(const TexturedSurface& surface, const TextonSet& textons, const TextonSweepOptions& options,
                   std::vector<LayerPlace>& place);

}  // namespace shellgrid
