// SPDX-License-Identifier: AGPL-3.0-or-later
// Conjugate gradients around the multigrid cycle.
// Source: [Hestenes1952]; in the form of Polak and Ribière.
#include <algorithm>
#include <cmath>
#include <cstdio>

#include "meshing/core/error.h"
#include "meshing/core/parallel.h"
#include "solvers/diffusion/diffusion_solver.h"
#include "solvers/diffusion/level_vectors.h"

namespace shellgrid {
namespace {

std::string number_text(double value) {
  char text[32];
  std::snprintf(text, sizeof text, "%g", value);
  return text;
}

std::string history_text(const std::vector<double>& history) {
  std::string text;
  char number[32];
  for (double r : history) {
    std::snprintf(number, sizeof number, " %.2e", r);
    text += number;
  }
  return text;
}

}  // namespace

void DiffusionSolver::apply_cycle(const LevelVector<double>& right_side, LevelVector<double>& x) {
  RunLevel& finest = levels_.front();
  const std::size_t inner = finest.inner_size();
  Double4 size = {};
  for (int c = 0; c < 3; ++c) {
    struct Size {
      double value = 0;
      Size operator+(const Size& other) const { return {std::max(value, other.value)}; }
    };
    const double* r = right_side.inner[c];
    size[c] = parallel_sum(
                  inner, Size{}, [&](std::size_t i) { return Size{std::abs(r[i])}; }, 4 * level_grain)
                  .value;
  }
  for (const Double4& r : right_side.outer)
    for (int c = 0; c < 3; ++c) size[c] = std::max(size[c], std::abs(r[c]));
  // Scaled to size one, so that tiny and huge residuals keep single precision's range.
  const Double4 inverse = safe_quotient(Double4{1, 1, 1, 0}, size);
  for_entries(finest.right_side, const_cast<LevelVector<double>&>(right_side), inner,
              [&](float& to, double& from, int c) { to = static_cast<float>(from * inverse[c]); });
  cycle(0, true, true, {parameters_.smoothing_degree, parameters_.smoothing_degree});
  for_entries(x, finest.x, inner, [&](double& to, float& from, int c) { to = from * size[c]; });
}

void DiffusionSolver::solve_by_conjugate_gradients(double tolerance, SolveReport& report) {
  RunLevel& finest = levels_.front();
  const std::size_t inner = finest.inner_size(), outer = finest.surface.size();
  auto fail = [&](const std::string& what) {
    throw NumericalError("diffusion: " + what + " after " + std::to_string(report.iterations) +
                         " iterations; relative residuals" + history_text(report.residual_history));
  };
  LevelVector<double> x(inner, outer), r(inner, outer), z(inner, outer), direction(inner, outer), image(inner, outer);
  bool finite = true;
  for_entries(x, finest.x, inner, [&](double& to, float& from, int) { to = from; });
  for (int c = 0; c < 3; ++c) finite = finite && std::isfinite(dot(x, x, inner)[c]);
  if (!finite)
    for_entries(x, finest.x, inner, [&](double& to, float& from, int) {
      to = 0;
      from = 0;
    });
  const LevelVector<float>& light = lights_[0];
  Double4 light_square = {};
  const auto true_residual = [&](LevelVector<double>& to) {
    apply_level(finest, x, to);
    for (std::size_t s = 0; s < outer; ++s) to.outer[s] = to_double(light.outer[s]) - to.outer[s];
    for (int c = 0; c < 3; ++c) {
      double* value = to.inner[c];
      const float* own = inner_light_ ? light.inner[c] : nullptr;
      parallel_for(
          inner, [&](std::size_t i) { value[i] = (own ? own[i] : 0.0f) - value[i]; }, level_grain);
    }
  };
  for (std::size_t s = 0; s < outer; ++s) light_square += to_double(light.outer[s]) * to_double(light.outer[s]);
  if (inner_light_)
    for (int c = 0; c < 3; ++c)
      for (std::size_t i = 0; i < inner; ++i)
        light_square[c] += static_cast<double>(light.inner[c][i]) * light.inner[c][i];
  true_residual(r);

  // The error left is about the next correction, of which D3 sees the surface's part.
  const double half_inverse_factor = 1 / (2 * boundary_factor_);
  const double reflected = inner_light_ ? 0 : 0.5 * (1 - current_reflectance_);
  auto estimate = [&]() {
    Double4 error = {}, size = {};
    for (std::size_t s = 0; s < outer; ++s) {
      const double area = terms_.area[s];
      if (!(area > 0)) continue;
      const Double4 exitance = half_inverse_factor * x.outer[s] - (reflected / area) * to_double(light.outer[s]);
      const Double4 e = 2 * half_inverse_factor * z.outer[s];
      error += area * e * e;
      size += area * exitance * exitance;
    }
    double worst = 0;
    for (int c = 0; c < 3; ++c)
      if (error[c] != 0) worst = std::max(worst, size[c] > 0 ? std::sqrt(error[c] / size[c]) : 1.0);
    return worst;
  };

  // Where corrections shrink slowly those to come add up; how fast, the first one does not tell.
  std::vector<double> corrections;
  const bool slow = contrast_ > parameters_.rough_contrast || layer_share_ > parameters_.thick_layer;
  const auto caution = [&]() {
    const std::size_t n = corrections.size();
    if (!slow) return 1.0;
    if (n < 2) return 2.0;
    const double back = corrections[n - std::min<std::size_t>(n, 3)];
    const double ratio = back > 0 ? std::pow(corrections[n - 1] / back, n < 3 ? 1.0 : 0.5) : 0.0;
    return 1 / (1 - std::clamp(ratio, 0.0, 0.8));
  };

  Double4 last_energy = {}, with_last = {};
  int restarts = 0;
  bool fresh = true;  // the next direction is the preconditioned residual itself
  LevelVector<double> last_r(inner, outer);
  for (;; ++report.iterations) {
    apply_cycle(r, z);
    const Double4 energy = dot(r, z, inner), square = dot(r, r, inner);
    double worst_residual = 0;
    for (int c = 0; c < 3; ++c) {
      if (light_square[c] > 0) worst_residual = std::max(worst_residual, std::sqrt(square[c] / light_square[c]));
      if (!std::isfinite(energy[c]) || !std::isfinite(square[c])) fail("a number that is not finite appeared");
    }
    report.residual_history.push_back(worst_residual);
    corrections.push_back(estimate());
    report.estimated_error = corrections.back() * caution();
    report.error_history.push_back(report.estimated_error);
    if (report.estimated_error <= tolerance) {
      // The updated residual drifts from the true one; only the true one counts.
      true_residual(image);
      const Double4 drift = sum_over(image, r, inner, [](double a, double b) { return (a - b) * (a - b); });
      bool settled = true;
      for (int c = 0; c < 3; ++c) settled = settled && drift[c] <= 0.01 * square[c];
      if (settled) break;
      if (++restarts > 5) fail("the tolerance " + number_text(tolerance) + " is below rounding");
      std::swap(r, image);
      report.residual_history.pop_back();
      report.error_history.pop_back();
      corrections.pop_back();
      fresh = true;
      --report.iterations;
      continue;
    }
    for (int c = 0; c < 3; ++c)
      if (energy[c] < 0) fail("the preconditioner is indefinite");
    if (report.iterations >= parameters_.most_iterations) fail("no convergence to " + number_text(tolerance));

    // Polak and Ribière's form forgives the single precision of the preconditioner.
    with_last = fresh ? Double4{} : dot(last_r, z, inner);
    const Double4 factor = fresh ? Double4{} : safe_quotient(energy - with_last, last_energy);
    for_entries(direction, z, inner, [&](double& d, double& from, int c) { d = from + factor[c] * d; });
    apply_level(finest, direction, image);
    const Double4 curvature = dot(direction, image, inner);
    for (int c = 0; c < 3; ++c)
      if (curvature[c] < 0 || !std::isfinite(curvature[c])) fail("the system is not positive definite");
    const Double4 length = safe_quotient(dot(direction, r, inner), curvature);
    for_entries(last_r, r, inner, [&](double& to, double& from, int) { to = from; });
    for_entries(x, direction, inner, [&](double& to, double& from, int c) { to += length[c] * from; });
    for_entries(r, image, inner, [&](double& to, double& from, int c) { to -= length[c] * from; });
    last_energy = energy;
    fresh = false;
  }
  exact_ = std::move(x);
  solution_is_exact_ = true;
}

}  // namespace shellgrid
