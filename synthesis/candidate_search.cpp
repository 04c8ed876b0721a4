// SPDX-License-Identifier: AGPL-3.0-or-later
#include "synthesis/candidate_search.h"

#include <algorithm>
#include <array>
#include <limits>

#include "meshing/core/error.h"
#include "meshing/core/parallel.h"
#include "synthesis/appearance_tree.h"

namespace shellgrid {
namespace {

constexpr int dimension = AppearanceTree::dimension;
using Point = AppearanceTree::Point;

}  // namespace

std::vector<std::int32_t> find_candidates(const RowMatrixf& appearance, const SampleLayers& layers,
                                          const std::vector<int>& sources, const std::vector<int>& targets, int k,
                                          int separation) {
  if (appearance.cols() != dimension || appearance.rows() != static_cast<Eigen::Index>(layers.texel_count()))
    throw InternalError("appearance vectors of a wrong shape");
  std::vector<std::int32_t> members, queries;
  for (int layer : targets)
    for (int i = 0; i < layers[layer].texel_count(); ++i) members.push_back(layers[layer].first + i);
  for (int layer : sources)
    for (int i = 0; i < layers[layer].texel_count(); ++i) queries.push_back(layers[layer].first + i);
  const AppearanceTree tree(appearance, std::move(members));
  // Of the disc of texels less than `separation` away, row by row.
  const int reach = separation - 1;
  std::vector<int> half_width(separation);
  for (int dy = 0; dy <= reach; ++dy)
    while ((half_width[dy] + 1) * (half_width[dy] + 1) + dy * dy < separation * separation) ++half_width[dy];
  std::vector<std::int32_t> result(queries.size() * k, -1);
  parallel_chunks(queries.size(), 256, [&](std::size_t begin, std::size_t end) {
    std::vector<std::int32_t> taken_for(layers.texel_count(), -1);  // too near a place taken
    for (std::size_t query = begin; query < end; ++query) {
      const std::int32_t self = queries[query];
      const auto take = [&](std::int32_t t) {
        const SampleLayer& layer = layers[layers.layer_of(t)];
        const int x = (t - layer.first) % layer.width, y = (t - layer.first) / layer.width;
        for (int dy = -reach; dy <= reach; ++dy) {
          const int sy = (y + dy % layer.height + layer.height) % layer.height;
          std::int32_t* row = &taken_for[layer.first + static_cast<std::size_t>(sy) * layer.width];
          const int half = half_width[std::abs(dy)];
          if (2 * half + 1 >= layer.width) {
            std::fill(row, row + layer.width, self);
            continue;
          }
          const int first = x - half, last = x + half;
          std::fill(row + std::max(first, 0), row + std::min(last, layer.width - 1) + 1, self);
          if (first < 0) std::fill(row + first + layer.width, row + layer.width, self);
          if (last >= layer.width) std::fill(row, row + last - layer.width + 1, self);
        }
      };
      const auto allowed = [&](std::int32_t t) { return taken_for[t] != self; };
      const Point own = appearance.row(self).transpose().array();
      const std::int32_t* before = query > begin ? result.data() + (query - 1) * k : nullptr;
      take(self);
      for (int i = 0; i < k; ++i) {
        // What the texel before found bounds the search and changes nothing else.
        float distance = std::numeric_limits<float>::max();
        std::int32_t best = std::numeric_limits<std::int32_t>::max();
        if (before) {
          for (int j = 0; j < k; ++j) {
            if (before[j] < 0) continue;
            const SampleLayer& layer = layers[layers.layer_of(before[j])];
            const std::int32_t at = before[j] - layer.first;
            const std::int32_t guess = layer.first + at / layer.width * layer.width + (at + 1) % layer.width;
            if (!allowed(guess)) continue;
            const float bound = (appearance.row(guess).transpose().array() - own).square().sum() * (1 + 1e-5f) + 1e-30f;
            distance = std::min(distance, bound);
          }
        }
        tree.nearest(own, allowed, distance, best);
        if (best == std::numeric_limits<std::int32_t>::max()) break;
        result[query * k + i] = best;
        take(best);
      }
    }
  });
  return result;
}

}  // namespace shellgrid
