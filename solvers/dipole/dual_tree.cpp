// SPDX-License-Identifier: AGPL-3.0-or-later
#include "solvers/dipole/dual_tree.h"

#include <algorithm>
#include <array>
#include <cmath>
#include <limits>
#include <memory>

#include "meshing/core/error.h"
#include "meshing/core/parallel.h"
#include "solvers/dipole/node_reach.h"
#include "solvers/dipole/point_tree.h"

namespace shellgrid {

namespace {

using Node = PointTree::Node;

constexpr int bound_pieces = 48;      // of the sources, for the least a target is sure to get
constexpr float none_share = 0.016f;  // of the tolerance of the target: what gives less is left out
constexpr float little_share = 0.1f;  // of the target: what gives less may be as wrong as what gives this
constexpr int task_share = 64;        // targets are given to threads in pieces of 1 / this
constexpr std::int8_t as_points = 0;  // in place of an order: a node's points themselves

Float4 sums_of(const std::vector<Float4>& values, int first, int last) {
  Double4 sum = {};
  for (int i = first; i < last; ++i) sum += to_double(values[i]);
  return to_float(sum);
}

// A node pair's way of being evaluated.
struct Interaction {
  std::int32_t target, source;
  std::int8_t target_order, source_order;
};

std::vector<Rgb> sums_of_all_pairs(const std::vector<Vec3f>& targets, const std::vector<Vec3f>& sources,
                                   const std::vector<Rgb>& powers, const RadialProfile& profile) {
  std::vector<Rgb> result(targets.size());
  parallel_for(
      targets.size(),
      [&](std::size_t t) {
        Double4 sum = {};
        for (std::size_t s = 0; s < sources.size(); ++s)
          sum += to_double(to_lanes(powers[s])) * to_double(profile((targets[t] - sources[s]).squaredNorm()));
        result[t] = to_rgb(sum);
      },
      16);
  return result;
}

}  // namespace

struct DualTree::Impl {
  Impl(const std::vector<Vec3f>& targets, const std::vector<Vec3f>& sources, const RadialProfile& profile,
       const DualTreeOptions& options)
      : profile_(profile), options_(options), target_tree_(targets) {
    if (&targets != &sources && targets != sources) own_source_tree_ = std::make_unique<PointTree>(sources);
    source_tree_ = own_source_tree_ ? own_source_tree_.get() : &target_tree_;
    const std::size_t n = source_tree_->points().size();
    for (auto* list : {&x_, &y_, &z_}) list->assign(n + RadialProfile::lanes, 0);
    for (std::size_t i = 0; i < n; ++i) {
      x_[i] = source_tree_->points()[i].x();
      y_[i] = source_tree_->points()[i].y();
      z_[i] = source_tree_->points()[i].z();
    }
    target_reach_ = reaches_of(target_tree_, profile, options.tolerance);
    if (own_source_tree_) source_reach_ = reaches_of(*own_source_tree_, profile, options.tolerance);
    for (int c = 0; c < 3; ++c) squared_width_[c] = static_cast<float>(profile.width(c) * profile.width(c));
    tasks_ = target_nodes_of(std::max(PointTree::leaf_points, target_tree_.nodes()[0].count() / task_share));
  }

  std::vector<Rgb> sums(const std::vector<Rgb>& powers, int first_grade, DualTreeStatistics& statistics) {
    first_grade_ = first_grade;
    tolerance_ = std::ldexp(options_.tolerance, 2 * first_grade);
    const auto& nodes = source_tree_->nodes();
    powers_.resize(powers.size());
    for (std::size_t i = 0; i < powers.size(); ++i) powers_[i] = to_lanes(powers[source_tree_->order()[i]]);
    node_powers_.resize(nodes.size());
    parallel_for(
        nodes.size(), [&](std::size_t n) { node_powers_[n] = sums_of(powers_, nodes[n].first, nodes[n].last); }, 16);
    find_bounds();
    interactions_.assign(tasks_.size(), {});
    counts_.assign(tasks_.size(), {});
    coefficient_at_.assign(target_tree_.nodes().size() * PointTree::orders, -1);
    needed_.assign(source_tree_->nodes().size(), 0);
    parallel_for(
        tasks_.size(), [&](std::size_t t) { pair(tasks_[t], 0, t); }, 1);
    for (const auto& list : interactions_)
      for (const Interaction& i : list)
        if (i.source_order != as_points)
          needed_[i.source] |= static_cast<std::uint8_t>(1 << (i.source_order - PointTree::least_order));
    expand_sources();
    values_.assign(target_tree_.points().size(), Double4{});
    parallel_for(
        tasks_.size(), [&](std::size_t t) { evaluate(t); }, 1);
    std::vector<Rgb> result(values_.size());
    // Beyond the dynamic range an expansion may fall below 0, where no sum is.
    for (std::size_t i = 0; i < values_.size(); ++i) result[target_tree_.order()[i]] = to_rgb(values_[i]).max(0);
    gather(statistics);
    return result;
  }

 private:
  // What each target is sure to get, from below; of nodes what the least of their targets is.
  void find_bounds() {
    const auto& nodes = target_tree_.nodes();
    bounds_.assign(nodes.size(), Float4{});
    parallel_for(
        nodes.size(),
        [&](std::size_t n) {
          if (nodes[n].is_leaf()) bounds_[n] = bound_of(nodes[n]);
        },
        16);
    Float4 greatest = {};
    for (const Float4& bound : bounds_) greatest = greatest > bound ? greatest : bound;
    const Float4 least = greatest / static_cast<float>(options_.dynamic_range);
    // Children come after their parents.
    for (std::size_t n = nodes.size(); n-- > 0;) {
      if (!nodes[n].is_leaf()) {
        const Float4 a = bounds_[nodes[n].left], b = bounds_[nodes[n].right];
        bounds_[n] = a < b ? a : b;
      }
      bounds_[n] = bounds_[n] > least ? bounds_[n] : least;
    }
  }

  // Of the targets of a leaf: near leaves of sources count point by point, other nodes as if their light came from
  // their farthest corner.
  Float4 bound_of(const Node& leaf) const {
    const auto& nodes = source_tree_->nodes();
    struct Piece {
      std::int32_t node;
      float promise;  // what it may give at most
    };
    std::array<Piece, bound_pieces + 1> pieces;
    const auto piece = [&](std::int32_t n) {
      const Float4 most = node_powers_[n] * profile_(leaf.squared_least_distance(nodes[n]));
      return Piece{n, nodes[n].is_leaf() ? -1.0f : most[0] + most[1] + most[2]};
    };
    int count = 1;
    pieces[0] = piece(0);
    while (count < bound_pieces) {
      int best = 0;
      for (int i = 1; i < count; ++i)
        if (pieces[i].promise > pieces[best].promise) best = i;
      if (!(pieces[best].promise > 0)) break;
      const Node& node = nodes[pieces[best].node];
      pieces[best] = piece(node.left);
      pieces[count++] = piece(node.right);
    }
    Float4 least = Float4{} + std::numeric_limits<float>::infinity();
    for (std::int32_t t = leaf.first; t < leaf.last; ++t) {
      Node point;
      point.low = point.high = target_tree_.points()[t];
      Float4 sum = {};
      for (int i = 0; i < count; ++i) {
        const Node& node = nodes[pieces[i].node];
        if (node.is_leaf())
          sum += profile_.sum(point.low, x_.data() + node.first, y_.data() + node.first, z_.data() + node.first,
                              powers_.data() + node.first, node.count());
        else
          sum += node_powers_[pieces[i].node] * profile_(point.squared_most_distance(node));
      }
      least = least < sum ? least : sum;
    }
    return least;
  }

  // A partition of the targets: the largest nodes of at most so many points, or leaves.
  std::vector<std::int32_t> target_nodes_of(int most) const {
    const auto& nodes = target_tree_.nodes();
    std::vector<std::int32_t> found, stack = {0};
    while (!stack.empty()) {
      const std::int32_t n = stack.back();
      stack.pop_back();
      if (nodes[n].is_leaf() || nodes[n].count() <= most) {
        found.push_back(n);
      } else {
        stack.push_back(nodes[n].right);
        stack.push_back(nodes[n].left);
      }
    }
    return found;
  }

  // The least order at which a node may be interpolated; as_points where its points are no more than that; −1: none.
  // grade: of each channel; −1: it does not count.
  int order_for(const Node& node, const NodeReach& reach, const std::array<int, 3>& grade,
                const std::array<float, 3>& squared_distance) const {
    for (int o = 0; o < PointTree::orders; ++o) {
      bool near = false;
      for (int c = 0; c < 3; ++c) near |= grade[c] >= 0 && squared_distance[c] < reach.squared_distance[grade[c]][o][c];
      if (!near) return node.count() <= reach.size[o] ? as_points : PointTree::least_order + o;
    }
    return node.is_leaf() ? as_points : -1;
  }

  void pair(std::int32_t t, std::int32_t s, std::size_t task) {
    const Node& target = target_tree_.nodes()[t];
    const Node& source = source_tree_->nodes()[s];
    const float least = target.squared_least_distance(source);
    const Float4 power = node_powers_[s], most = power * profile_(least);
    // What the target is sure to get is the measure. Half of the tolerance of it is shared out among the sources by
    // their power, too.
    const Float4 due = bounds_[t] * power * static_cast<float>(tolerance_ / 2), little = bounds_[t] * little_share,
                 none = bounds_[t] * static_cast<float>(tolerance_ * none_share);
    std::array<int, 3> grade;
    bool any = false;
    for (int c = 0; c < 3; ++c) {
      grade[c] = -1;
      if (!(power[c] > 0) || most[c] * node_powers_[0][c] <= due[c] || most[c] <= none[c]) continue;
      any = true;
      grade[c] = first_grade_;
      for (float times = 4; grade[c] + 1 < reach_grades && most[c] * times <= little[c]; times *= 4) ++grade[c];
    }
    if (!any) {
      if (power[0] > 0 || power[1] > 0 || power[2] > 0) ++counts_[task].skipped_pairs;
      return;
    }
    std::array<float, 3> squared_distance;
    for (int c = 0; c < 3; ++c) squared_distance[c] = least + squared_width_[c];
    const int target_order = order_for(target, target_reach_[t], grade, squared_distance),
              source_order =
                  order_for(source, (own_source_tree_ ? source_reach_ : target_reach_)[s], grade, squared_distance);
    if (target_order >= 0 && source_order >= 0) {
      interactions_[task].push_back(
          {t, s, static_cast<std::int8_t>(target_order), static_cast<std::int8_t>(source_order)});
      if (target_order != as_points)
        coefficient_at_[static_cast<std::size_t>(t) * PointTree::orders + target_order - PointTree::least_order] = 0;
      return;
    }
    const bool target_can = !target.is_leaf(), source_can = !source.is_leaf();
    const bool split_target =
        target_can && (!source_can || (target_order < 0 && (source_order >= 0 || target.half[0] >= source.half[0])));
    if (split_target) {
      pair(target.left, s, task);
      pair(target.right, s, task);
    } else {
      pair(t, source.left, task);
      pair(t, source.right, task);
    }
  }

  // Places and powers that stand for the sources of each node and order that is asked for.
  struct Stand {
    std::vector<float> x, y, z;  // longer by RadialProfile::lanes
    std::vector<Float4> power;
  };

  void expand_sources() {
    stands_.resize(needed_.size() * PointTree::orders);
    parallel_for(
        needed_.size(),
        [&](std::size_t n) {
          for (int o = 0; o < PointTree::orders; ++o)
            if (needed_[n] >> o & 1) expand(static_cast<std::int32_t>(n), PointTree::least_order + o);
        },
        8);
  }

  void expand(std::int32_t n, int order) {
    const Node& node = source_tree_->nodes()[n];
    Stand& stand = stands_[static_cast<std::size_t>(n) * PointTree::orders + order - PointTree::least_order];
    if (stand.x.empty()) {
      std::vector<Vec3f> places;
      source_tree_->interpolation_points(node, order, places);
      stand.power.resize(places.size());
      for (auto* list : {&stand.x, &stand.y, &stand.z}) list->assign(places.size() + RadialProfile::lanes, 0);
      for (std::size_t k = 0; k < places.size(); ++k) {
        stand.x[k] = places[k].x();
        stand.y[k] = places[k].y();
        stand.z[k] = places[k].z();
      }
    }
    std::fill(stand.power.begin(), stand.power.end(), Float4{});
    float weights[PointTree::most_size];
    for (int i = node.first; i < node.last; ++i) {
      const int m = PointTree::interpolation_weights(node, order, source_tree_->points()[i], weights);
      for (int k = 0; k < m; ++k) stand.power[k] += weights[k] * powers_[i];
    }
  }

  void evaluate(std::size_t task) {
    DualTreeStatistics& count = counts_[task];
    const auto& nodes = target_tree_.nodes();
    std::vector<Double4> coefficients;
    std::vector<std::pair<std::int32_t, int>> used;  // nodes and orders
    std::vector<Vec3f> places, few;                  // of the coefficients
    for (const Interaction& i : interactions_[task]) {
      const Node& target = nodes[i.target];
      const Node& source = source_tree_->nodes()[i.source];
      const float *x, *y, *z;
      const Float4* power;
      int size;
      if (i.source_order == as_points) {
        x = x_.data() + source.first;
        y = y_.data() + source.first;
        z = z_.data() + source.first;
        power = powers_.data() + source.first;
        size = source.count();
      } else {
        const Stand& stand =
            stands_[static_cast<std::size_t>(i.source) * PointTree::orders + i.source_order - PointTree::least_order];
        x = stand.x.data();
        y = stand.y.data();
        z = stand.z.data();
        power = stand.power.data();
        size = static_cast<int>(stand.power.size());
      }
      Double4* out;
      const Vec3f* at;
      int outs;
      if (i.target_order == as_points) {
        out = values_.data() + target.first;
        at = target_tree_.points().data() + target.first;
        outs = target.count();
      } else {
        std::int32_t& place = coefficient_at_[static_cast<std::size_t>(i.target) * PointTree::orders + i.target_order -
                                              PointTree::least_order];
        if (place == 0) {
          place = static_cast<std::int32_t>(coefficients.size()) + 1;
          target_tree_.interpolation_points(target, i.target_order, few);
          places.insert(places.end(), few.begin(), few.end());
          coefficients.resize(places.size(), Double4{});
          used.emplace_back(i.target, i.target_order);
        }
        out = coefficients.data() + (place - 1);
        at = places.data() + (place - 1);
        outs = target_reach_[i.target].size[i.target_order - PointTree::least_order];
      }
      for (int t = 0; t < outs; ++t) out[t] += to_double(profile_.sum(at[t], x, y, z, power, size));
      const std::int64_t evaluations = static_cast<std::int64_t>(outs) * size;
      count.evaluations += evaluations;
      if (i.target_order == as_points && i.source_order == as_points)
        count.point_pairs += evaluations;
      else
        ++count.node_pairs;
    }
    float weights[PointTree::most_size];
    for (const auto& [n, order] : used) {
      const Node& node = nodes[n];
      const std::int32_t place =
          coefficient_at_[static_cast<std::size_t>(n) * PointTree::orders + order - PointTree::least_order] - 1;
      for (int i = node.first; i < node.last; ++i) {
        const int m = PointTree::interpolation_weights(node, order, target_tree_.points()[i], weights);
        Double4 sum = {};
        for (int k = 0; k < m; ++k) sum += static_cast<double>(weights[k]) * coefficients[place + k];
        values_[i] += sum;
      }
    }
  }

  void gather(DualTreeStatistics& statistics) const {
    statistics = {};
    for (const DualTreeStatistics& count : counts_) {
      statistics.point_pairs += count.point_pairs;
      statistics.node_pairs += count.node_pairs;
      statistics.evaluations += count.evaluations;
      statistics.skipped_pairs += count.skipped_pairs;
    }
    statistics.nodes = static_cast<std::int64_t>(target_tree_.nodes().size());
    statistics.bytes =
        target_tree_.bytes() + powers_.size() * (sizeof(Float4) + 3 * sizeof(float)) + values_.size() * sizeof(Double4);
    if (own_source_tree_) {
      statistics.nodes += static_cast<std::int64_t>(own_source_tree_->nodes().size());
      statistics.bytes += own_source_tree_->bytes();
    }
    for (const Stand& stand : stands_) statistics.bytes += stand.power.size() * (sizeof(Float4) + 3 * sizeof(float));
    for (const auto& list : interactions_) statistics.bytes += list.size() * sizeof(Interaction);
  }

  const RadialProfile& profile_;
  const DualTreeOptions options_;
  int first_grade_ = 0;
  double tolerance_ = 0;  // of this grade
  PointTree target_tree_;
  std::unique_ptr<PointTree> own_source_tree_;
  const PointTree* source_tree_ = nullptr;
  std::vector<Float4> powers_, node_powers_;  // in the source tree's order
  std::vector<float> x_, y_, z_;              // of its points
  std::vector<NodeReach> target_reach_, source_reach_;
  std::array<float, 3> squared_width_ = {};
  std::vector<Float4> bounds_;       // of the target tree's nodes
  std::vector<std::int32_t> tasks_;  // target nodes, a partition
  std::vector<std::vector<Interaction>> interactions_;
  std::vector<DualTreeStatistics> counts_;
  std::vector<std::int32_t> coefficient_at_;  // of each target node and order: 1 + its place in its task's; −1 unused
  std::vector<std::uint8_t> needed_;          // orders of each source node, as bits
  std::vector<Stand> stands_;                 // of each source node and order
  std::vector<Double4> values_;               // at the targets, in their tree's order
};

DualTree::DualTree(const std::vector<Vec3f>& targets, const std::vector<Vec3f>& sources, const RadialProfile& profile,
                   const DualTreeOptions& options)
    : targets_(targets), sources_(sources), profile_(profile), options_(options) {
  if (!(options.tolerance > 0 && options.tolerance < 1) || !(options.dynamic_range >= 1))
    throw InputError("sums need a tolerance between 0 and 1 and a dynamic range of at least 1");
  for (const auto* points : {&targets, &sources})
    for (const Vec3f& p : *points)
      if (!p.allFinite()) throw InputError("a point of a sum is not finite");
  if (!options.brute_force && !targets.empty() && !sources.empty())
    impl_ = std::make_unique<Impl>(targets, sources, profile, options);
}

DualTree::~DualTree() = default;

std::vector<Rgb> DualTree::sums(const std::vector<Rgb>& powers, double tolerance, DualTreeStatistics* statistics) {
  if (sources_.size() != powers.size()) throw InputError("each source needs one power");
  for (const Rgb& power : powers)
    if (!(power >= 0).all() || !power.allFinite()) throw InputError("a source's power is negative or not finite");
  if (targets_.empty() || sources_.empty()) return std::vector<Rgb>(targets_.size(), Rgb::Zero());
  if (!impl_) {
    if (statistics) {
      *statistics = {};
      statistics->point_pairs = statistics->evaluations =
          static_cast<std::int64_t>(targets_.size()) * static_cast<std::int64_t>(sources_.size());
    }
    return sums_of_all_pairs(targets_, sources_, powers, profile_);
  }
  int grade = 0;
  while (grade + 1 < reach_grades && std::ldexp(options_.tolerance, 2 * grade + 2) <= 1.001 * tolerance) ++grade;
  DualTreeStatistics own;
  return impl_->sums(powers, grade, statistics ? *statistics : own);
}

std::vector<Rgb> dual_tree_sums(const std::vector<Vec3f>& targets, const std::vector<Vec3f>& sources,
                                const std::vector<Rgb>& powers, const RadialProfile& profile,
                                const DualTreeOptions& options, DualTreeStatistics* statistics) {
  return DualTree(targets, sources, profile, options).sums(powers, options.tolerance, statistics);
}

}  // namespace shellgrid
