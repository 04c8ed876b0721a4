// SPDX-License-Identifier: AGPL-3.0-or-later
#pragma once
#include <algorithm>
#include <array>
#include <cmath>
#include <cstddef>
#include <cstdint>
#include <limits>
#include <utility>
#include <vector>

#include "meshing/core/vec.h"

namespace shellgrid {

// Two-level sparse grid: a dense top array whose cells are null or hold a leaf of 8×8×8 samples.
// Source: [STF §6, fig. 5b].
//
// A sample is active or holds the background. Within a leaf the sample (x, y, z) stands at
// (x·8 + y)·8 + z, which is OpenVDB's order. Allocation is not thread-safe; writing to distinct
// leaves is.
template <class T>
class TwoLevelGrid {
 public:
  static constexpr int leaf_edge = 8;
  static constexpr int leaf_size = 512;
  using Mask = std::array<std::uint64_t, 8>;  // bit n of the leaf's sample n

  TwoLevelGrid() = default;

  // An empty grid that may hold samples with leaf coordinates in [lower_leaf, lower_leaf + leaf_counts).
  TwoLevelGrid(const Vec3i& lower_leaf, const Vec3i& leaf_counts, const T& background)
      : lower_leaf_(lower_leaf),
        leaf_counts_(leaf_counts),
        background_(background),
        top_(static_cast<std::size_t>(leaf_counts.x()) * leaf_counts.y() * leaf_counts.z(), null_leaf) {}

  // Leaf coordinates of the leaf that holds a sample: floor(index / 8).
  static Vec3i leaf_of(int i, int j, int k) { return {i >> 3, j >> 3, k >> 3}; }
  static int offset_of(int i, int j, int k) { return ((i & 7) << 6) | ((j & 7) << 3) | (k & 7); }

  const Vec3i& lower_leaf() const { return lower_leaf_; }
  const Vec3i& leaf_counts() const { return leaf_counts_; }
  const T& background() const { return background_; }
  // The dense top array: leaf indices, −1 where there is no leaf, z fastest.
  const std::int32_t* top_cells() const { return top_.data(); }
  int leaf_count() const { return static_cast<int>(leaf_coordinates_.size()); }

  // Index of the leaf with these leaf coordinates, or -1 where none is allocated.
  int find_leaf(const Vec3i& leaf) const {
    const Vec3i local = leaf - lower_leaf_;
    return within(local.x(), local.y(), local.z()) ? top_[top_index(local)] : null_leaf;
  }

  // The leaf's index; allocates it, filled with inactive background, where it is missing. The leaf
  // must lie in the grid's bounds.
  int allocate_leaf(const Vec3i& leaf) {
    std::int32_t& entry = top_[top_index(leaf - lower_leaf_)];
    if (entry == null_leaf) {
      entry = static_cast<std::int32_t>(leaf_coordinates_.size());
      leaf_coordinates_.push_back(leaf);
      masks_.push_back(Mask{});
      values_.resize(values_.size() + leaf_size, background_);
    }
    return entry;
  }

  // Allocates leaves, none of which may be there yet, in their order.
  void allocate_leaves(const std::vector<Vec3i>& leaves) {
    values_.reserve(values_.size() + leaves.size() * leaf_size);
    masks_.reserve(masks_.size() + leaves.size());
    leaf_coordinates_.reserve(leaf_coordinates_.size() + leaves.size());
    for (const Vec3i& leaf : leaves) allocate_leaf(leaf);
  }

  Vec3i leaf_coordinate(int leaf_index) const { return leaf_coordinates_[leaf_index]; }
  T* leaf_values(int leaf_index) { return values_.data() + (std::ptrdiff_t{leaf_index} + 1) * leaf_size; }
  const T* leaf_values(int leaf_index) const { return values_.data() + (std::ptrdiff_t{leaf_index} + 1) * leaf_size; }
  Mask& leaf_mask(int leaf_index) { return masks_[leaf_index]; }
  const Mask& leaf_mask(int leaf_index) const { return masks_[leaf_index]; }
  static bool mask_test(const Mask& mask, int offset) { return (mask[offset >> 6] >> (offset & 63)) & 1u; }
  static void mask_set(Mask& mask, int offset) { mask[offset >> 6] |= std::uint64_t{1} << (offset & 63); }

  bool contains_leaf(const Vec3i& leaf) const {
    return ((leaf - lower_leaf_).array() >= 0).all() && ((leaf - lower_leaf_).array() < leaf_counts_.array()).all();
  }

  // Sets one sample and makes it active.
  void set(int i, int j, int k, const T& value) {
    const int leaf_index = allocate_leaf(leaf_of(i, j, k));
    const int offset = offset_of(i, j, k);
    leaf_values(leaf_index)[offset] = value;
    mask_set(masks_[leaf_index], offset);
  }

  // The sample, or the background.
  const T& value(int i, int j, int k) const {
    const int x = (i >> 3) - lower_leaf_.x(), y = (j >> 3) - lower_leaf_.y(), z = (k >> 3) - lower_leaf_.z();
    if (!within(x, y, z)) return background_;
    return leaf_values(top_[top_index({x, y, z})])[offset_of(i, j, k)];
  }

  // The eight samples around a point, given by its continuous index, weighted trilinearly.
  T interpolate(const Vec3f& index) const {
    const CellAround cell(index);
    if (!cell.in_one_leaf) return interpolate_across_leaves(cell);
    return interpolate_in_leaf(leaf_values(find_leaf(leaf_of(cell.at.x(), cell.at.y(), cell.at.z()))), cell);
  }

  // Reads with a memory of the leaf read last: quicker where look-ups follow one another in space. Must not outlive
  // the grid or see it change; each thread needs one of its own.
  class Accessor {
   public:
    explicit Accessor(const TwoLevelGrid& grid) : grid_(grid) { move_to(0, 0, 0); }

    const T& value(int i, int j, int k) {
      if (!is_here(i, j, k)) move_to(i, j, k);
      return samples_[offset_of(i, j, k)];
    }

    T interpolate(const Vec3f& index) {
      const CellAround cell(index);
      if (!cell.in_one_leaf) return grid_.interpolate_across_leaves(cell);
      if (!is_here(cell.at.x(), cell.at.y(), cell.at.z())) move_to(cell.at.x(), cell.at.y(), cell.at.z());
      return interpolate_in_leaf(samples_, cell);
    }

   private:
    bool is_here(int i, int j, int k) const {
      return static_cast<unsigned>((i ^ i_) | (j ^ j_) | (k ^ k_)) < leaf_edge;
    }
    void move_to(int i, int j, int k) {
      i_ = i & -leaf_edge, j_ = j & -leaf_edge, k_ = k & -leaf_edge;
      samples_ = grid_.leaf_values(grid_.find_leaf(leaf_of(i, j, k)));
    }

    const TwoLevelGrid& grid_;
    int i_ = 0, j_ = 0, k_ = 0;  // the leaf's first sample
    const T* samples_ = nullptr;
  };

  bool is_active(int i, int j, int k) const {
    const int leaf_index = find_leaf(leaf_of(i, j, k));
    return leaf_index >= 0 && mask_test(masks_[leaf_index], offset_of(i, j, k));
  }

  std::size_t active_count() const {
    std::size_t count = 0;
    for (const Mask& mask : masks_)
      for (std::uint64_t word : mask) count += static_cast<std::size_t>(__builtin_popcountll(word));
    return count;
  }

  // Calls visit(i, j, k, value) for each active sample, leaf by leaf.
  template <class Visit>
  void for_each_active(const Visit& visit) const {
    for (int leaf_index = 0; leaf_index < leaf_count(); ++leaf_index) {
      const Vec3i base = leaf_coordinates_[leaf_index] * leaf_edge;
      for (int offset = 0; offset < leaf_size; ++offset)
        if (mask_test(masks_[leaf_index], offset))
          visit(base.x() + (offset >> 6), base.y() + ((offset >> 3) & 7), base.z() + (offset & 7),
                leaf_values(leaf_index)[offset]);
    }
  }

  std::size_t bytes() const {
    return top_.size() * sizeof(std::int32_t) + values_.size() * sizeof(T) + masks_.size() * sizeof(Mask) +
           leaf_coordinates_.size() * sizeof(Vec3i);
  }

 private:
  static constexpr std::int32_t null_leaf = -1;

  // The cell of eight samples around a point and the point's place in it.
  struct CellAround {
    Vec3i at;
    Vec3f t;
    bool in_one_leaf;
    explicit CellAround(const Vec3f& index) {
      const float x = std::floor(index.x()), y = std::floor(index.y()), z = std::floor(index.z());
      at = Vec3i(static_cast<int>(x), static_cast<int>(y), static_cast<int>(z));
      t = Vec3f(index.x() - x, index.y() - y, index.z() - z);
      const Vec3i next = at + Vec3i::Ones();
      in_one_leaf = ((next.x() & 7) != 0) & ((next.y() & 7) != 0) & ((next.z() & 7) != 0);
    }
  };

  // Samples in the order of offsets: z fastest.
  static T weigh(const Vec3f& t, const T& v0, const T& v1, const T& v2, const T& v3, const T& v4, const T& v5,
                 const T& v6, const T& v7) {
    const auto between = [](float s, const T& a, const T& b) -> T { return a + s * (b - a); };
    return between(t.x(), between(t.y(), between(t.z(), v0, v1), between(t.z(), v2, v3)),
                   between(t.y(), between(t.z(), v4, v5), between(t.z(), v6, v7)));
  }

  static T interpolate_in_leaf(const T* samples, const CellAround& cell) {
    const T* const v = samples + offset_of(cell.at.x(), cell.at.y(), cell.at.z());
    return weigh(cell.t, v[0], v[1], v[8], v[9], v[64], v[65], v[72], v[73]);
  }

  T interpolate_across_leaves(const CellAround& cell) const {
    const int i = cell.at.x(), j = cell.at.y(), k = cell.at.z();
    const int x0 = (i >> 3) - lower_leaf_.x(), x1 = ((i + 1) >> 3) - lower_leaf_.x();
    const int y0 = (j >> 3) - lower_leaf_.y(), y1 = ((j + 1) >> 3) - lower_leaf_.y();
    const int z0 = (k >> 3) - lower_leaf_.z(), z1 = ((k + 1) >> 3) - lower_leaf_.z();
    if (!(within(x0, y0, z0) & within(x1, y1, z1)))
      return weigh(cell.t, value(i, j, k), value(i, j, k + 1), value(i, j + 1, k), value(i, j + 1, k + 1),
                   value(i + 1, j, k), value(i + 1, j, k + 1), value(i + 1, j + 1, k), value(i + 1, j + 1, k + 1));
    const std::int32_t* const top = top_.data();
    const T* const values = values_.data() + leaf_size;
    const std::int32_t* const column[2][2] = {{top + top_index({x0, y0, 0}), top + top_index({x0, y1, 0})},
                                              {top + top_index({x1, y0, 0}), top + top_index({x1, y1, 0})}};
    const int in_x[2] = {(i & 7) << 6, ((i + 1) & 7) << 6}, in_y[2] = {(j & 7) << 3, ((j + 1) & 7) << 3};
    const int in_z[2] = {k & 7, (k + 1) & 7}, z[2] = {z0, z1};
    const auto sample = [&](int a, int b, int c) -> const T& {
      return values[std::ptrdiff_t{column[a][b][z[c]]} * leaf_size + (in_x[a] + in_y[b] + in_z[c])];
    };
    return weigh(cell.t, sample(0, 0, 0), sample(0, 0, 1), sample(0, 1, 0), sample(0, 1, 1), sample(1, 0, 0),
                 sample(1, 0, 1), sample(1, 1, 0), sample(1, 1, 1));
  }

  // Counts leaves from lower_leaf_ on. One branch for all three axes.
  bool within(int x, int y, int z) const {
    return (static_cast<unsigned>(x) < static_cast<unsigned>(leaf_counts_.x())) &
           (static_cast<unsigned>(y) < static_cast<unsigned>(leaf_counts_.y())) &
           (static_cast<unsigned>(z) < static_cast<unsigned>(leaf_counts_.z()));
  }

  std::size_t top_index(const Vec3i& local) const {
    return (static_cast<std::size_t>(local.x()) * leaf_counts_.y() + local.y()) * leaf_counts_.z() + local.z();
  }

  Vec3i lower_leaf_ = Vec3i::Zero();
  Vec3i leaf_counts_ = Vec3i::Zero();
  T background_{};
  std::vector<std::int32_t> top_;
  std::vector<Vec3i> leaf_coordinates_;
  std::vector<Mask> masks_;
  // A leaf of background comes first: what a cell without a leaf means.
  std::vector<T> values_ = std::vector<T>(leaf_size, background_);
};

}  // namespace shellgrid
