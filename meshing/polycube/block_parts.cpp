// SPDX-License-Identifier: AGPL-3.0-or-later
#include "meshing/polycube/block_parts.h"

#include <algorithm>

#include "meshing/core/parallel.h"

namespace shellgrid {
namespace {

constexpr int edge = BlockParts::samples_per_block;
constexpr int stride[3] = {1, 4, 16};
// Samples that have a neighbour towards + x, + y, + z in the same block.
constexpr std::uint64_t has_next[3] = {0x7777777777777777u, 0x0fff0fff0fff0fffu, 0x0000ffffffffffffu};

struct BlockMasks {
  std::uint64_t inside = 0;
  std::uint64_t open[3] = {0, 0, 0};  // inside, and towards + the axis the surface does not pass
};

BlockMasks masks_of(const SampleRaster& raster, const Vec3i& base) {
  BlockMasks masks;
  for (int k = 0; k < edge; ++k)
    for (int j = 0; j < edge; ++j)
      for (int i = 0; i < edge; ++i) {
        const std::uint8_t flags = raster.at(base + Vec3i(i, j, k));
        const std::uint64_t bit = std::uint64_t{1} << (i + 4 * j + 16 * k);
        if (!(flags & SampleRaster::inside_bit)) continue;
        masks.inside |= bit;
        for (int axis = 0; axis < 3; ++axis)
          if (!(flags >> axis & 1)) masks.open[axis] |= bit;
      }
  return masks;
}

std::uint64_t largest_part(const BlockMasks& masks) {
  std::uint64_t largest = 0;
  for (std::uint64_t rest = masks.inside; rest;) {
    std::uint64_t part = rest & (~rest + 1);
    for (;;) {
      std::uint64_t next = part;
      for (int axis = 0; axis < 3; ++axis) {
        const std::uint64_t passable = masks.open[axis] & has_next[axis];
        next |= (part & passable) << stride[axis];
        next |= part >> stride[axis] & passable;
      }
      next &= masks.inside;
      if (next == part) break;
      part = next;
    }
    if (__builtin_popcountll(part) > __builtin_popcountll(largest)) largest = part;
    rest &= ~part;
  }
  return largest;
}

}  // namespace

BlockParts::BlockParts(const SampleRaster& raster, const Vec3i& shift, const Vec3i& counts)
    : raster_(raster),
      shift_(shift),
      size_(counts),
      main_(static_cast<std::size_t>(counts.x()) * counts.y() * counts.z(), 0),
      parted_(main_.size(), 0) {
  const BlockGrid shape(counts);
  std::vector<BlockMasks> masks(main_.size());
  parallel_for(main_.size(), [&](std::size_t b) {
    masks[b] = masks_of(raster, shift_ + edge * shape.place(b));
    main_[b] = largest_part(masks[b]);
  });
  parallel_for(main_.size(), [&](std::size_t b) {
    const Vec3i block = shape.place(b);
    for (int axis = 0; axis < 3; ++axis) {
      const Vec3i next = block + Vec3i::Unit(axis);
      if (next[axis] >= size_[axis] || main_[b] == 0 || main_[index(next)] == 0) continue;
      // Through the face between them, or around.
      const int across = (edge - 1) * stride[axis];
      const std::uint64_t leaving = main_[b] & masks[b].open[axis] & ~has_next[axis];
      if (leaving >> across & main_[index(next)]) continue;
      Vec3i low = block - Vec3i::Ones(), high = next + Vec3i::Ones();
      low[axis] = block[axis], high[axis] = next[axis];
      if (!are_connected(block, next, low, high)) parted_[b] |= 1 << axis;
    }
  });
}

bool BlockParts::are_connected(const Vec3i& a, const Vec3i& b, const Vec3i& low, const Vec3i& high) const {
  const Vec3i first = shift_ + edge * low;
  const Vec3i size = edge * (high - low + Vec3i::Ones());
  const auto local_index = [&](const Vec3i& s) { return (s.z() * size.y() + s.y()) * size.x() + s.x(); };
  std::vector<std::uint8_t> state(static_cast<std::size_t>(size.x()) * size.y() * size.z(), 0);  // 1: wanted, 2: seen
  std::vector<Vec3i> stack;
  const auto each_of = [&](const Vec3i& block, const auto& visit) {
    for (Mask rest = main_[index(block)]; rest; rest &= rest - 1) {
      const int bit = __builtin_ctzll(rest);
      visit(Vec3i(edge * (block - low) + Vec3i(bit & 3, bit >> 2 & 3, bit >> 4)));
    }
  };
  each_of(b, [&](const Vec3i& s) { state[local_index(s)] = 1; });
  each_of(a, [&](const Vec3i& s) { state[local_index(s)] = 2, stack.push_back(s); });
  while (!stack.empty()) {
    const Vec3i s = stack.back();
    stack.pop_back();
    for (int axis = 0; axis < 3; ++axis)
      for (int side : {-1, 1}) {
        const Vec3i next = s + side * Vec3i::Unit(axis);
        if (next[axis] < 0 || next[axis] >= size[axis]) continue;
        const Vec3i place = first + next;
        const std::uint8_t lower_flags = raster_.at(side > 0 ? Vec3i(first + s) : place);
        if (!raster_.inside(place) || (lower_flags >> axis & 1)) continue;
        std::uint8_t& seen = state[local_index(next)];
        if (seen == 1) return true;
        if (seen == 2) continue;
        seen = 2;
        stack.push_back(next);
      }
  }
  return false;
}

bool BlockParts::joins_parts(const BlockGrid& grid, const Vec3i& block) const {
  if (main_[index(block)] != 0) {
    for (int axis = 0; axis < 3; ++axis) {
      const Vec3i step = Vec3i::Unit(axis);
      if (grid.at(block + step) && are_parted(block, axis)) return true;
      if (grid.at(block - step) && are_parted(block - step, axis)) return true;
    }
    return false;
  }
  std::vector<Vec3i> around;
  for (int axis = 0; axis < 3; ++axis)
    for (int side : {-1, 1}) {
      const Vec3i next = block + side * Vec3i::Unit(axis);
      if (grid.at(next) && main_[index(next)] != 0) around.push_back(next);
    }
  for (std::size_t n = 1; n < around.size(); ++n)
    if (!are_connected(around[0], around[n], block - Vec3i::Ones(), block + Vec3i::Ones())) return true;
  return false;
}

}  // namespace shellgrid
