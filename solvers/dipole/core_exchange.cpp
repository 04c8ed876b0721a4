// SPDX-License-Identifier: AGPL-3.0-or-later
#include "solvers/dipole/core_exchange.h"

#include <algorithm>

#include "meshing/core/error.h"
#include "meshing/core/parallel.h"

namespace shellgrid {

namespace {

constexpr double later_tolerance = 3;  // bounces are smoother than the light that comes first, and less
constexpr float greatest_scale = 4;    // up to which points get back what a small core loses

Eigen::Array3d integral(const CoreSurface& surface, const std::vector<Rgb>& values) {
  return parallel_sum(values.size(), Eigen::Array3d(Eigen::Array3d::Zero()), [&](std::size_t i) {
    return Eigen::Array3d(values[i].cast<double>() * static_cast<double>(surface.areas[i]));
  });
}

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
  DualTreeOptions later = options.sums;
  later.tolerance = std::min(0.5, later_tolerance * later.tolerance);
  const auto sums = [&](const std::vector<Rgb>& powers, bool first = false) {
    DualTreeStatistics statistics;
    std::vector<Rgb> values =
        dual_tree_sums(surface.points, surface.points, powers, profile, first ? options.sums : later, &statistics);
    if (result.statistics.nodes == 0) result.statistics = statistics;
    return values;
  };
  // By symmetry what a point returns in all is the sum of the areas there.
  std::vector<Rgb> scale;
  if (std::all_of(options.returned.begin(), options.returned.end(), [](double r) { return r >= 0; })) {
    std::vector<Rgb> areas(n);
    for (std::size_t i = 0; i < n; ++i) areas[i] = Rgb::Constant(surface.areas[i]);
    scale = sums(areas);
    const Rgb most(static_cast<float>(options.returned[0]), static_cast<float>(options.returned[1]),
                   static_cast<float>(options.returned[2]));
    for (Rgb& s : scale) {
      for (int c = 0; c < 3; ++c)
        if (most[c] > 0) result.greatest_return = std::max(result.greatest_return, static_cast<double>(s[c] / most[c]));
      s = (most > 0).select((most / s.max(1e-30f)).min(greatest_scale), Rgb::Ones());
    }
  }
  result.power = surface.power;
  result.exitance.assign(n, Rgb::Zero());
  std::vector<Rgb> coming = surface.power, powers(n);
  Eigen::Array3d before = Eigen::Array3d::Zero();
  for (int bounce = 0;; ++bounce) {
    for (std::size_t i = 0; i < n; ++i) powers[i] = scale.empty() ? coming[i] : Rgb(coming[i] * scale[i]);
    const std::vector<Rgb> leaving = sums(powers, bounce == 0);
    result.bounces = bounce;
    const Eigen::Array3d now = integral(surface, leaving);
    for (std::size_t i = 0; i < n; ++i) result.exitance[i] += leaving[i];
    if (surface.shell_reflection.empty() || bounce >= options.bounces || !(now > 0).any()) break;
    if (bounce > 0) {
      // Each channel's ratio of bounces; what would follow is a geometric series.
      const Eigen::Array3d ratio = (before > 0).select(now / before.max(1e-300), 0.0);
      if (bounce >= 4 && (ratio >= 1).any())
        throw NumericalError(
            "light between shell and core grows from bounce to bounce: on a folded core the dipole returns more light "
            "than enters");
      const Eigen::Array3d rest = ratio.min(0.999) / (1 - ratio.min(0.999)),
                           share = (now > 0).select(now * rest / integral(surface, result.exitance).max(1e-300), 0.0);
      // The series is trusted to a tenth of itself.
      if (share.maxCoeff() * 0.1 <= options.tolerance || bounce == options.bounces - 1) {
        result.series_share = share.maxCoeff();
        for (std::size_t i = 0; i < n; ++i) {
          const Rgb more = leaving[i] * rest.cast<float>();
          result.exitance[i] += more;
          result.power[i] += surface.shell_reflection[i] * surface.areas[i] * (leaving[i] + more);
        }
        break;
      }
    }
    for (std::size_t i = 0; i < n; ++i) {
      coming[i] = surface.shell_reflection[i] * surface.areas[i] * leaving[i];
      result.power[i] += coming[i];
    }
    before = now;
  }
  return result;
}

}  // namespace shellgrid
