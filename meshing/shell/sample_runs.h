// SPDX-License-Identifier: AGPL-3.0-or-later
#pragma once
#include <algorithm>
#include <cmath>
#include <cstddef>
#include <cstdint>

#include "meshing/shell/two_level_grid.h"

namespace shellgrid {

// Look-ups by the run: the places of a whole run are worked out first, without branches and in vectors, then read, so
// that many reads are under way at once. What comes out is what TwoLevelGrid::value gives for each place.
namespace sample_runs {

constexpr int length = 32;

// Of one run: top cell, all bits set where the place is out of the grid's bounds, and place in the leaf.
struct Places {
  std::int32_t cell[length], outside[length], offset[length];
};

// at: sample indices, from the grid's first sample on.
inline void locate(const int (&at)[3][length], const Vec3i& counts, Places& places) {
  const std::uint32_t in_x = static_cast<std::uint32_t>(counts.x()), in_y = static_cast<std::uint32_t>(counts.y()),
                      in_z = static_cast<std::uint32_t>(counts.z());
  for (int n = 0; n < length; ++n) {
    const int i = at[0][n], j = at[1][n], k = at[2][n];
    const std::uint32_t x = static_cast<std::uint32_t>(i >> 3), y = static_cast<std::uint32_t>(j >> 3),
                        z = static_cast<std::uint32_t>(k >> 3);
    const std::int32_t outside = -static_cast<std::int32_t>((x >= in_x) | (y >= in_y) | (z >= in_z));
    places.cell[n] = static_cast<std::int32_t>((x * in_y + y) * in_z + z) & ~outside;
    places.outside[n] = outside;
    places.offset[n] = ((i & 7) << 6) | ((j & 7) << 3) | (k & 7);
  }
}

// Leaf −1 is the leaf of background.
template <class T>
void read(const TwoLevelGrid<T>& grid, const Places& places, int count, T* values) {
  const std::int32_t* const top = grid.top_cells();
  const T* const leaves = grid.leaf_values(0);
  for (int n = 0; n < count; ++n)
    values[n] =
        leaves[std::ptrdiff_t{top[places.cell[n]] | places.outside[n]} * TwoLevelGrid<T>::leaf_size + places.offset[n]];
}

}  // namespace sample_runs

// Reads the samples (i, j, k) of `places`, or the background. values: room for `count`.
template <class T>
void read_samples(const TwoLevelGrid<T>& grid, const Vec3i* places, std::size_t count, T* values) {
  using namespace sample_runs;
  if (grid.leaf_count() == 0) {
    std::fill_n(values, count, grid.background());
    return;
  }
  const Vec3i first = grid.lower_leaf() * TwoLevelGrid<T>::leaf_edge;
  for (std::size_t done = 0; done < count; done += length) {
    const int now = static_cast<int>(std::min<std::size_t>(length, count - done));
    int at[3][length] = {};
    for (int n = 0; n < now; ++n)
      for (int axis = 0; axis < 3; ++axis)
        at[axis][n] = static_cast<int>(static_cast<unsigned>(places[done + static_cast<std::size_t>(n)][axis]) -
                                       static_cast<unsigned>(first[axis]));
    Places run;
    locate(at, grid.leaf_counts(), run);
    read(grid, run, now, values + done);
  }
}

// Reads the samples nearest to the points origin + n·step, 0 ≤ n < count, or the background. Points in index space,
// rounded by less than 1e-8 of an index. values: room for `count`.
template <class T>
void read_samples_along(const TwoLevelGrid<T>& grid, const Vec3& origin, const Vec3& step, int count, T* values) {
  using namespace sample_runs;
  constexpr double edge = TwoLevelGrid<T>::leaf_edge;
  // Which of the points may lie in the grid's bounds: the others are background.
  double from = 0, to = grid.leaf_count() == 0 ? -1 : count - 1;
  Vec3 place, extent;
  bool small = true;
  for (int axis = 0; axis < 3; ++axis) {
    place[axis] = origin[axis] + 0.5 - edge * grid.lower_leaf()[axis];
    extent[axis] = edge * grid.leaf_counts()[axis];
    small = small && extent[axis] < 0x1p28 && std::abs(step[axis]) < 0x1p20;
    if (step[axis] == 0) {
      if (!(place[axis] >= 0 && place[axis] < extent[axis])) to = -1;
      continue;
    }
    const double a = -place[axis] / step[axis], b = (extent[axis] - place[axis]) / step[axis];
    from = std::max(from, std::min(a, b));
    to = std::min(to, std::max(a, b));
  }
  const int begin = from <= to ? std::max(0, static_cast<int>(std::floor(from)) - 1) : count;
  const int end = from <= to ? std::min(count, static_cast<int>(std::ceil(to)) + 2) : count;
  std::fill(values, values + begin, grid.background());
  if (end < count) std::fill(values + end, values + count, grid.background());
  if (!small) {
    for (int n = begin; n < end; ++n) {
      const Vec3 p = (place + n * step).array().floor();
      const bool inside = (p.array() >= 0).all() && (p.array() < extent.array()).all();
      const Vec3i s = inside ? Vec3i(p.cast<int>() + 8 * grid.lower_leaf()) : Vec3i::Zero();
      values[n] = inside ? grid.value(s.x(), s.y(), s.z()) : grid.background();
    }
    return;
  }
  // In units of 2⁻³² of an index, from the run's first point on; wraps only beyond the bounds.
  constexpr double unit = 0x1p32;
  for (int done = begin; done < end; done += length) {
    int at[3][length];
    for (int axis = 0; axis < 3; ++axis) {
      const auto start = static_cast<std::uint64_t>(std::llrint((place[axis] + done * step[axis]) * unit));
      const auto advance = static_cast<std::uint64_t>(std::llrint(step[axis] * unit));
      for (int n = 0; n < length; ++n)
        at[axis][n] =
            static_cast<int>(static_cast<std::int64_t>(start + static_cast<std::uint64_t>(n) * advance) >> 32);
    }
    Places run;
    locate(at, grid.leaf_counts(), run);
    read(grid, run, std::min(length, end - done), values + done);
  }
}

}  // namespace shellgrid
