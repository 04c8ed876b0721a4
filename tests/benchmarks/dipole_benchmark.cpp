// SPDX-License-Identifier: AGPL-3.0-or-later
// The core's dipole summed three ways: over a dual tree, over one tree by the angle that a node is seen under
// [JensenBuhler2002 §3.2], over all pairs. A sphere lit from one side; errors against sums in double precision at a
// share of the points, relative to each value, for points above 1e-4 of the greatest, bright and dim. Prints CSV.
#include <fmt/format.h>

#include <cmath>
#include <cstdio>

#include "meshing/core/parallel.h"
#include "solvers/dipole/dipole.h"
#include "solvers/dipole/dual_tree.h"
#include "solvers/dipole/point_tree.h"
#include "tests/support/timing.h"

using namespace shellgrid;

namespace {

struct Problem {
  std::vector<Vec3f> points;
  std::vector<Rgb> powers;
};

Problem sphere(int count, double radius) {
  Problem p;
  for (int i = 0; i < count; ++i) {
    const double z = 1 - 2 * (i + 0.5) / count, angle = i * 2.399963229728653, r = std::sqrt(1 - z * z);
    const Vec3 n(r * std::cos(angle), r * std::sin(angle), z);
    p.points.push_back((radius * n).cast<float>());
    const double area = 4 * 3.14159265358979 * radius * radius / count;
    p.powers.push_back(Rgb::Constant(static_cast<float>(area * std::max(0.0, n.dot(Vec3(0.48, 0.6, 0.64))))));
  }
  return p;
}

// Each target walks one tree; a node seen under less than `angle` (its area over squared distance) is one source.
std::vector<Rgb> single_tree(const Problem& p, const RadialProfile& profile, float angle, std::int64_t& evaluations) {
  const PointTree tree(p.points);
  const auto& nodes = tree.nodes();
  struct Source {
    Vec3f middle;
    Float4 power;
    float area;
  };
  std::vector<Source> sources(nodes.size());
  parallel_for(nodes.size(), [&](std::size_t n) {
    Vec3 middle = Vec3::Zero();
    Double4 power = {};
    double weight = 0;
    for (int i = nodes[n].first; i < nodes[n].last; ++i) {
      const Rgb& w = p.powers[tree.order()[i]];
      middle += static_cast<double>(w.sum()) * tree.points()[i].cast<double>();
      weight += static_cast<double>(w.sum());
      power += to_double(to_lanes(w));
    }
    const Vec3f half = nodes[n].half;
    sources[n] = {weight > 0 ? Vec3f((middle / weight).cast<float>()) : nodes[n].center, to_float(power),
                  4 * half[0] * half[1]};
  });
  std::vector<Rgb> sums(p.points.size());
  std::vector<std::int64_t> counts(p.points.size(), 0);
  parallel_for(p.points.size(), [&](std::size_t t) {
    Double4 sum = {};
    std::vector<std::int32_t> stack = {0};
    while (!stack.empty()) {
      const std::int32_t n = stack.back();
      stack.pop_back();
      const Vec3f d = p.points[t] - sources[n].middle;
      if (sources[n].area < angle * d.squaredNorm()) {
        sum += to_double(sources[n].power * profile(d.squaredNorm()));
        ++counts[t];
      } else if (nodes[n].is_leaf()) {
        for (int i = nodes[n].first; i < nodes[n].last; ++i)
          sum +=
              to_double(to_lanes(p.powers[tree.order()[i]]) * profile((p.points[t] - tree.points()[i]).squaredNorm()));
        counts[t] += nodes[n].count();
      } else {
        stack.push_back(nodes[n].left);
        stack.push_back(nodes[n].right);
      }
    }
    sums[t] = to_rgb(sum);
  });
  for (const std::int64_t c : counts) evaluations += c;
  return sums;
}

struct Errors {
  double greatest = 0, mean = 0;
};

Errors errors_of(const std::vector<Rgb>& sums, const Problem& p, const RadialProfile& profile) {
  Problem some;
  std::vector<Vec3f> targets;
  std::vector<std::size_t> which;
  for (std::size_t i = 0; i < p.points.size(); i += p.points.size() / 500) {
    targets.push_back(p.points[i]);
    which.push_back(i);
  }
  DualTreeOptions check;
  check.brute_force = true;
  const std::vector<Rgb> exact = dual_tree_sums(targets, p.points, p.powers, profile, check);
  Errors errors;
  double greatest = 0, squares = 0, count = 0;
  for (const Rgb& e : exact) greatest = std::max(greatest, static_cast<double>(e.maxCoeff()));
  for (std::size_t i = 0; i < which.size(); ++i)
    for (int c = 0; c < 3; ++c) {
      const double e = static_cast<double>(exact[i][c]);
      if (e < 1e-4 * greatest) continue;
      const double error = std::abs(static_cast<double>(sums[which[i]][c]) / e - 1);
      errors.greatest = std::max(errors.greatest, error);
      squares += error * error;
      ++count;
    }
  errors.mean = std::sqrt(squares / std::max(1.0, count));
  return errors;
}

}  // namespace

int main() {
  const bool long_form = test::long_form();
  fmt::print(
      "points,decay_per_mm,method,setting,seconds,evaluations_a_point,greatest_error,rms_error,times_all_pairs\n");
  for (const int count : long_form ? std::vector<int>{10000, 30000, 100000, 300000} : std::vector<int>{10000, 100000})
    for (const double absorption :
         long_form ? std::vector<double>{0.0005, 0.01, 0.1} : std::vector<double>{0.0005, 0.1}) {
      const Problem p = sphere(count, 36);
      std::array<Dipole, 3> channels;
      for (int c = 0; c < 3; ++c) channels[c] = Dipole(absorption * (1 + c), 2.0, 1, DipoleEntry::diffuse);
      const RadialProfile profile = dipole_profile(channels, std::sqrt(4.0 / count) * 36);
      // All pairs in single precision as the trees have them, timed at a share of the targets.
      Problem share = p;
      share.points.resize(static_cast<std::size_t>(count / 10));
      DualTreeOptions all;
      all.brute_force = true;
      const double pairs =
          10 * test::seconds_of([&] { dual_tree_sums(share.points, p.points, p.powers, profile, all); });
      const auto print = [&](const char* method, double setting, double seconds, std::int64_t evaluations,
                             const std::vector<Rgb>& sums) {
        const Errors e = errors_of(sums, p, profile);
        fmt::print("{},{:.3f},{},{:g},{:.3f},{:.0f},{:.2e},{:.2e},{:.1f}\n", count, channels[2].decay, method, setting,
                   seconds, static_cast<double>(evaluations) / count, e.greatest, e.mean, pairs / seconds);
        std::fflush(stdout);
      };
      for (const double tolerance : {0.1, 0.02, 0.005}) {
        DualTreeOptions options;
        options.tolerance = tolerance;
        DualTreeStatistics statistics;
        std::vector<Rgb> sums;
        const double seconds = test::median_seconds(
            3, [&] { sums = dual_tree_sums(p.points, p.points, p.powers, profile, options, &statistics); });
        print("dual tree", tolerance, seconds, statistics.evaluations, sums);
      }
      for (const float angle : {0.3f, 0.1f, 0.03f}) {
        std::int64_t evaluations = 0;
        std::vector<Rgb> sums;
        const double seconds = test::seconds_of([&] { sums = single_tree(p, profile, angle, evaluations); });
        print("single tree", static_cast<double>(angle), seconds, evaluations, sums);
      }
    }
}
