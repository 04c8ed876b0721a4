// SPDX-License-Identifier: AGPL-3.0-or-later
#pragma once
#include <array>
#include <cstdint>
#include <vector>

#include "meshing/polycube/block_grid.h"
#include "meshing/polycube/block_masks.h"
#include "meshing/polycube/sample_raster.h"

namespace shellgrid {

// Which neighbouring blocks hold the same part of an object. A block stands for the largest connected set of its
// samples; two blocks that share a face are parted where these sets are not connected within the blocks around both,
// though both go on beyond: filling both would join what is apart, like two fingers that nearly touch.
class BlockParts {
 public:
  static constexpr int samples_per_block = BlockMask::samples_per_block;

  // Blocks of 4×4×4 samples, block (0, 0, 0) beginning at sample `shift`.
  BlockParts(const SampleRaster& raster, const BlockMasks& masks, const Vec3i& shift, const Vec3i& counts);

  // Part of each block's samples that lie inside, indexed as in BlockGrid.
  const std::vector<float>& fractions() const { return fraction_; }

  // Whether the block and its neighbour towards + `axis` are parted. Blocks without samples are parted from none.
  bool are_parted(const Vec3i& block, int axis) const { return parted_[index(block)] >> axis & 1; }
  // Whether a filled block shares a face with a filled block that it is parted from, or has no samples and lies between
  // filled ones that are not connected around it.
  bool joins_parts(const BlockGrid& grid, const Vec3i& block) const;

 private:
  using Mask = std::uint64_t;  // bit x + 4y + 16z
  std::size_t index(const Vec3i& b) const {
    return (static_cast<std::size_t>(b.z()) * size_.y() + b.y()) * size_.x() + b.x();
  }
  // Whether the main parts of two blocks are connected within the box of blocks from `low` to `high`.
  bool are_connected(const Vec3i& a, const Vec3i& b, const Vec3i& low, const Vec3i& high) const;

  const SampleRaster& raster_;
  Vec3i shift_, size_;
  std::vector<Mask> main_;  // each block's largest connected set of samples
  std::vector<float> fraction_;
  std::vector<std::uint8_t> parted_;  // bit per axis
};

}  // namespace shellgrid
