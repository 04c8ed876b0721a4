// SPDX-License-Identifier: AGPL-3.0-or-later
// A binary tree of points whose nodes are boxes along their points' principal axes.
#pragma once
#include <array>
#include <cstdint>
#include <vector>

#include "meshing/core/vec.h"

namespace shellgrid {

class PointTree {
 public:
  static constexpr int leaf_points = 16;
  static constexpr int least_order = 2, most_order = 5, orders = most_order - least_order + 1;

  struct Node {
    std::int32_t first = 0, last = 0;    // of points()
    std::int32_t left = -1, right = -1;  // −1: a leaf
    Vec3f low = Vec3f::Zero(), high = Vec3f::Zero();
    Vec3f center = Vec3f::Zero();  // of the box along the axes
    std::array<Vec3f, 3> axes;     // unit
    Vec3f half = Vec3f::Zero();    // extents along them, falling

    int count() const { return last - first; }
    bool is_leaf() const { return left < 0; }
    float squared_least_distance(const Node& other) const;
    float squared_most_distance(const Node& other) const;
    // Interpolation points along each axis at an order: as many as keep a thin axis' error below the longest one's.
    std::array<int, 3> counts(int order) const;
    int size(int order) const {
      const std::array<int, 3> n = counts(order);
      return n[0] * n[1] * n[2];
    }
  };

  // points: at least one. The same tree at any thread count.
  explicit PointTree(const std::vector<Vec3f>& points);

  const std::vector<Node>& nodes() const { return nodes_; }          // the root first, children after their parents
  const std::vector<std::int32_t>& order() const { return order_; }  // the point each of points() was
  const std::vector<Vec3f>& points() const { return points_; }

  // The interpolation points of a node, by the axes: the first runs fastest.
  void interpolation_points(const Node& node, int order, std::vector<Vec3f>& places) const;
  // What each of them weighs at a point: their Lagrange polynomials. Returns their number.
  static int interpolation_weights(const Node& node, int order, const Vec3f& point, float* weights);
  static constexpr int most_size = most_order * most_order * most_order;

  std::size_t bytes() const {
    return nodes_.size() * sizeof(Node) + order_.size() * sizeof(std::int32_t) + points_.size() * sizeof(Vec3f);
  }

 private:
  void bound(Node& node) const;

  std::vector<Node> nodes_;
  std::vector<std::int32_t> order_;
  std::vector<Vec3f> points_;
};

}  // namespace shellgrid
