// SPDX-License-Identifier: AGPL-3.0-or-later
#include "solvers/dipole/dual_tree.h"

#include <algorithm>
#include <array>
#include <cmath>
#include <limits>
#include <memory>

#include "meshing/core/error.h"
#include "meshing/core/parallel.h"
#include "solvers/dipole/point_tree.h"

namespace shellgrid {

namespace {

using Node = PointTree::Node;

constexpr int bound_pieces = 48;      // of the sources, for the least a target is sure to get
constexpr int bound_points = 64;      // of the targets that share one such bound
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

// From where on one axis of a node may be interpolated: a bound of the relative error of interpolating e^{−kr} r^{−3}
// at n Chebyshev points over the half extent h, by the function's derivatives, is below `allowed` where
// h / distance is below x(n, k h).
class AxisReach {
 public:
  explicit AxisReach(double allowed) {
    for (int n = 1; n <= PointTree::most_order; ++n)
      for (int i = 0; i <= steps; ++i) {
        double low = 0, high = 2;
        if (error(n, i * step, low) > allowed) {
          least_[n][i] = 0;
          continue;
        }
        for (int k = 0; k < 30; ++k) {
          const double middle = (low + high) / 2;
          (error(n, i * step, middle) > allowed ? high : low) = middle;
        }
        least_[n][i] = static_cast<float>(low);
      }
  }

  // The least distance; infinite where no distance is enough.
  float distance(int n, double decay, float h) const {
    if (!(h > 0)) return 0;
    const double at = decay * static_cast<double>(h) / step;
    if (!(at < steps)) return std::numeric_limits<float>::infinity();
    const float x = least_[n][static_cast<int>(at) + 1];  // falls with k h
    return x > 0 ? h / x : std::numeric_limits<float>::infinity();
  }

 private:
  static double error(int n, double kh, double x) {
    static constexpr double factorial[] = {1, 1, 2, 6, 24, 120};
    double sum = 0, power = 1;
    for (int j = 0; j <= n; ++j) {
      sum += power / factorial[j] * ((n - j + 2) * (n - j + 1) / 2) * std::pow(x, n - j);
      power *= kh;
    }
    return std::ldexp(sum, 1 - n) * (1 + x) * std::exp(kh);
  }

  static constexpr int steps = 160;
  static constexpr double step = 0.025;
  float least_[PointTree::most_order + 1][steps + 1] = {};
};

// From where on a node may be interpolated at each order, per channel, and how many points that takes.
struct NodeReach {
  float squared_distance[PointTree::orders][3];
  int size[PointTree::orders];
};

// `strings` is for nodes whose points lie along a line, where errors of neighbours do not cancel.
std::vector<NodeReach> reaches_of(const PointTree& tree, const RadialProfile& profile, const AxisReach& sheets,
                                  const AxisReach& strings) {
  std::vector<NodeReach> reaches(tree.nodes().size());
  parallel_for(reaches.size(), [&](std::size_t i) {
    const Node& node = tree.nodes()[i];
    const AxisReach& axis = node.half[1] < 0.2f * node.half[0] ? strings : sheets;
    for (int o = 0; o < PointTree::orders; ++o) {
      const std::array<int, 3> n = node.counts(PointTree::least_order + o);
      reaches[i].size[o] = n[0] * n[1] * n[2];
      for (int c = 0; c < 3; ++c) {
        float distance = 0;
        for (int a = 0; a < 3; ++a) distance = std::max(distance, axis.distance(n[a], profile.decay(c), node.half[a]));
        reaches[i].squared_distance[o][c] = distance * distance;
      }
    }
  });
  return reaches;
}

class DualTree {
 public:
  DualTree(const std::vector<Vec3f>& targets, const std::vector<Vec3f>& sources, const std::vector<Rgb>& powers,
           const RadialProfile& profile, const DualTreeOptions& options)
      : profile_(profile), options_(options), target_tree_(targets) {
    if (&targets != &sources && targets != sources) own_source_tree_ = std::make_unique<PointTree>(sources);
    source_tree_ = own_source_tree_ ? own_source_tree_.get() : &target_tree_;
    const auto& nodes = source_tree_->nodes();
    powers_.resize(sources.size());
    for (std::size_t i = 0; i < sources.size(); ++i) powers_[i] = to_lanes(powers[source_tree_->order()[i]]);
    node_powers_.resize(nodes.size());
    parallel_for(
        nodes.size(), [&](std::size_t n) { node_powers_[n] = sums_of(powers_, nodes[n].first, nodes[n].last); }, 16);
    // The bound holds for the worst place of the nearest pair along the worst axis. Most pairs add far less than it to
    // a sum, and with either sign: so much more of it leaves a fifth to two thirds of the tolerance.
    const AxisReach sheets(3 * options.tolerance), strings(1.5 * options.tolerance);
    target_reach_ = reaches_of(target_tree_, profile, sheets, strings);
    if (own_source_tree_) source_reach_ = reaches_of(*own_source_tree_, profile, sheets, strings);
    for (int c = 0; c < 3; ++c) squared_width_[c] = static_cast<float>(profile.width(c) * profile.width(c));
  }

  std::vector<Rgb> sums(DualTreeStatistics& statistics) {
    find_bounds();
    tasks_ = target_nodes_of(std::max(PointTree::leaf_points, target_tree_.nodes()[0].count() / task_share));
    interactions_.resize(tasks_.size());
    counts_.resize(tasks_.size());
    coefficient_at_.assign(target_tree_.nodes().size() * PointTree::orders, -1);
    needed_ = std::vector<std::uint8_t>(source_tree_->nodes().size(), 0);
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
    for (std::size_t i = 0; i < values_.size(); ++i) result[target_tree_.order()[i]] = to_rgb(values_[i]);
    gather(statistics);
    return result;
  }

 private:
  // What each target is sure to get, from below; of nodes what the least of their targets is.
  void find_bounds() {
    const auto& nodes = target_tree_.nodes();
    bounds_.assign(nodes.size(), Float4{});
    std::vector<std::uint8_t> bound(nodes.size(), 0);
    const std::vector<std::int32_t> roots = target_nodes_of(bound_points);
    parallel_for(
        roots.size(), [&](std::size_t i) { bounds_[roots[i]] = bound_of(nodes[roots[i]]); }, 4);
    Float4 greatest = {};
    for (const std::int32_t n : roots) {
      bound[n] = 1;
      greatest = greatest > bounds_[n] ? greatest : bounds_[n];
    }
    const Float4 least = greatest / static_cast<float>(options_.dynamic_range);
    for (const std::int32_t n : roots) bounds_[n] = bounds_[n] > least ? bounds_[n] : least;
    // Children come after their parents: downwards what hangs below a root takes its bound, upwards the least counts.
    for (std::size_t n = 0; n < nodes.size(); ++n)
      if (bound[n] && !nodes[n].is_leaf())
        for (const std::int32_t child : {nodes[n].left, nodes[n].right}) {
          bounds_[child] = bounds_[n];
          bound[child] = 1;
        }
    for (std::size_t n = nodes.size(); n-- > 0;)
      if (!bound[n]) {
        const Float4 a = bounds_[nodes[n].left], b = bounds_[nodes[n].right];
        bounds_[n] = a < b ? a : b;
        bound[n] = 1;
      }
  }

  Float4 bound_of(const Node& target) const {
    const auto& nodes = source_tree_->nodes();
    struct Piece {
      std::int32_t node;
      float promise;  // what it may give at most
    };
    std::array<Piece, bound_pieces + 1> pieces;
    const auto piece = [&](std::int32_t n) {
      const Float4 most = node_powers_[n] * profile_(target.squared_least_distance(nodes[n]));
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
    Float4 sum = {};
    for (int i = 0; i < count; ++i)
      sum += node_powers_[pieces[i].node] * profile_(target.squared_most_distance(nodes[pieces[i].node]));
    return sum;
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
  int order_for(const Node& node, const NodeReach& reach, const std::array<bool, 3>& counts,
                const std::array<float, 3>& squared_distance) const {
    for (int o = 0; o < PointTree::orders; ++o) {
      bool near = false;
      for (int c = 0; c < 3; ++c) near |= counts[c] && squared_distance[c] < reach.squared_distance[o][c];
      if (!near) return node.count() <= reach.size[o] ? as_points : PointTree::least_order + o;
    }
    return node.is_leaf() ? as_points : -1;
  }

  void pair(std::int32_t t, std::int32_t s, std::size_t task) {
    const Node& target = target_tree_.nodes()[t];
    const Node& source = source_tree_->nodes()[s];
    const float least = target.squared_least_distance(source);
    const Float4 power = node_powers_[s], most = power * profile_(least);
    const Float4 due = bounds_[t] * power * static_cast<float>(options_.tolerance / 2);
    std::array<bool, 3> counts;
    bool any = false;
    for (int c = 0; c < 3; ++c) {
      counts[c] = power[c] > 0 && !(most[c] * node_powers_[0][c] <= due[c]);
      any |= counts[c];
    }
    if (!any) {
      if (power[0] > 0 || power[1] > 0 || power[2] > 0) ++counts_[task].skipped_pairs;
      return;
    }
    std::array<float, 3> squared_distance;
    for (int c = 0; c < 3; ++c) squared_distance[c] = least + squared_width_[c];
    const int target_order = order_for(target, target_reach_[t], counts, squared_distance),
              source_order =
                  order_for(source, (own_source_tree_ ? source_reach_ : target_reach_)[s], counts, squared_distance);
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
    std::vector<float> x, y, z;
    std::vector<Float4> power;
  };

  void expand_sources() {
    stands_.resize(needed_.size() * PointTree::orders);
    parallel_for(
        needed_.size(),
        [&](std::size_t n) {
          for (int o = 0; o < PointTree::orders; ++o)
            if (needed_[n] >> o & 1) {
              const Node& node = source_tree_->nodes()[n];
              const int order = PointTree::least_order + o;
              std::vector<Vec3f> places;
              source_tree_->interpolation_points(node, order, places);
              Stand& stand = stands_[n * PointTree::orders + o];
              for (const Vec3f& p : places) {
                stand.x.push_back(p.x());
                stand.y.push_back(p.y());
                stand.z.push_back(p.z());
              }
              stand.power.assign(places.size(), Float4{});
              float weights[PointTree::most_size];
              for (int i = node.first; i < node.last; ++i) {
                const int m = PointTree::interpolation_weights(node, order, source_tree_->points()[i], weights);
                for (int k = 0; k < m; ++k) stand.power[k] += weights[k] * powers_[i];
              }
            }
        },
        8);
    x_.resize(powers_.size());
    y_.resize(powers_.size());
    z_.resize(powers_.size());
    for (std::size_t i = 0; i < powers_.size(); ++i) {
      x_[i] = source_tree_->points()[i].x();
      y_[i] = source_tree_->points()[i].y();
      z_[i] = source_tree_->points()[i].z();
    }
  }

  void evaluate(std::size_t task) {
    DualTreeStatistics& count = counts_[task];
    const auto& nodes = target_tree_.nodes();
    std::vector<Double4> coefficients;
    std::vector<std::pair<std::int32_t, int>> used;  // nodes and orders
    std::vector<Vec3f> places;
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
        target_tree_.interpolation_points(target, i.target_order, places);
        if (place == 0) {
          place = static_cast<std::int32_t>(coefficients.size()) + 1;
          coefficients.resize(coefficients.size() + places.size(), Double4{});
          used.emplace_back(i.target, i.target_order);
        }
        out = coefficients.data() + (place - 1);
        at = places.data();
        outs = static_cast<int>(places.size());
      }
      for (int t = 0; t < outs; ++t) {
        const Vec3f p = at[t];
        Float4 sum = {};
        for (int k = 0; k < size; ++k) {
          const float dx = p.x() - x[k], dy = p.y() - y[k], dz = p.z() - z[k];
          sum += power[k] * profile_(dx * dx + dy * dy + dz * dz);
        }
        out[t] += to_double(sum);
      }
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
  const DualTreeOptions& options_;
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

std::vector<Rgb> dual_tree_sums(const std::vector<Vec3f>& targets, const std::vector<Vec3f>& sources,
                                const std::vector<Rgb>& powers, const RadialProfile& profile,
                                const DualTreeOptions& options, DualTreeStatistics* statistics) {
  if (sources.size() != powers.size()) throw InputError("each source needs one power");
  if (!(options.tolerance > 0 && options.tolerance < 1) || !(options.dynamic_range >= 1))
    throw InputError("sums need a tolerance between 0 and 1 and a dynamic range of at least 1");
  for (const Rgb& power : powers)
    if (!(power >= 0).all() || !power.allFinite()) throw InputError("a source's power is negative or not finite");
  for (const auto* points : {&targets, &sources})
    for (const Vec3f& p : *points)
      if (!p.allFinite()) throw InputError("a point of a sum is not finite");
  DualTreeStatistics own;
  if (targets.empty() || sources.empty()) return std::vector<Rgb>(targets.size(), Rgb::Zero());
  if (options.brute_force) {
    if (statistics) {
      *statistics = {};
      statistics->point_pairs = statistics->evaluations =
          static_cast<std::int64_t>(targets.size()) * static_cast<std::int64_t>(sources.size());
    }
    return sums_of_all_pairs(targets, sources, powers, profile);
  }
  DualTree tree(targets, sources, powers, profile, options);
  return tree.sums(statistics ? *statistics : own);
}

}  // namespace shellgrid
