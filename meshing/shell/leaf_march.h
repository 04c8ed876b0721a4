// SPDX-License-Identifier: AGPL-3.0-or-later
#pragma once
#include <algorithm>
#include <cmath>
#include <limits>

#include "meshing/shell/two_level_grid.h"

namespace shellgrid {

// Steps through the top cells of a grid that a straight line passes, and stops at those with a leaf.
// Source: [AmanatidesWoo1987].
class LeafMarch {
 public:
  // The line origin + t·direction for t in [from, to], in the grid's index space, where a leaf takes the indices that
  // round to its samples: [8m − ½, 8m + 7½) on each axis.
  template <class T>
  LeafMarch(const TwoLevelGrid<T>& grid, const Vec3& origin, const Vec3& direction, double from, double to)
      : top_(grid.top_cells()), t_(from), end_(to) {
    constexpr double edge = TwoLevelGrid<T>::leaf_edge;
    const Vec3i counts = grid.leaf_counts();
    Vec3 o;
    for (int axis = 0; axis < 3; ++axis) {
      o[axis] = (origin[axis] + 0.5) / edge - grid.lower_leaf()[axis];
      inverse_[axis] = edge / direction[axis];
      if (direction[axis] == 0) {
        if (!(o[axis] >= 0 && o[axis] < counts[axis])) end_ = -std::numeric_limits<double>::infinity();
        continue;
      }
      const double a = -o[axis] * inverse_[axis], b = (counts[axis] - o[axis]) * inverse_[axis];
      t_ = std::max(t_, std::min(a, b));
      end_ = std::min(end_, std::max(a, b));
    }
    if (!(t_ < end_)) {
      end_ = t_ - 1;
      return;
    }
    const std::ptrdiff_t strides[3] = {std::ptrdiff_t{counts.y()} * counts.z(), counts.z(), 1};
    at_ = 0;
    for (int axis = 0; axis < 3; ++axis) {
      const double p = o[axis] + t_ * direction[axis] / edge;
      const int cell = std::clamp(static_cast<int>(std::floor(p)), 0, counts[axis] - 1);
      at_ += cell * strides[axis];
      if (direction[axis] == 0) {
        next_[axis] = inverse_[axis] = std::numeric_limits<double>::infinity();
        continue;
      }
      const bool up = direction[axis] > 0;
      next_[axis] = (cell + (up ? 1 : 0) - o[axis]) * inverse_[axis];
      stride_[axis] = up ? strides[axis] : -strides[axis];
      left_[axis] = up ? counts[axis] - 1 - cell : cell;
      inverse_[axis] = std::abs(inverse_[axis]);
    }
  }

  // Goes on to the next leaf. False at the line's end; else leaf(), and the interval [begin(), end()] of t in it.
  bool next() {
    while (t_ <= end_) {
      const std::int32_t leaf = top_[at_];
      begin_ = t_;
      const int axis = next_[0] < next_[1] ? (next_[0] < next_[2] ? 0 : 2) : (next_[1] < next_[2] ? 1 : 2);
      until_ = std::min(next_[axis], end_);
      if (next_[axis] >= end_ || left_[axis]-- == 0) {
        t_ = std::numeric_limits<double>::infinity();
      } else {
        t_ = next_[axis];
        next_[axis] += inverse_[axis];
        at_ += stride_[axis];
      }
      if (leaf >= 0) {
        leaf_ = leaf;
        return true;
      }
    }
    return false;
  }

  int leaf() const { return leaf_; }
  double begin() const { return begin_; }
  double end() const { return until_; }

 private:
  const std::int32_t* top_;
  double t_, end_;
  double next_[3] = {}, inverse_[3] = {};  // where the line leaves the cell, and from cell to cell
  std::ptrdiff_t at_ = 0, stride_[3] = {};
  int left_[3] = {};  // cells to the rim
  int leaf_ = -1;
  double begin_ = 0, until_ = 0;
};

// Calls visit(n, value) for the samples nearest to the points origin + n·step, 0 ≤ n < count, that lie in leaves, in
// their order. Where there is no leaf nothing is looked at. Points in index space; the step not 0.
template <class T, class Visit>
void for_each_sample_along(const TwoLevelGrid<T>& grid, const Vec3& origin, const Vec3& step, int count,
                           const Visit& visit) {
  constexpr int edge = TwoLevelGrid<T>::leaf_edge;
  // Rounding may put a point on the other side of a leaf's face: a point too many at either end, and each looked at
  // by the leaf that holds it alone.
  constexpr double margin = 1e-6;
  LeafMarch march(grid, origin, step, -margin, count - 1 + margin);
  while (march.next()) {
    const Vec3i leaf = grid.leaf_coordinate(march.leaf()) * edge;
    const T* const values = grid.leaf_values(march.leaf());
    const int first = std::max(0, static_cast<int>(std::ceil(march.begin() - margin)));
    const int last = std::min(count - 1, static_cast<int>(std::floor(march.end() + margin)));
    for (int n = first; n <= last; ++n) {
      const int i = static_cast<int>(std::floor(origin.x() + n * step.x() + 0.5)) - leaf.x();
      const int j = static_cast<int>(std::floor(origin.y() + n * step.y() + 0.5)) - leaf.y();
      const int k = static_cast<int>(std::floor(origin.z() + n * step.z() + 0.5)) - leaf.z();
      if (static_cast<unsigned>(i | j | k) < static_cast<unsigned>(edge)) visit(n, values[(i << 6) | (j << 3) | k]);
    }
  }
}

}  // namespace shellgrid
