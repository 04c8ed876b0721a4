// SPDX-License-Identifier: AGPL-3.0-or-later
#include "solvers/dipole/core_exchange.h"

#include <Eigen/Cholesky>
#include <algorithm>
#include <cmath>
#include <utility>

#include "meshing/core/error.h"
#include "meshing/core/parallel.h"

namespace shellgrid {

namespace {

constexpr double bounce_tolerance = 4;  // of bounces, over that of the sum at the end, which makes all of them exact
constexpr double bounced_share = 0.6;   // of the tolerance: each bounce's errors come again with the next one
constexpr int least_steps = 4;          // bounces before it is judged whether they shrink
constexpr float greatest_scale = 4;     // up to which points get back what a small core loses

Eigen::Array3d integral(const CoreSurface& surface, const std::vector<Rgb>& values) {
  return parallel_sum(values.size(), Eigen::Array3d(Eigen::Array3d::Zero()), [&](std::size_t i) {
    return Eigen::Array3d(values[i].cast<double>() * static_cast<double>(surface.areas[i]));
  });
}

// Bounces u_0, u_1 = T u_0, … of a linear T and the sum of all there are, M = u_0 + T M, as u_0 + Σ_j c_j u_j with the
// c by which it misses that least, relative to itself: what GMRES finds in as many steps. Each channel has its own.
class BounceSum {
 public:
  explicit BounceSum(const CoreSurface& surface) : surface_(surface) {}

  void add(std::vector<Rgb> bounce) { bounces_.push_back(std::move(bounce)); }
  int count() const { return static_cast<int>(bounces_.size()); }

  // The sum; `residual`: root mean square over the surface of what it misses that by, relative to it.
  std::vector<Rgb> sum(double& residual) const {
    const std::size_t n = surface_.points.size();
    const int unknown = count() - 2;  // the last bounce is only seen
    std::vector<Rgb> total = bounces_[0];
    residual = 1;
    if (unknown < 1) return total;
    std::vector<Rgb> plain(n, Rgb::Zero());
    for (const std::vector<Rgb>& bounce : bounces_)
      for (std::size_t i = 0; i < n; ++i) plain[i] += bounce[i];
    residual = 0;
    const std::size_t stride = n / most_judged + 1, judged = (n + stride - 1) / stride;
    double area = 0;
    for (std::size_t i = 0; i < n; i += stride) area += static_cast<double>(surface_.areas[i]);
    for (int c = 0; c < 3; ++c) {
      // Products of u_1 and of the u_j − u_{j+1}, over the squared sum, by area.
      using Products = Eigen::Matrix<double, most_unknown + 1, most_unknown + 1>;
      const Products products = parallel_sum(judged, Products(Products::Zero()), [&](std::size_t k) -> Products {
        const std::size_t i = k * stride;
        const auto whole = static_cast<double>(plain[i][c]);
        if (!(whole > 0)) return Products::Zero();
        Eigen::Matrix<double, most_unknown + 1, 1> row = Eigen::Matrix<double, most_unknown + 1, 1>::Zero();
        row[0] = static_cast<double>(bounces_[1][i][c]) / whole;
        for (int j = 1; j <= unknown; ++j)
          row[j] = (static_cast<double>(bounces_[j][i][c]) - static_cast<double>(bounces_[j + 1][i][c])) / whole;
        return static_cast<double>(surface_.areas[i]) * row * row.transpose();
      });
      Eigen::MatrixXd normal = products.block(1, 1, unknown, unknown);
      const Eigen::VectorXd right = products.block(1, 0, unknown, 1);
      normal.diagonal() *= 1 + 1e-10;
      Eigen::VectorXd weights = normal.ldlt().solve(right);
      if (!weights.allFinite()) weights = Eigen::VectorXd::Ones(unknown);
      const double missed =
          products(0, 0) - 2 * weights.dot(right) + weights.dot(products.block(1, 1, unknown, unknown) * weights);
      if (area > 0) residual = std::max(residual, std::sqrt(std::max(0.0, missed) / area));
      for (int j = 1; j <= unknown; ++j) {
        const auto weight = static_cast<float>(weights[j - 1]);
        for (std::size_t i = 0; i < n; ++i) total[i][c] += weight * bounces_[j][i][c];
      }
    }
    for (Rgb& value : total) value = value.max(0);
    return total;
  }

  static constexpr int most_unknown = 12;

 private:
  static constexpr std::size_t most_judged = 8000;  // points, spread evenly
  const CoreSurface& surface_;
  std::vector<std::vector<Rgb>> bounces_;
};

}  // namespace

CoreExchange exchange_core_light(const CoreSurface& surface, const RadialProfile& profile,
                                 const CoreExchangeOptions& options) {
  const std::size_t n = surface.points.size();
  if (surface.areas.size() != n || surface.power.size() != n ||
      (!surface.shell_reflection.empty() && surface.shell_reflection.size() != n))
    throw InputError("the core's surface: its lists do not have its size");
  for (std::size_t i = 0; i < n; ++i) {
    if (!(surface.areas[i] >= 0)) throw InputError("the core's surface has a negative area");
    if (!surface.shell_reflection.empty() &&
        (!(surface.shell_reflection[i] >= 0).all() || !(surface.shell_reflection[i] <= 1).all()))
      throw InputError("the shell's reflection is not between 0 and 1");
  }
  CoreExchange result;
  DualTreeOptions sum_options = options.sums;
  if (!surface.shell_reflection.empty() && options.bounces > 0) sum_options.tolerance *= bounced_share;
  DualTree tree(surface.points, surface.points, profile, sum_options);
  const double later = std::min(0.5, bounce_tolerance * sum_options.tolerance);
  const auto sums = [&](const std::vector<Rgb>& powers, double tolerance) {
    DualTreeStatistics statistics;
    std::vector<Rgb> values = tree.sums(powers, tolerance, &statistics);
    result.evaluations += statistics.evaluations;
    if (tolerance == sum_options.tolerance) result.statistics = statistics;
    return values;
  };
  // By symmetry what a point returns in all is the sum of the areas there.
  std::vector<Rgb> scale;
  if (std::all_of(options.returned.begin(), options.returned.end(), [](double r) { return r >= 0; })) {
    std::vector<Rgb> areas(n);
    for (std::size_t i = 0; i < n; ++i) areas[i] = Rgb::Constant(surface.areas[i]);
    scale = sums(areas, sum_options.tolerance);
    const Rgb most(static_cast<float>(options.returned[0]), static_cast<float>(options.returned[1]),
                   static_cast<float>(options.returned[2]));
    for (Rgb& s : scale) {
      for (int c = 0; c < 3; ++c)
        if (most[c] > 0) result.greatest_return = std::max(result.greatest_return, static_cast<double>(s[c] / most[c]));
      s = (most > 0).select((most / s.max(1e-30f)).min(greatest_scale), Rgb::Ones());
    }
  }
  // What leaves for what comes.
  const auto leaving = [&](const std::vector<Rgb>& coming, double tolerance) {
    if (scale.empty()) return sums(coming, tolerance);
    std::vector<Rgb> powers(n);
    for (std::size_t i = 0; i < n; ++i) powers[i] = coming[i] * scale[i];
    return sums(powers, tolerance);
  };
  // What comes down again of what leaves.
  const auto returned = [&](const std::vector<Rgb>& exitance) {
    std::vector<Rgb> coming(n);
    for (std::size_t i = 0; i < n; ++i) coming[i] = surface.shell_reflection[i] * surface.areas[i] * exitance[i];
    return coming;
  };
  result.power = surface.power;
  if (!surface.shell_reflection.empty() && options.bounces > 0 && n > 0 && options.coarser) {
    CoreExchangeOptions coarse_options = options;
    coarse_options.coarser = nullptr;
    CoreExchange coarse = exchange_core_light(options.coarser->surface, *options.coarser->profile, coarse_options);
    for (std::size_t i = 0; i < coarse.first.size(); ++i) coarse.exitance[i] -= coarse.first[i];
    result.first = leaving(surface.power, later);
    const std::vector<Rgb> more = options.coarser->at_points(coarse.exitance);
    std::vector<Rgb> all(n);
    for (std::size_t i = 0; i < n; ++i) all[i] = (result.first[i] + more[i]).max(0);
    const std::vector<Rgb> coming = returned(all);
    for (std::size_t i = 0; i < n; ++i) result.power[i] += coming[i];
    result.bounces = coarse.bounces;
    result.residual = coarse.residual;
    result.evaluations += coarse.evaluations;
    result.greatest_return = std::max(result.greatest_return, coarse.greatest_return);
  } else if (!surface.shell_reflection.empty() && options.bounces > 0 && n > 0) {
    // All bounces loosely; then the whole once more, exactly.
    BounceSum series(surface);
    std::vector<Rgb> bounce = leaving(surface.power, later), all;
    Eigen::Array3d before = integral(surface, bounce);
    series.add(bounce);
    result.first = bounce;
    while ((before > 0).any()) {
      all = series.sum(result.residual);
      if (series.count() > options.bounces || series.count() == BounceSum::most_unknown + 2 ||
          result.residual <= options.tolerance)
        break;
      bounce = leaving(returned(bounce), later);
      const Eigen::Array3d now = integral(surface, bounce);
      if (series.count() >= least_steps && (now >= before && now > 0).any())
        throw NumericalError(
            "light between shell and core grows from bounce to bounce: on a folded core the dipole returns more light "
            "than enters");
      before = now;
      series.add(bounce);
    }
    result.bounces = series.count();
    if (!all.empty()) {
      const std::vector<Rgb> more = returned(all);
      for (std::size_t i = 0; i < n; ++i) result.power[i] += more[i];
    }
  }
  result.exitance = leaving(result.power, sum_options.tolerance);
  return result;
}

}  // namespace shellgrid
