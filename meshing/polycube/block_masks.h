// SPDX-License-Identifier: AGPL-3.0-or-later
#pragma once
#include <array>
#include <cstdint>
#include <vector>

#include "meshing/polycube/sample_raster.h"

namespace shellgrid {

// The 4×4×4 samples of a raster in one block, bit x + 4y + 16z.
struct BlockMask {
  using Bits = std::uint64_t;
  static constexpr int samples_per_block = 4;  // along each axis
  static constexpr std::array<int, 3> stride = {1, 4, 16};
  // Samples that have a neighbour towards + x, + y, + z in the same block.
  static constexpr std::array<Bits, 3> has_next = {0x7777777777777777u, 0x0fff0fff0fff0fffu, 0x0000ffffffffffffu};

  Bits inside = 0;
  std::array<Bits, 3> cut = {0, 0, 0};  // the surface passes towards + the axis

  // Samples on one side of the surface from which the next one towards + axis can be reached.
  Bits open(Bits side, int axis) const { return side & ~cut[axis]; }
  // The connected sets of samples of one side, those of most samples first.
  std::vector<Bits> pieces(Bits side) const;
  Bits largest_piece(Bits side) const;
};

// A raster's samples in groups of 2×2×2, so that the blocks that begin at any even sample are put together fast.
class BlockMasks {
 public:
  explicit BlockMasks(const SampleRaster& raster);
  // The block whose first sample is `sample`, all coordinates even.
  BlockMask at(const Vec3i& sample) const;

 private:
  struct Octet {
    std::uint8_t inside = 0;
    std::array<std::uint8_t, 3> cut = {0, 0, 0};
  };
  Vec3i size_;
  std::vector<Octet> octets_;
};

}  // namespace shellgrid
