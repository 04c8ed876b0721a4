// SPDX-License-Identifier: AGPL-3.0-or-later
#include "meshing/polycube/sample_pieces.h"

#include <algorithm>

#include "meshing/core/parallel.h"
#include "meshing/polycube/block_grid.h"

namespace shellgrid {
namespace {

using Mask = BlockMask::Bits;
constexpr int edge = SamplePieces::samples_per_block;

}  // namespace

SamplePieces::SamplePieces(const BlockMasks& masks, const Vec3i& shift, const Vec3i& counts, bool inside)
    : shift_(shift), counts_(counts) {
  const BlockGrid shape(counts);
  const std::size_t blocks = shape.filled.size();
  std::vector<BlockMask> samples(blocks);
  std::vector<std::vector<Mask>> pieces(blocks);
  parallel_for(
      blocks,
      [&](std::size_t b) {
        samples[b] = masks.at(shift + edge * shape.place(b));
        pieces[b] = samples[b].pieces(inside ? samples[b].inside : ~samples[b].inside);
      },
      1024);
  first_.assign(blocks + 1, 0);
  for (std::size_t b = 0; b < blocks; ++b) first_[b + 1] = first_[b] + static_cast<int>(pieces[b].size());
  masks_.reserve(first_.back());
  for (std::size_t b = 0; b < blocks; ++b)
    for (Mask piece : pieces[b]) masks_.push_back(piece), block_of_.push_back(b);
  neighbours_.resize(masks_.size());
  const std::size_t step[3] = {1, static_cast<std::size_t>(counts.x()),
                               static_cast<std::size_t>(counts.x()) * counts.y()};
  for (std::size_t b = 0; b < blocks; ++b)
    for (int axis = 0; axis < 3; ++axis) {
      if (shape.place(b)[axis] + 1 >= counts[axis]) continue;
      const std::size_t next = b + step[axis];
      const int across = (edge - 1) * BlockMask::stride[axis];
      for (int p = first_[b]; p < first_[b + 1]; ++p) {
        const Mask leaving = (samples[b].open(masks_[p], axis) & ~BlockMask::has_next[axis]) >> across;
        if (!leaving) continue;
        for (int q = first_[next]; q < first_[next + 1]; ++q)
          if (leaving & masks_[q]) neighbours_[p].push_back(q), neighbours_[q].push_back(p);
      }
    }
}

int SamplePieces::piece_of(const Vec3i& sample) const {
  const Vec3i local = sample - shift_;
  if ((local.array() < 0).any() || (local.array() >= edge * counts_.array()).any()) return -1;
  const Vec3i block = local / edge, in = local - edge * block;
  const std::size_t b = (static_cast<std::size_t>(block.z()) * counts_.y() + block.y()) * counts_.x() + block.x();
  const Mask bit = Mask{1} << (in.x() + 4 * in.y() + 16 * in.z());
  for (int p = first_[b]; p < first_[b + 1]; ++p)
    if (masks_[p] & bit) return p;
  return -1;
}

}  // namespace shellgrid
