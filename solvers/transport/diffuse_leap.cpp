// SPDX-License-Identifier: AGPL-3.0-or-later
#include "solvers/transport/diffuse_leap.h"

namespace shellgrid {
namespace {

constexpr double margin = 14;          // mean free paths left to anything else: e⁻¹⁴ of the other parts
constexpr double least_radius = 10;    // mean free paths; a smaller sphere saves nothing
constexpr double slowest_decay = 0.6;  // of the other parts' rate
constexpr double most_backward = -0.7;
constexpr double most_forward = 0.999;  // beyond it next to no scattering forgets its direction

// h₀ − y²/(h₁ − 4y²/(h₂ − 9y²/(h₃ − …))), h_l = (2l + 1)(1 − α gˡ): zero where e^{−y σ_t x} is a solution.
// Source: [CaseZweifel1967].
double dispersion(double y, double absorption, double albedo, double anisotropy) {
  const int terms =
      60 + (std::abs(anisotropy) > 0 ? static_cast<int>(std::min(40000.0, -40 / std::log(std::abs(anisotropy)))) : 0);
  double tail = 2 * terms + 1;
  for (int l = terms - 1; l >= 0; --l) {
    const double h = (2 * l + 1) * (l == 0 ? absorption : 1 - albedo * std::pow(anisotropy, l));
    tail = h - (l + 1.0) * (l + 1.0) * y * y / tail;
  }
  return tail;
}

}  // namespace

DiffuseLeap::DiffuseLeap(double extinction, double albedo, double anisotropy) {
  if (!(extinction > 0) || !(anisotropy > most_backward) || !(anisotropy < most_forward)) return;
  const double absorbed = 1 - albedo, reduced = 1 - albedo * anisotropy, simple = std::sqrt(3 * absorbed * reduced);
  if (!(simple <= slowest_decay * reduced)) return;
  double low = 0.5 * simple, high = simple;
  for (int step = 0; step < 60 && simple > 0; ++step) {
    const double middle = 0.5 * (low + high);
    (dispersion(middle, absorbed, albedo, anisotropy) > 0 ? low : high) = middle;
  }
  const double mean_free_path = std::max(1.0, 1 / reduced) / extinction;
  absorption_ = absorbed * extinction;
  reduced_scattering_ = albedo * (1 - anisotropy) * extinction;
  decay_ = 0.5 * (low + high) * extinction;
  margin_ = margin * mean_free_path;
  least_ = least_radius * mean_free_path;
}

// 1 − x/sinh x.
double DiffuseLeap::loss(double radius) const {
  const double x = decay_ * radius, square = x * x;
  if (x < 0.1) return square * (1.0 / 6 - square * (7.0 / 360 - square * 31.0 / 15120));
  return x > 700 ? 1 : 1 - x / std::sinh(x);
}

// In proportion to r sinh(κ(R − r)): of white matter r (R − r), from which others are kept with the ratio's share.
double DiffuseLeap::place(double radius, PathRandom& random) const {
  const double x = decay_ * radius;
  for (;;) {
    // The middle one of three numbers is distributed as u (1 − u).
    double a = random.next(), b = random.next(), c = random.next();
    const double u = std::max(std::min(a, b), std::min(std::max(a, b), c));
    if (x < 1e-6) return radius * u;
    const double kept = u < 1 ? std::sinh(x * (1 - u)) / ((1 - u) * std::sinh(x)) : 0;
    if (random.next() < kept) return radius * u;
  }
}

}  // namespace shellgrid
