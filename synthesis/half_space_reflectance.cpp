// SPDX-License-Identifier: AGPL-3.0-or-later
#include "synthesis/half_space_reflectance.h"

#include <fmt/format.h>

#include <Eigen/Dense>
#include <cmath>
#include <numbers>

#include "meshing/core/error.h"
#include "meshing/core/parallel.h"
#include "synthesis/albedo.h"

namespace shellgrid {
namespace {

constexpr int nodes_per_part = 32;
constexpr int table_size = 257;

// Gauss–Legendre nodes and weights on (lower, upper), by Newton's method.
void add_gauss(double lower, double upper, std::vector<double>& nodes, std::vector<double>& weights) {
  constexpr int n = nodes_per_part;
  for (int i = 0; i < n; ++i) {
    double x = std::cos(std::numbers::pi * (i + 0.75) / (n + 0.5)), slope = 1;
    for (int step = 0; step < 60; ++step) {
      double before = 1, value = x;
      for (int k = 2; k <= n; ++k) {
        const double next = ((2 * k - 1) * x * value - (k - 1) * before) / k;
        before = value, value = next;
      }
      slope = n * (x * value - before) / (x * x - 1);
      const double move = value / slope;
      x -= move;
      if (std::abs(move) < 1e-15) break;
    }
    nodes.push_back(0.5 * (lower + upper) + 0.5 * (upper - lower) * x);
    weights.push_back((upper - lower) / ((1 - x * x) * slope * slope));
  }
}

// Of unpolarised light that meets the boundary from inside at this cosine.
double internal_fresnel(double cosine, double ior) {
  const double sine2 = ior * ior * (1 - cosine * cosine);
  if (sine2 >= 1) return 1;
  const double outside = std::sqrt(1 - sine2);
  const double parallel = (cosine - ior * outside) / (cosine + ior * outside);
  const double perpendicular = (ior * cosine - outside) / (ior * cosine + outside);
  return 0.5 * (parallel * parallel + perpendicular * perpendicular);
}

}  // namespace

double half_space_reflectance(double reduced_albedo, double ior) {
  if (!(reduced_albedo >= 0 && reduced_albedo <= 1) || !(ior >= 1 && ior <= 10))
    throw InputError(fmt::format("an albedo of {} or an index of {} is out of range; expected 0 to 1, and 1 to 10",
                                 reduced_albedo, ior));
  if (reduced_albedo == 1) return 1;
  // Cosines below and above the critical angle.
  std::vector<double> mu, weight;
  const double critical = std::sqrt(1 - 1 / (ior * ior));
  if (critical > 0) add_gauss(0, critical, mu, weight);
  add_gauss(critical, 1, mu, weight);
  const int n = static_cast<int>(mu.size());
  const double albedo = reduced_albedo;

  // 1/H(μ) = √(1 − α) + (α/2) ∫ μ' H(μ') / (μ + μ') dμ'. Source: [Chandrasekhar1960 §38]. The mean of two steps
  // converges fast even where nothing is absorbed.
  std::vector<double> h(n, 1.0);
  for (int step = 0; step < 10000; ++step) {
    double change = 0;
    std::vector<double> next(n);
    for (int i = 0; i < n; ++i) {
      double sum = 0;
      for (int j = 0; j < n; ++j) sum += weight[j] * mu[j] * h[j] / (mu[i] + mu[j]);
      next[i] = 0.5 * (h[i] + 1 / (std::sqrt(1 - albedo) + 0.5 * albedo * sum));
      change = std::max(change, std::abs(next[i] - h[i]) / h[i]);
    }
    h = next;
    if (change < 1e-11) break;
  }
  // Radiance up: U = K (B + R U), K_ij = (α/2) H_i H_j μ_j w_j / (μ_i + μ_j), B what enters, R the mirror inside.
  Eigen::MatrixXd system = Eigen::MatrixXd::Identity(n, n);
  Eigen::VectorXd right = Eigen::VectorXd::Zero(n);
  double entered = 0;
  std::vector<double> mirror(n);
  for (int j = 0; j < n; ++j) mirror[j] = internal_fresnel(mu[j], ior);
  for (int i = 0; i < n; ++i)
    for (int j = 0; j < n; ++j) {
      const double kernel = 0.5 * albedo * h[i] * h[j] * mu[j] * weight[j] / (mu[i] + mu[j]);
      system(i, j) -= kernel * mirror[j];
      right[i] += kernel * (1 - mirror[j]);
    }
  for (int j = 0; j < n; ++j) entered += weight[j] * mu[j] * (1 - mirror[j]);
  const Eigen::VectorXd up = system.partialPivLu().solve(right);
  double left = 0;
  for (int j = 0; j < n; ++j) left += weight[j] * mu[j] * (1 - mirror[j]) * up[j];
  return left / entered;
}

ReflectanceInversion::ReflectanceInversion(ReflectanceModel model, double ior) : model_(model), ior_(ior) {
  if (model == ReflectanceModel::dipole) return;
  reflectances_.resize(table_size);
  parallel_for(
      table_size,
      [&](std::size_t i) {
        const double s = static_cast<double>(i) / (table_size - 1);
        reflectances_[i] = half_space_reflectance(1 - s * s, ior);
      },
      1);
}

double ReflectanceInversion::reduced_albedo(double reflectance) const {
  if (model_ == ReflectanceModel::dipole) return reduced_albedo_of_reflectance(reflectance, ior_);
  if (reflectance >= 1) return 1;
  if (!(reflectance > 0)) return 0;
  // Falling values: the first not above.
  const auto after = std::lower_bound(reflectances_.begin(), reflectances_.end(), reflectance, std::greater<double>());
  const std::size_t i =
      std::clamp<std::size_t>(static_cast<std::size_t>(after - reflectances_.begin()), 1, table_size - 1);
  // A parabola through three neighbours for the place where this value lies.
  const std::size_t first = std::min<std::size_t>(i - 1, table_size - 3);
  double place = 0;
  for (std::size_t a = first; a < first + 3; ++a) {
    double term = static_cast<double>(a);
    for (std::size_t b = first; b < first + 3; ++b)
      if (b != a) term *= (reflectance - reflectances_[b]) / (reflectances_[a] - reflectances_[b]);
    place += term;
  }
  const double s = std::clamp(place / (table_size - 1), 0.0, 1.0);
  return 1 - s * s;
}

double ReflectanceInversion::reflectance(double reduced_albedo) const {
  if (model_ == ReflectanceModel::dipole) return diffuse_reflectance(reduced_albedo, ior_);
  const double place = std::sqrt(std::clamp(1 - reduced_albedo, 0.0, 1.0)) * (table_size - 1);
  const auto i = std::min<std::size_t>(static_cast<std::size_t>(place), table_size - 2);
  const double t = place - static_cast<double>(i);
  return (1 - t) * reflectances_[i] + t * reflectances_[i + 1];
}

Rgb ReflectanceInversion::color(const Material& material) const {
  const Rgb extinction = material.reduced_extinction(), scattering = material.reduced_scattering();
  Rgb color = Rgb::Zero();
  for (int c = 0; c < 3; ++c)
    if (extinction[c] > 0)
      color[c] =
          static_cast<float>(reflectance(static_cast<double>(scattering[c]) / static_cast<double>(extinction[c])));
  return color;
}

Rgb ReflectanceInversion::reduced_albedo(const Rgb& reflectance) const {
  Rgb albedo;
  for (int c = 0; c < 3; ++c) albedo[c] = static_cast<float>(reduced_albedo(static_cast<double>(reflectance[c])));
  return albedo;
}

}  // namespace shellgrid
