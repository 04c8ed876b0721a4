// SPDX-License-Identifier: AGPL-3.0-or-later
#include "meshing/polycube/block_masks.h"

#include <algorithm>

#include "meshing/core/parallel.h"

namespace shellgrid {
namespace {

// Where the eight samples of an octet (bit x + 2y + 4z) stand in a block that begins with it.
std::array<std::uint64_t, 256> spread_table() {
  std::array<std::uint64_t, 256> table{};
  for (unsigned octet = 0; octet < 256; ++octet)
    for (int bit = 0; bit < 8; ++bit)
      if (octet >> bit & 1) table[octet] |= std::uint64_t{1} << ((bit & 1) + 4 * (bit >> 1 & 1) + 16 * (bit >> 2));
  return table;
}

// The connected set of samples that holds `seed`.
BlockMask::Bits spread_out(BlockMask::Bits seed, BlockMask::Bits side, const std::array<BlockMask::Bits, 3>& passable) {
  for (;;) {
    BlockMask::Bits next = seed;
    for (int axis = 0; axis < 3; ++axis)
      next |= (next & passable[axis]) << BlockMask::stride[axis] | (next >> BlockMask::stride[axis] & passable[axis]);
    next &= side;
    if (next == seed) return seed;
    seed = next;
  }
}

template <typename Visit>
void each_piece(const BlockMask& mask, BlockMask::Bits side, const Visit& visit) {
  std::array<BlockMask::Bits, 3> passable;
  for (int axis = 0; axis < 3; ++axis) passable[axis] = mask.open(side, axis) & BlockMask::has_next[axis];
  for (BlockMask::Bits rest = side; rest;) {
    const BlockMask::Bits piece = spread_out(rest & (~rest + 1), side, passable);
    visit(piece);
    rest &= ~piece;
  }
}

}  // namespace

std::vector<BlockMask::Bits> BlockMask::pieces(Bits side) const {
  std::vector<Bits> found;
  each_piece(*this, side, [&](Bits piece) { found.push_back(piece); });
  std::stable_sort(found.begin(), found.end(),
                   [](Bits a, Bits b) { return __builtin_popcountll(a) > __builtin_popcountll(b); });
  return found;
}

BlockMask::Bits BlockMask::largest_piece(Bits side) const {
  Bits largest = 0;
  each_piece(*this, side, [&](Bits piece) {
    if (__builtin_popcountll(piece) > __builtin_popcountll(largest)) largest = piece;
  });
  return largest;
}

BlockMasks::BlockMasks(const SampleRaster& raster)
    : size_(raster.size / 2), octets_(static_cast<std::size_t>(size_.x()) * size_.y() * size_.z()) {
  // In the raster's order: z fastest.
  parallel_for(
      static_cast<std::size_t>(size_.x()) * size_.y(),
      [&](std::size_t column) {
        const int i = static_cast<int>(column / size_.y()), j = static_cast<int>(column % size_.y());
        for (int bit = 0; bit < 4; ++bit) {
          const std::uint8_t* flags = &raster.flags[raster.index({2 * i + (bit & 1), 2 * j + (bit >> 1), 0})];
          for (int k = 0; k < 2 * size_.z(); ++k) {
            if (flags[k] == 0) continue;
            Octet& octet = octets_[column * size_.z() + k / 2];
            const int to = bit + 4 * (k & 1);
            octet.inside |= static_cast<std::uint8_t>((flags[k] & SampleRaster::inside_bit ? 1 : 0) << to);
            for (int axis = 0; axis < 3; ++axis)
              octet.cut[axis] |= static_cast<std::uint8_t>((flags[k] >> axis & 1) << to);
          }
        }
      },
      16);
}

BlockMask BlockMasks::at(const Vec3i& sample) const {
  static const std::array<std::uint64_t, 256> spread = spread_table();
  BlockMask mask;
  const Vec3i base = sample / 2;
  for (int bit = 0; bit < 8; ++bit) {
    const Vec3i place = base + Vec3i(bit & 1, bit >> 1 & 1, bit >> 2);
    if ((place.array() < 0).any() || (place.array() >= size_.array()).any()) continue;
    const Octet& octet = octets_[(static_cast<std::size_t>(place.x()) * size_.y() + place.y()) * size_.z() + place.z()];
    const int shift = 2 * (bit & 1) + 8 * (bit >> 1 & 1) + 32 * (bit >> 2);
    mask.inside |= spread[octet.inside] << shift;
    for (int axis = 0; axis < 3; ++axis) mask.cut[axis] |= spread[octet.cut[axis]] << shift;
  }
  return mask;
}

}  // namespace shellgrid
