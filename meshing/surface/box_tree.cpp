// SPDX-License-Identifier: AGPL-3.0-or-later
#include "meshing/surface/box_tree.h"

#include <oneapi/tbb/parallel_invoke.h>

#include <algorithm>

namespace shellgrid {
namespace {

// How a range of leaves is halved, here and when nodes are gathered.
int left_leaves(int leaves) { return (leaves + 1) / 2; }

struct Item {
  Vec3 centre;
  std::int32_t index;
};

// Sorts the items of [first, first + count) into leaves of eight by halving at medians.
void partition(Item* first, std::size_t count) {
  const int leaves = static_cast<int>((count + BoxTree::width - 1) / BoxTree::width);
  if (leaves <= 1) return;
  Box bounds;
  for (std::size_t i = 0; i < count; ++i) bounds.add(first[i].centre);
  int axis = 0;
  (bounds.upper - bounds.lower).maxCoeff(&axis);
  const std::size_t middle = static_cast<std::size_t>(left_leaves(leaves)) * BoxTree::width;
  // Ties go by index, so that the halves do not depend on the order of arrival.
  std::nth_element(first, first + middle, first + count, [&](const Item& a, const Item& b) {
    const double u = a.centre[axis], v = b.centre[axis];
    return u < v || (u == v && a.index < b.index);
  });
  const auto left = [&] { partition(first, middle); };
  const auto right = [&] { partition(first + middle, count - middle); };
  if (count > 4096)
    oneapi::tbb::parallel_invoke(left, right);
  else
    left(), right();
}

}  // namespace

BoxTree::BoxTree(const std::vector<Box>& items) {
  if (items.empty()) return;
  const std::size_t leaves = (items.size() + width - 1) / width;
  std::vector<Item> centres(items.size());
  for (std::size_t i = 0; i < items.size(); ++i)
    centres[i] = {0.5 * (items[i].lower + items[i].upper), static_cast<std::int32_t>(i)};
  partition(centres.data(), centres.size());
  order_.resize(items.size());
  for (std::size_t i = 0; i < items.size(); ++i) order_[i] = centres[i].index;
  order_.resize(leaves * width, -1);
  for (std::size_t leaf = 0; leaf < leaves; ++leaf) {
    // Within a leaf by index: ties are then found lowest first.
    auto begin = order_.begin() + static_cast<std::ptrdiff_t>(leaf * width);
    std::sort(begin, std::find(begin, begin + width, -1));
  }
  std::int32_t root = 0;
  nodes_.reserve(leaves / 4 + 16);
  build_node(items, 0, static_cast<int>(leaves), root);
}

Box BoxTree::build_node(const std::vector<Box>& items, int first_leaf, int leaves, std::int32_t& child) {
  Box total;
  if (leaves == 1 && !nodes_.empty()) {
    for (int slot = 0; slot < width; ++slot)
      if (const int i = item(first_leaf, slot); i >= 0) total.add(items[i]);
    child = ~first_leaf;
    return total;
  }
  struct Range {
    int first, leaves;
  };
  // Undo halvings of the largest range until there are eight.
  std::vector<Range> ranges = {{first_leaf, leaves}};
  ranges.reserve(width);
  while (static_cast<int>(ranges.size()) < width) {
    auto largest = std::max_element(ranges.begin(), ranges.end(),
                                    [](const Range& a, const Range& b) { return a.leaves < b.leaves; });
    if (largest->leaves == 1) break;
    const int left = left_leaves(largest->leaves);
    const Range right = {largest->first + left, largest->leaves - left};
    largest->leaves = left;
    ranges.insert(largest + 1, right);
  }
  const std::size_t index = nodes_.size();
  child = static_cast<std::int32_t>(index);
  nodes_.emplace_back();
  nodes_[index].child_count = static_cast<std::int32_t>(ranges.size());
  for (int lane = 0; lane < width; ++lane) {
    Box box;
    std::int32_t lane_child = 0;
    if (lane < static_cast<int>(ranges.size())) {
      box = build_node(items, ranges[lane].first, ranges[lane].leaves, lane_child);
      total.add(box);
    }
    for (int axis = 0; axis < 3; ++axis) {
      nodes_[index].lower[axis][lane] = box.lower[axis];
      nodes_[index].upper[axis][lane] = box.upper[axis];
    }
    nodes_[index].child[lane] = lane_child;
  }
  return total;
}

}  // namespace shellgrid
