// SPDX-License-Identifier: AGPL-3.0-or-later
#pragma once
#include <algorithm>
#include <array>
#include <cstdint>
#include <limits>
#include <utility>
#include <vector>

#include "synthesis/principal_components.h"

namespace shellgrid {

// A k-d tree over points of eight components; eight boxes, or sixteen points, are looked at at once.
class AppearanceTree {
 public:
  static constexpr int dimension = 8;
  using Point = Eigen::Array<float, dimension, 1>;

  // Of the rows named in `members`.
  AppearanceTree(const RowMatrixf& points, std::vector<std::int32_t> members)
      : points_(points), order_(std::move(members)) {
    root_ = build({0, static_cast<int>(order_.size())});
  }

  // Lowers (distance, index) to that of the nearest point that `allowed` lets pass, lowest index first where equal.
  template <class Allowed>
  void nearest(const Point& query, const Allowed& allowed, float& distance, std::int32_t& index) const {
    struct Pending {
      float bound;
      std::int32_t lowest, at;
    };
    std::array<Pending, 128> stack;
    int depth = 0;
    stack[depth++] = {0, 0, root_};
    while (depth > 0) {
      const Pending next = stack[--depth];
      if (next.bound > distance || (next.bound == distance && next.lowest > index)) continue;
      if (next.at < 0) {
        search(leaves_[~next.at], query, allowed, distance, index);
        continue;
      }
      const Node& node = nodes_[next.at];
      const Boxes bounds = squared_distances(node, query);
      const int first = depth;
      for (int c = 0; c < children; ++c) {
        if (!(bounds[c] <= distance)) continue;
        int place = depth++;  // the nearest last
        for (; place > first && stack[place - 1].bound < bounds[c]; --place) stack[place] = stack[place - 1];
        stack[place] = {bounds[c], node.lowest[c], node.child[c]};
      }
    }
  }

  // The `count` nearest of all that are nearer than `bound`, nearest first. Returns how many there are. Distances are
  // squared. With `share` below 1 near ones instead of the nearest: boxes farther than that share of the worst kept are
  // left aside, so that the i-th found is at most as many times 1/share farther than the i-th nearest.
  template <class Allowed>
  int nearest_few(const Point& query, const Allowed& allowed, float bound, int count, float share,
                  std::int32_t* indices) const {
    std::array<float, few> distances;
    int found = 0;
    const auto limit = [&] { return found < count ? bound : distances[found - 1]; };
    std::array<std::pair<float, std::int32_t>, 128> stack;
    int depth = 0;
    stack[depth++] = {0.0f, root_};
    while (depth > 0) {
      const auto [least, at] = stack[--depth];
      if (!(least < share * limit())) continue;
      if (at >= 0) {
        push_children(nodes_[at], squared_distances(nodes_[at], query), share * limit(), stack, depth);
        continue;
      }
      const Leaf& leaf = leaves_[~at];
      const LeafDistances squared = squared_distances(leaf, query);
      if (!(squared.minCoeff() < limit())) continue;
      for (int slot = 0; slot < leaf_size; ++slot) {
        if (!(squared[slot] < limit()) || leaf.index[slot] < 0 || !allowed(leaf.index[slot])) continue;
        int place = found < count ? found++ : found - 1;
        for (; place > 0 && distances[place - 1] > squared[slot]; --place)
          distances[place] = distances[place - 1], indices[place] = indices[place - 1];
        distances[place] = squared[slot];
        indices[place] = leaf.index[slot];
      }
    }
    return found;
  }
  static constexpr int few = 16;  // the greatest `count`

 private:
  static constexpr int leaf_size = 16, children = 8;
  using LeafDistances = Eigen::Array<float, leaf_size, 1>;
  using Boxes = Eigen::Array<float, children, 1>;
  struct Node {
    Boxes lower[dimension], upper[dimension];
    std::int32_t lowest[children];  // of the indices below
    std::int32_t child[children];   // a node, or ~leaf
  };
  struct Leaf {
    Eigen::Array<float, leaf_size, 1> component[dimension];
    std::int32_t index[leaf_size];
  };
  struct Range {
    int begin, end;
    int size() const { return end - begin; }
  };

  int build(const Range& range) {
    if (range.size() <= leaf_size) {
      leaves_.push_back(make_leaf(range));
      return ~(static_cast<int>(leaves_.size()) - 1);
    }
    std::vector<Range> parts{range};
    while (static_cast<int>(parts.size()) < children) {
      const auto largest = std::max_element(parts.begin(), parts.end(),
                                            [](const Range& a, const Range& b) { return a.size() < b.size(); });
      if (largest->size() <= leaf_size) break;
      const int middle = split(*largest), end = largest->end;
      largest->end = middle;
      parts.push_back({middle, end});
    }
    const int at = static_cast<int>(nodes_.size());
    nodes_.emplace_back();
    Node node;
    for (int c = 0; c < children; ++c) {
      const bool used = c < static_cast<int>(parts.size());
      Point lower = Point::Constant(std::numeric_limits<float>::infinity()), upper = -lower;
      if (used) bound(parts[c], lower, upper);
      for (int d = 0; d < dimension; ++d) node.lower[d][c] = lower[d], node.upper[d][c] = upper[d];
      node.lowest[c] = used ? *std::min_element(order_.begin() + parts[c].begin, order_.begin() + parts[c].end) : 0;
      node.child[c] = used ? build(parts[c]) : 0;
    }
    nodes_[at] = node;
    return at;
  }

  Leaf make_leaf(const Range& range) const {
    Leaf leaf;
    for (int slot = 0; slot < leaf_size; ++slot) {
      const bool used = slot < range.size();
      leaf.index[slot] = used ? order_[range.begin + slot] : -1;
      for (int d = 0; d < dimension; ++d)
        leaf.component[d][slot] = used ? points_(leaf.index[slot], d) : std::numeric_limits<float>::infinity();
    }
    return leaf;
  }

  void bound(const Range& range, Point& lower, Point& upper) const {
    for (int i = range.begin; i < range.end; ++i) {
      const Point point = points_.row(order_[i]).transpose().array();
      lower = lower.min(point);
      upper = upper.max(point);
    }
  }

  // Sorts the range into two halves along its widest component; returns where the second begins.
  int split(const Range& range) {
    Point lower = Point::Constant(std::numeric_limits<float>::infinity()), upper = -lower;
    bound(range, lower, upper);
    Eigen::Index axis;
    (upper - lower).maxCoeff(&axis);
    const int middle = (range.begin + range.end) / 2;
    std::nth_element(order_.begin() + range.begin, order_.begin() + middle, order_.begin() + range.end,
                     [&](int a, int b) {
                       return points_(a, axis) != points_(b, axis) ? points_(a, axis) < points_(b, axis) : a < b;
                     });
    return middle;
  }

  // Never more than the squared distance to a point in the box, whatever the rounding.
  static Boxes squared_distances(const Node& node, const Point& query) {
    Boxes sum = Boxes::Zero();
    for (int d = 0; d < dimension; ++d)
      sum += (node.lower[d] - query[d]).max(query[d] - node.upper[d]).max(0.0f).square();
    return sum * (1 - 1e-5f);
  }

  static LeafDistances squared_distances(const Leaf& leaf, const Point& query) {
    LeafDistances squared = (leaf.component[0] - query[0]).square();
    for (int d = 1; d < dimension; ++d) squared += (leaf.component[d] - query[d]).square();
    return squared;
  }

  // The nearest child last.
  template <class Stack>
  static void push_children(const Node& node, const Boxes& bounds, float limit, Stack& stack, int& depth) {
    const int first = depth;
    for (int c = 0; c < children; ++c) {
      if (!(bounds[c] < limit)) continue;
      int place = depth++;
      for (; place > first && stack[place - 1].first < bounds[c]; --place) stack[place] = stack[place - 1];
      stack[place] = {bounds[c], node.child[c]};
    }
  }

  template <class Allowed>
  static void search(const Leaf& leaf, const Point& query, const Allowed& allowed, float& distance,
                     std::int32_t& index) {
    const LeafDistances squared = squared_distances(leaf, query);
    if (!(squared.minCoeff() <= distance)) return;
    for (int slot = 0; slot < leaf_size; ++slot) {
      const std::int32_t found = leaf.index[slot];
      if (squared[slot] > distance || found < 0 || (squared[slot] == distance && found >= index) || !allowed(found))
        continue;
      distance = squared[slot];
      index = found;
    }
  }

  const RowMatrixf& points_;
  std::vector<std::int32_t> order_;
  std::vector<Node> nodes_;
  std::vector<Leaf> leaves_;
  int root_ = 0;
};

}  // namespace shellgrid
