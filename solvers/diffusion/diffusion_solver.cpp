// SPDX-License-Identifier: AGPL-3.0-or-later
#include "solvers/diffusion/diffusion_solver.h"

#include <algorithm>
#include <cmath>
#include <limits>

#include "meshing/core/error.h"
#include "meshing/core/parallel.h"
#include "solvers/scattering/fresnel.h"

namespace shellgrid {
namespace {

// The thin layer's mean thickness in cells.
double mean_layer_share(const Polygrid& polygrid) {
  double sum = 0;
  std::size_t count = 0;
  for (std::size_t p = 0; p < polygrid.outer_twin.size(); ++p)
    if (polygrid.outer_twin[p] >= 0) {
      sum += (polygrid.points.row(static_cast<Eigen::Index>(p)) - polygrid.points.row(polygrid.outer_twin[p])).norm();
      ++count;
    }
  return count > 0 && polygrid.spacing > 0 ? sum / (static_cast<double>(count) * polygrid.spacing) : 0;
}

}  // namespace

double extinction_contrast(const CellCoefficients& coefficients) {
  struct Range {
    Rgb least = Rgb::Constant(std::numeric_limits<float>::infinity()), greatest = Rgb::Zero();
    Range operator+(const Range& o) const { return {least.min(o.least), greatest.max(o.greatest)}; }
  };
  const std::vector<Rgb>& values = coefficients.reduced_extinction;
  const std::size_t chunk = 4096;
  const Range range = parallel_sum((values.size() + chunk - 1) / chunk, Range{},
                                   [&](std::size_t k) {
                                     Range own;
                                     for (std::size_t i = k * chunk; i < std::min(values.size(), (k + 1) * chunk); ++i)
                                       own = own + Range{values[i], values[i]};
                                     return own;
                                   },
                                   1);
  return (range.greatest / range.least).maxCoeff();
}

DiffusionSolver::DiffusionSolver(const Polygrid& polygrid, const SolverParameters& parameters)
    : parameters_(parameters), polygrid_(polygrid) {
  check_polygrid(polygrid);
  hierarchy_ = build_levels(polygrid, parameters.coarsest_size, parameters.depth);
  layer_share_ = mean_layer_share(polygrid);
  for (const RunLevel& level : levels_) {
    lights_.emplace_back();
    lights_.back().outer.resize(level.surface.size());
  }
}

void DiffusionSolver::set_material(const CellCoefficients& coefficients, double ior, double least_tolerance) {
  const DiffuseFresnel fresnel = diffuse_fresnel(ior);
  boundary_factor_ = fresnel.boundary_factor;
  current_reflectance_ = fresnel.current_reflectance;
  AssemblyOptions options;
  options.boundary_factor = boundary_factor_;
  options.keep_single = least_tolerance < parameters_.exact_below;
  contrast_ = extinction_contrast(coefficients);
  options.box_transfer = contrast_ > parameters_.rough_contrast && hierarchy_.skipped == 0;
  terms_ = assemble_levels(polygrid_, coefficients, options, hierarchy_);
  patches_.assign(levels_.size(), {});
  for (std::size_t l = 0; l + 1 < levels_.size(); ++l)
    if (options.box_transfer)
      patches_[l].prepare(levels_[l], rough_patches);
    else if (l == 0 && contrast_ <= parameters_.rough_contrast)
      patches_[l].prepare(levels_[l], {});
  prepare_coarsest();
  has_material_ = true;
  light_is_known_ = false;
}

std::vector<std::size_t> DiffusionSolver::level_sizes() const {
  std::vector<std::size_t> sizes;
  for (const RunLevel& level : levels_) sizes.push_back(level.size());
  return sizes;
}

void DiffusionSolver::prepare_coarsest() {
  const RunLevel& level = levels_.back();
  const std::size_t inner = level.inner_size(), n = level.size();
  direct_ = n <= 4 * parameters_.coarsest_size;
  if (!direct_) return;
  std::array<Eigen::MatrixXd, 3> dense;
  for (auto& matrix : dense) matrix.resize(n, n);
  LevelVector<double> unit(inner, n - inner), column(inner, n - inner);
  for (std::size_t j = 0; j < n; ++j) {
    const auto set = [&](double value) {
      for (int c = 0; c < 3; ++c) (j < inner ? unit.inner[c][j] : unit.outer[j - inner][c]) = value;
    };
    set(1);
    apply_level(level, unit, column);
    set(0);
    for (int c = 0; c < 3; ++c)
      for (std::size_t i = 0; i < n; ++i) dense[c](i, j) = i < inner ? column.inner[c][i] : column.outer[i - inner][c];
  }
  parallel_for(
      3,
      [&](std::size_t c) {
        Eigen::MatrixXd symmetric = 0.5 * (dense[c] + dense[c].transpose());
        // Coarse outer points off the surface's plane may repeat each other: a trace of a shift keeps them apart.
        const double shift = 1e-9 * symmetric.diagonal().maxCoeff();
        for (std::size_t i = 0; i < n; ++i) symmetric(i, i) += 1e-7 * symmetric(i, i) + shift;
        coarsest_[c].compute(symmetric);
      },
      1);
  for (const auto& factors : coarsest_)
    if (factors.info() != Eigen::Success || !factors.vectorD().allFinite() || !(factors.vectorD().minCoeff() > 0))
      throw NumericalError("diffusion: the system is not positive definite");
}

void DiffusionSolver::solve_coarsest() {
  RunLevel& level = levels_.back();
  const std::size_t inner = level.inner_size(), n = level.size();
  for (int c = 0; c < 3; ++c) {
    Eigen::VectorXd b(n);
    for (std::size_t i = 0; i < n; ++i)
      b[i] = i < inner ? level.right_side.inner[c][i] : level.right_side.outer[i - inner][c];
    const Eigen::VectorXd x = coarsest_[c].solve(b);
    for (std::size_t i = 0; i < inner; ++i) level.x.inner[c][i] = static_cast<float>(x[i]);
    for (std::size_t i = inner; i < n; ++i) level.x.outer[i - inner][c] = static_cast<float>(x[i]);
  }
}

// Chebyshev's polynomials of the fourth kind, which need an upper bound of the spectrum only.
// Source: [Lottes2022 alg. 3.1].
void DiffusionSolver::smooth(std::size_t index, int degree, bool inner_light, bool from_zero) {
  RunLevel& level = levels_[index];
  const auto bound = static_cast<float>(parameters_.spectral_bound);
  for (int k = 1; k <= degree; ++k) {
    const SmoothingStep step{k > 1 ? static_cast<float>(2 * k - 3) / static_cast<float>(2 * k + 1) : 0.0f,
                             static_cast<float>(8 * k - 4) / static_cast<float>(2 * k + 1) / bound};
    if (from_zero && k == 1)
      smooth_from_zero(level, step.take, inner_light);
    else
      smooth_level(level, step, inner_light);
  }
}

void DiffusionSolver::cycle(std::size_t index, bool inner_light, bool from_zero, Smoothing smoothing) {
  if (index + 1 == levels_.size()) {
    if (direct_) {
      solve_coarsest();
    } else {
      const int degree = parameters_.smoothing_degree;
      smooth(index, degree, inner_light, from_zero);
      for (int sweep = 0; sweep < 20; ++sweep) smooth(index, degree, inner_light, false);
    }
    return;
  }
  smooth(index, smoothing.before, inner_light, from_zero);
  // Conjugate gradients want symmetry; the cycle that starts from a solution does without.
  if (index > 0 || from_zero) patches_[index].apply(levels_[index], inner_light, true);
  restrict_residual(levels_[index], levels_[index + 1], inner_light);
  add_deep_residual(index + 1, inner_light_);
  cycle(index + 1, true, true, smoothing);
  // Where the transfer follows jumps a coarse level leaves more, and its second visit costs a sixth of the cycle.
  if (levels_[index].transfer.weights && index + 2 < levels_.size()) cycle(index + 1, true, false, smoothing);
  prolong_vector(levels_[index], levels_[index + 1].x, levels_[index].x, true);
  patches_[index].apply(levels_[index], inner_light, false);
  smooth(index, smoothing.after, inner_light, false);
}

void DiffusionSolver::set_light(const DiffusionLight& light) {
  RunLevel& finest = levels_.front();
  const std::size_t outer = finest.surface.size(), inner = finest.inner_size();
  if (light.irradiance.size() != outer) throw InternalError("diffusion: the light does not belong to the grid");
  inner_light_ = light.source.has_value();
  std::vector<Double4> source(outer);
  Double4 size = {};
  for (std::size_t s = 0; s < outer; ++s) {
    source[s] = inner_light_
                    ? to_double(light.source->outer[s])
                    : to_double(light.irradiance[s]) * (2 * terms_.area[s] / (1 + current_reflectance_));  // PHYSICS D2
    for (int c = 0; c < 3; ++c) size[c] = std::max(size[c], std::abs(source[s][c]));
    for (int c = 0; c < 3; ++c)
      if (!std::isfinite(source[s][c])) throw NumericalError("diffusion: the light is not finite");
  }
  if (inner_light_)
    for (int c = 0; c < 3; ++c)
      for (std::size_t u = 0; u < inner; ++u) {
        const float value = light.source->inner[c][u];
        if (!std::isfinite(value)) throw NumericalError("diffusion: the light is not finite");
        size[c] = std::max<double>(size[c], std::abs(value));
      }
  for (std::size_t l = 0; l < levels_.size() && inner_light_; ++l)
    for (int c = 0; c < 3; ++c)
      for (std::size_t u = 0; u < hierarchy_.deep[l].unknown.size(); ++u) {
        const float value = light.deep_source[l][c][u];
        if (!std::isfinite(value)) throw NumericalError("diffusion: the light is not finite");
        size[c] = std::max<double>(size[c], std::abs(value));
      }
  scale_ = size;
  const Double4 inverse = safe_quotient(Double4{1, 1, 1, 0}, size);
  for (std::size_t s = 0; s < outer; ++s) lights_[0].outer[s] = to_float(source[s] * inverse);
  if (inner_light_) {
    for (std::size_t l = 0; l < levels_.size(); ++l)
      if (lights_[l].inner.bytes() == 0) lights_[l].inner = ChannelPlanes<float>(levels_[l].inner_size());
    for (int c = 0; c < 3; ++c)
      for (std::size_t u = 0; u < inner; ++u)
        lights_[0].inner[c][u] = static_cast<float>(light.source->inner[c][u] * inverse[c]);
    for (std::size_t l = 0; l < levels_.size(); ++l) {
      DeepPart& deep = hierarchy_.deep[l];
      for (int c = 0; c < 3 && !deep.empty(); ++c)
        for (std::size_t u = 0; u < deep.unknown.size(); ++u)
          deep.part.right_side.inner[c][u] = static_cast<float>(light.deep_source[l][c][u] * inverse[c]);
    }
  }
}

void DiffusionSolver::full_multigrid(bool correct_finest) {
  error_left_ = 0.2;
  second_change_ = Double4{};
  for (std::size_t l = 0; l + 1 < levels_.size(); ++l)
    if (inner_light_) {
      restrict_vector(levels_[l], lights_[l], levels_[l + 1].layout, lights_[l + 1]);
      const DeepPart& deep = hierarchy_.deep[l + 1];
      for (int c = 0; c < 3 && !deep.empty(); ++c)
        for (std::size_t u = 0; u < deep.unknown.size(); ++u)
          lights_[l + 1].inner[c][deep.unknown[u]] += deep.part.right_side.inner[c][u];
    } else
      restrict_outer_vector(levels_[l], lights_[l].outer, lights_[l + 1].outer);
  for (std::size_t l = levels_.size(); l-- > 0;) {
    RunLevel& level = levels_[l];
    const bool coarsest = l + 1 == levels_.size();
    if (!coarsest) {
      keep_deep_solution(l + 1, false);
      prolong_vector(level, levels_[l + 1].x, level.x, false);
    }
    load_light(l, coarsest);
    if (l == 0) first_outer_ = level.x.outer;
    if (l == 0 && !correct_finest && !coarsest) {
      smooth(0, parameters_.smoothing_degree, inner_light_, false);
      return;
    }
    const std::vector<Float4> start = level.x.outer;
    cycle(l, inner_light_ || coarsest, coarsest,
          {l == 0 ? parameters_.first_degree : parameters_.smoothing_degree,
           l == 0 ? parameters_.last_degree : parameters_.smoothing_degree});
    for (std::size_t k = l + 1; k < levels_.size(); ++k) keep_deep_solution(k, true);
    if (l == 0 || coarsest) continue;
    // A second cycle costs little on coarse levels. What it changes tells what the first left.
    const std::vector<Float4> once = level.x.outer;
    load_light(l, false);
    cycle(l, inner_light_, false, {parameters_.smoothing_degree, parameters_.smoothing_degree});
    for (std::size_t k = l + 1; k < levels_.size(); ++k) keep_deep_solution(k, true);
    if (l > 1) continue;
    const Double4 first_change = surface_change(level, start, once);
    second_change_ = surface_change(level, once, level.x.outer);
    const Double4 left = safe_quotient(second_change_, first_change);
    error_left_ = std::sqrt(std::max({left[0], left[1], left[2]}));
  }
}

// Σ a (x − y)² over a level's outer points, a what leaves there.
Double4 DiffusionSolver::surface_change(const RunLevel& level, const std::vector<Float4>& x,
                                        const std::vector<Float4>& y) {
  Double4 sum = {};
  for (std::size_t s = 0; s < x.size(); ++s) {
    const Float4 change = y[s] - x[s];
    sum += to_double(level.reaction.outer[s] * change * change);
  }
  return sum;
}

// The level's own light as its right-hand side. `whole`: also where there is none inside.
void DiffusionSolver::load_light(std::size_t index, bool whole) {
  RunLevel& level = levels_[index];
  level.right_side.outer = lights_[index].outer;
  for (int c = 0; c < 3; ++c) {
    float* to = level.right_side.inner[c];
    if (inner_light_)
      std::copy(lights_[index].inner[c], lights_[index].inner[c] + level.inner_size(), to);
    else if (whole)
      std::fill(to, to + level.inner_size(), 0.0f);
  }
}

// Relative L2 change of the exitance over the surface, the greatest of the channels, from what `surface_change` says.
double DiffusionSolver::relative_change(const Double4& surface_change) const {
  const RunLevel& finest = levels_.front();
  Double4 size = {};
  const double half_inverse_factor = 1 / (2 * boundary_factor_);
  // D3 with D2: the irradiance's part, from the light as it stands in the right-hand side.
  const double reflected = inner_light_ ? 0 : 0.5 * (1 - current_reflectance_);
  for (std::size_t s = 0; s < terms_.area.size(); ++s) {
    const double area = terms_.area[s];
    if (!(area > 0)) continue;
    const Double4 exitance =
        half_inverse_factor * to_double(finest.x.outer[s]) - (reflected / area) * to_double(lights_[0].outer[s]);
    size += area * exitance * exitance;
  }
  double worst = 0;
  for (int c = 0; c < 3; ++c) {
    const double change = half_inverse_factor * surface_change[c];
    if (!std::isfinite(change) || !std::isfinite(size[c])) return std::nan("");
    if (change > 0) worst = std::max(worst, size[c] > 0 ? std::sqrt(change / size[c]) : 1.0);
  }
  return worst;
}

// The same since `before`.
double DiffusionSolver::exitance_change(const std::vector<Float4>& before) const {
  return relative_change(surface_change(levels_.front(), before, levels_.front().x.outer));
}

SolveReport DiffusionSolver::solve(const DiffusionLight& light, double tolerance, bool warm) {
  if (!has_material_) throw InternalError("diffusion: solved before a material was set");
  SolveReport report;
  report.tolerance = tolerance;
  report.unknowns = size();
  report.skipped = hierarchy_.skipped;
  report.level_sizes = level_sizes();
  bool start = warm && has_solution_ && levels_.size() > 1;
  if (start) {
    start_warm(light);
    start = !started_far_off();
  }
  if (!start) set_light(light);
  bool dark = true;
  for (int c = 0; c < 3; ++c) dark = dark && scale_[c] == 0;
  if (dark) {
    for (int c = 0; c < 3; ++c) {
      float* x = levels_.front().x.inner[c];
      std::fill(x, x + levels_.front().inner_size(), 0.0f);
    }
    std::fill(levels_.front().x.outer.begin(), levels_.front().x.outer.end(), Float4{});
    solution_is_exact_ = false;
    shift_ = Double4{};
    report.error_history = {0};
    has_solution_ = light_is_known_ = true;
    return report;
  }
  has_solution_ = false;
  if (!start) full_multigrid(true);
  report.cycles = 1;
  double change = exitance_change(first_outer_);
  const auto left_of = [](double ratio, double least) {
    return ratio < 0.45 ? std::max(least, 2 * ratio / (1 - 2 * ratio)) : 10.0;
  };
  // Of the error in waves of a few cells, most of `change`, a cycle leaves little. Of longer waves there is about as
  // much as a cycle left on the next coarser level. Measured over shapes, materials and lights: 1.5 to 4.5 times the
  // true error in nine of ten cases.
  report.estimated_error =
      std::hypot((error_left_ < 0.45 ? 0.025 : 10.0) * change, 2.2 * relative_change(second_change_));
  if (levels_.size() == 2) report.estimated_error = 0.15 * change;
  // Smoothing alone leaves more, and the old solution's error stays.
  if (start && warm_by_light_) report.estimated_error = std::hypot(0.2 * change, last_estimate_);
  if (levels_.size() == 1) report.estimated_error = 1e-6;  // solved directly, in single precision
  solution_is_exact_ = false;
  report.deep_error = hierarchy_.skipped > 0 ? deep_error() : 0;
  const bool composite = hierarchy_.skipped > 0;
  const double goal = tolerance - report.deep_error;
  report.error_history.push_back(report.estimated_error + report.deep_error);
  // In rough materials and under thick layers a few slow parts of the error hide behind what cycles change.
  const bool rough = contrast_ > parameters_.rough_contrast || layer_share_ > parameters_.thick_layer;
  if (rough) report.estimated_error = std::max(report.estimated_error, 1.01 * tolerance);
  while (report.estimated_error > goal && goal >= 0.3 * tolerance && !rough && std::isfinite(change) &&
         (composite ? report.cycles < parameters_.most_composite_cycles
                    : tolerance >= parameters_.exact_below && report.cycles < parameters_.most_cycles)) {
    first_outer_ = levels_.front().x.outer;
    cycle(0, inner_light_, false, {parameters_.smoothing_degree, parameters_.smoothing_degree});
    for (std::size_t k = 1; k < levels_.size(); ++k) keep_deep_solution(k, true);
    ++report.cycles;
    const double last = change;
    change = exitance_change(first_outer_);
    const double ratio = start && report.cycles == 2 ? 0.1 : change / last;
    report.estimated_error = change * left_of(ratio, 0.2);
    report.error_history.push_back(report.estimated_error + report.deep_error);
    if (ratio > 0.5) break;
  }
  if (!composite && !(report.estimated_error <= tolerance)) solve_by_conjugate_gradients(tolerance, report);
  conserve_energy(light);
  last_estimate_ = report.estimated_error;
  report.estimated_error += report.deep_error;
  has_solution_ = light_is_known_ = true;
  return report;
}

LevelVector<float> DiffusionSolver::to_level(const std::vector<Double4>& point_values) const {
  const RunLevel& finest = levels_.front();
  LevelVector<float> result(finest.inner_size(), finest.surface.size());
  for (std::size_t u = 0; u < finest.inner_size(); ++u)
    for (int c = 0; c < 3; ++c) result.inner[c][u] = static_cast<float>(point_values[finest.layout.point_of[u]][c]);
  for (std::size_t s = 0; s < result.outer.size(); ++s) result.outer[s] = to_float(point_values[fine_.outer_point[s]]);
  return result;
}

DiffusionLight DiffusionSolver::source_light(const std::vector<Double4>& point_values) const {
  DiffusionLight light;
  light.irradiance.assign(levels_.front().surface.size(), Float4{});
  light.source = to_level(point_values);
  light.deep_source = gather_deep(point_values);
  for (const Double4& value : point_values) light.source_total += value;
  return light;
}

std::vector<Float4> DiffusionSolver::to_outer(const std::vector<Rgb>& point_values) const {
  std::vector<Float4> result;
  result.reserve(fine_.outer_point.size());
  for (std::int32_t point : fine_.outer_point) result.push_back(to_lanes(point_values[point]));
  return result;
}

}  // namespace shellgrid
