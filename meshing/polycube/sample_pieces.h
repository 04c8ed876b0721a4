// SPDX-License-Identifier: AGPL-3.0-or-later
#pragma once
#include <cstdint>
#include <vector>

#include "meshing/polycube/block_masks.h"

namespace shellgrid {

// The connected sets of a raster's samples inside each block, of the object or of what is around it, and which of them
// go on in the next blocks. The surface parts samples even where both are inside.
class SamplePieces {
 public:
  static constexpr int samples_per_block = BlockMask::samples_per_block;

  // Blocks of 4×4×4 samples, block (0, 0, 0) beginning at sample `shift`; blocks are numbered as in BlockGrid.
  SamplePieces(const BlockMasks& masks, const Vec3i& shift, const Vec3i& counts, bool inside);

  std::size_t block_of(int piece) const { return block_of_[piece]; }
  int samples_of(int piece) const { return __builtin_popcountll(masks_[piece]); }
  // The block's piece of most samples, −1 where it has none.
  int main_piece(std::size_t block) const { return first_[block] < first_[block + 1] ? first_[block] : -1; }
  // The piece that a sample belongs to, −1 where it is on the other side of the surface or in no block.
  int piece_of(const Vec3i& sample) const;
  // Pieces of the blocks around that are connected to this one through a face.
  const std::vector<int>& neighbours(int piece) const { return neighbours_[piece]; }

 private:
  Vec3i shift_, counts_;
  std::vector<int> first_;            // per block: its pieces, largest first
  std::vector<std::uint64_t> masks_;  // per piece: bit x + 4y + 16z
  std::vector<std::size_t> block_of_;
  std::vector<std::vector<int>> neighbours_;
};

}  // namespace shellgrid
