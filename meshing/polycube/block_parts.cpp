// SPDX-License-Identifier: AGPL-3.0-or-later
#include "meshing/polycube/block_parts.h"

#include <algorithm>

#include "meshing/core/parallel.h"

namespace shellgrid {
namespace {

constexpr int edge = BlockParts::samples_per_block;

}  // namespace

BlockParts::BlockParts(const SampleRaster& raster, const BlockMasks& masks, const Vec3i& shift, const Vec3i& counts)
    : raster_(raster),
      shift_(shift),
      size_(counts),
      main_(static_cast<std::size_t>(counts.x()) * counts.y() * counts.z(), 0),
      parted_(main_.size(), 0) {
  const BlockGrid shape(counts);
  fraction_.assign(main_.size(), 0);
  parallel_for(
      main_.size(),
      [&](std::size_t b) {
        const BlockMask mask = masks.at(shift_ + edge * shape.place(b));
        if (!mask.inside) return;
        fraction_[b] = static_cast<float>(__builtin_popcountll(mask.inside)) / (edge * edge * edge);
        main_[b] = mask.largest_piece(mask.inside);
      },
      1024);
  parallel_for(
      main_.size(),
      [&](std::size_t b) {
        if (main_[b] == 0) return;
        const Vec3i block = shape.place(b);
        const BlockMask mask = masks.at(shift_ + edge * block);
        for (int axis = 0; axis < 3; ++axis) {
          const Vec3i next = block + Vec3i::Unit(axis);
          if (next[axis] >= size_[axis] || main_[index(next)] == 0) continue;
          // Through the face between them, or around.
          const int across = (edge - 1) * BlockMask::stride[axis];
          const std::uint64_t leaving = mask.open(main_[b], axis) & ~BlockMask::has_next[axis];
          if (leaving >> across & main_[index(next)]) continue;
          if (!are_connected(block, next, block - Vec3i::Ones(), next + Vec3i::Ones())) parted_[b] |= 1 << axis;
        }
      },
      1024);
}

bool BlockParts::are_connected(const Vec3i& a, const Vec3i& b, const Vec3i& low, const Vec3i& high) const {
  const Vec3i first = shift_ + edge * low;
  const Vec3i size = edge * (high - low + Vec3i::Ones());
  const auto local_index = [&](const Vec3i& s) { return (s.z() * size.y() + s.y()) * size.x() + s.x(); };
  std::vector<std::uint8_t> state(static_cast<std::size_t>(size.x()) * size.y() * size.z());  // 1: wanted, 2: seen
  std::vector<Vec3i> stack;
  const auto each_of = [&](const Vec3i& block, const auto& visit) {
    for (Mask rest = main_[index(block)]; rest; rest &= rest - 1) {
      const int bit = __builtin_ctzll(rest);
      visit(Vec3i(edge * (block - low) + Vec3i(bit & 3, bit >> 2 & 3, bit >> 4)));
    }
  };
  // Whether the samples that `from` is connected to reach `to`, or else end within the box: such an island is a bit of
  // a part thinner than the raster, no part of its own.
  const auto reaches_or_ends = [&](const Vec3i& from, const Vec3i& to) {
    std::fill(state.begin(), state.end(), 0);
    each_of(to, [&](const Vec3i& s) { state[local_index(s)] = 1; });
    each_of(from, [&](const Vec3i& s) { state[local_index(s)] = 2, stack.push_back(s); });
    bool leaves = false;
    while (!stack.empty()) {
      const Vec3i s = stack.back();
      stack.pop_back();
      for (int axis = 0; axis < 3; ++axis)
        for (int side : {-1, 1}) {
          const Vec3i next = s + side * Vec3i::Unit(axis);
          const Vec3i place = first + next;
          const std::uint8_t lower_flags = raster_.at(side > 0 ? Vec3i(first + s) : place);
          if (!raster_.inside(place) || (lower_flags >> axis & 1)) continue;
          if (next[axis] < 0 || next[axis] >= size[axis]) {
            leaves = true;
            continue;
          }
          std::uint8_t& seen = state[local_index(next)];
          if (seen == 1) {
            stack.clear();
            return true;
          }
          if (seen == 2) continue;
          seen = 2;
          stack.push_back(next);
        }
    }
    return !leaves;
  };
  return reaches_or_ends(a, b) || reaches_or_ends(b, a);
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
