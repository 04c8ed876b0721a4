// SPDX-License-Identifier: AGPL-3.0-or-later
#pragma once
#include <cmath>
#include <cstdint>
#include <cstring>
#include <limits>
#include <vector>

#ifdef __AVX512F__
#include <immintrin.h>
#endif

#include "meshing/core/vec.h"

namespace shellgrid {

// Eight doubles treated lane by lane; the compiler maps them to the widest registers there are.
using Lanes = double __attribute__((vector_size(64)));

struct Box {
  Vec3 lower = Vec3::Constant(std::numeric_limits<double>::infinity());
  Vec3 upper = Vec3::Constant(-std::numeric_limits<double>::infinity());
  void add(const Vec3& point) {
    lower = lower.cwiseMin(point);
    upper = upper.cwiseMax(point);
  }
  void add(const Box& box) {
    lower = lower.cwiseMin(box.lower);
    upper = upper.cwiseMax(box.upper);
  }
  bool overlaps(const Box& box) const {
    return (lower.array() <= box.upper.array()).all() && (box.lower.array() <= upper.array()).all();
  }
};

// A tree of bounding boxes with eight children a node and up to eight items a leaf, split at medians
// along the longest axis. Its shape depends on the items alone.
class BoxTree {
 public:
  static constexpr int width = 8;

  BoxTree() = default;
  explicit BoxTree(const std::vector<Box>& items);

  int leaf_count() const { return static_cast<int>(order_.size() / width); }
  // The items of leaf l are item(l, 0 … 7); -1 where it holds fewer.
  int item(int leaf, int slot) const { return order_[static_cast<std::size_t>(leaf) * width + slot]; }

  // Calls visit(leaf) for every leaf whose box may be nearer to the point than √best, near ones first.
  // `visit` lowers `best`, the squared distance found so far, as it goes.
  template <class Visit>
  void search(const Vec3& point, double& best, const Visit& visit) const {
    struct Pending {
      double bound;
      std::int32_t child;
    };
    if (nodes_.empty()) return;
    Pending stack[256];
    int size = 0;
    stack[size++] = {0, 0};
    while (size > 0) {
      const Pending top = stack[--size];
      if (top.bound > best) continue;
      if (top.child < 0) {
        visit(~top.child);
        continue;
      }
      const Node& node = nodes_[top.child];
      alignas(64) double bounds[width];
      unsigned near = box_distances(node, point, best, bounds);
      const int first = size;
      for (; near != 0; near &= near - 1) {
        const int lane = __builtin_ctz(near);
        int at = size++;
        for (; at > first && stack[at - 1].bound < bounds[lane]; --at) stack[at] = stack[at - 1];
        stack[at] = {bounds[lane], node.child[lane]};
      }
    }
  }

  // Calls visit(leaf) for every leaf whose box overlaps the given one.
  template <class Visit>
  void visit_overlaps(const Box& box, const Visit& visit) const {
    if (nodes_.empty()) return;
    std::int32_t stack[256];
    int size = 0;
    stack[size++] = 0;
    while (size > 0) {
      const std::int32_t child = stack[--size];
      if (child < 0) {
        visit(~child);
        continue;
      }
      const Node& node = nodes_[child];
      for (int lane = 0; lane < node.child_count; ++lane) {
        bool apart = false;
        for (int axis = 0; axis < 3; ++axis)
          apart |= node.lower[axis][lane] > box.upper[axis] || node.upper[axis][lane] < box.lower[axis];
        if (!apart) stack[size++] = node.child[lane];
      }
    }
  }

 private:
  struct alignas(64) Node {
    double lower[3][width];
    double upper[3][width];
    std::int32_t child[width];  // node index, or ~leaf
    std::int32_t child_count;
  };

  // Squared distances from the point to the children's boxes; returns the lanes not beyond `best`.
  static unsigned box_distances(const Node& node, const Vec3& point, double best, double* bounds) {
    const Lanes zero = {};
    Lanes sum = {};
    for (int axis = 0; axis < 3; ++axis) {
      Lanes lower, upper;
      std::memcpy(&lower, node.lower[axis], sizeof lower);
      std::memcpy(&upper, node.upper[axis], sizeof upper);
      const double p = point[axis];
      Lanes gap = lower - p;
      const Lanes over = p - upper;
      gap = gap > over ? gap : over;
      gap = gap > zero ? gap : zero;
      sum += gap * gap;
    }
    std::memcpy(bounds, &sum, sizeof sum);
    unsigned mask = 0;
#ifdef __AVX512F__
    mask = _mm512_cmp_pd_mask(reinterpret_cast<__m512d>(sum), _mm512_set1_pd(best), _CMP_LE_OQ);
#else
    for (int lane = 0; lane < width; ++lane) mask |= static_cast<unsigned>(bounds[lane] <= best) << lane;
#endif
    return mask & ((1u << node.child_count) - 1);
  }

  Box build_node(const std::vector<Box>& items, int first_leaf, int leaves, std::int32_t& child);

  std::vector<std::int32_t> order_;
  std::vector<Node> nodes_;
};

}  // namespace shellgrid
