// SPDX-License-Identifier: AGPL-3.0-or-later
#include "solvers/dipole/node_reach.h"

#include <algorithm>
#include <cmath>
#include <limits>

#include "meshing/core/parallel.h"

namespace shellgrid {

namespace {

constexpr double sheet_share = 3, string_share = 1.5;  // of the tolerance, allowed to the bound
constexpr double most_allowed = 0.6;

// From where on one axis of a node may be interpolated: the bound is below `allowed` where h / distance is below
// x(n, k h).
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
        for (int k = 0; k < 20; ++k) {
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
    double powers[PointTree::most_order + 1] = {1}, sum = 0, power = 1;
    for (int j = 1; j <= n; ++j) powers[j] = powers[j - 1] * x;
    for (int j = 0; j <= n; ++j) {
      sum += power / factorial[j] * ((n - j + 2) * (n - j + 1) / 2) * powers[n - j];
      power *= kh;
    }
    return std::ldexp(sum, 1 - n) * (1 + x) * std::exp(kh);
  }

  static constexpr int steps = 160;
  static constexpr double step = 0.025;
  float least_[PointTree::most_order + 1][steps + 1] = {};
};

}  // namespace

std::vector<NodeReach> reaches_of(const PointTree& tree, const RadialProfile& profile, double tolerance) {
  std::vector<AxisReach> sheets, strings;
  for (int grade = 0; grade < reach_grades; ++grade) {
    const double graded = std::ldexp(tolerance, 2 * grade);
    sheets.emplace_back(std::min(most_allowed, sheet_share * graded));
    strings.emplace_back(std::min(most_allowed, string_share * graded));
  }
  std::vector<NodeReach> reaches(tree.nodes().size());
  parallel_for(reaches.size(), [&](std::size_t i) {
    const PointTree::Node& node = tree.nodes()[i];
    const std::vector<AxisReach>& axis = node.half[1] < 0.2f * node.half[0] ? strings : sheets;
    for (int o = 0; o < PointTree::orders; ++o) {
      const std::array<int, 3> n = node.counts(PointTree::least_order + o);
      reaches[i].size[o] = n[0] * n[1] * n[2];
      for (int grade = 0; grade < reach_grades; ++grade)
        for (int c = 0; c < 3; ++c) {
          float distance = 0;
          for (int a = 0; a < 3; ++a)
            distance = std::max(distance, axis[grade].distance(n[a], profile.decay(c), node.half[a]));
          reaches[i].squared_distance[grade][o][c] = distance * distance;
        }
    }
  });
  return reaches;
}

}  // namespace shellgrid
