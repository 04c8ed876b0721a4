// SPDX-License-Identifier: AGPL-3.0-or-later
// Solutions that begin from an earlier one.
#include <algorithm>
#include <cmath>
#include <string>
#include <utility>

#include "meshing/core/error.h"
#include "meshing/core/parallel.h"
#include "solvers/diffusion/diffusion_solver.h"
#include "solvers/diffusion/level_vectors.h"

namespace shellgrid {

void DiffusionSolver::set_initial(const std::vector<Rgb>& fluence) {
  if (static_cast<Eigen::Index>(fluence.size()) != polygrid_.points.rows())
    throw InputError("initial fluence: it has " + std::to_string(fluence.size()) + " points, the polygrid " +
                     std::to_string(polygrid_.points.rows()));
  Rgb greatest = Rgb::Zero();
  for (const Rgb& value : fluence) {
    if (!value.isFinite().all()) throw InputError("initial fluence: a value is not finite");
    greatest = greatest.max(value.abs());
  }
  RunLevel& finest = levels_.front();
  for (int c = 0; c < 3; ++c) {
    scale_[c] = greatest[c];
    const float inverse = greatest[c] > 0 ? 1 / greatest[c] : 0;
    for (std::size_t u = 0; u < finest.inner_size(); ++u)
      finest.x.inner[c][u] = inverse * fluence[finest.layout.point_of[u]][c];
    for (std::size_t s = 0; s < finest.x.outer.size(); ++s)
      finest.x.outer[s][c] = inverse * fluence[fine_.outer_point[s]][c];
  }
  // A leaf's point takes the value of the polygrid's point at its place.
  std::vector<Double4> values(fluence.size()), finer;
  for (std::size_t p = 0; p < fluence.size(); ++p) values[p] = to_double(to_lanes(fluence[p]));
  for (std::size_t l = 0; l < levels_.size() && hierarchy_.skipped > 0; ++l) {
    DeepPart& deep = hierarchy_.deep[l];
    for (std::size_t u = 0; u < deep.unknown.size(); ++u)
      for (int c = 0; c < 3; ++c) {
        const double value = values[deep.part.layout.point_of[u]][c];
        deep.part.x.inner[c][u] = static_cast<float>(greatest[c] > 0 ? value / greatest[c] : 0);
      }
    const InterpolatedPoints& points = hierarchy_.interpolated[l];
    if (points.point.empty()) break;
    finer = std::move(values);
    values.assign(hierarchy_.points[l + 1], Double4{});
    for (std::size_t k = 0; k < hierarchy_.coincident[l].size(); ++k) {
      const auto& [point, parent] = hierarchy_.coincident[l][k];
      values[parent] = finer[point];
    }
  }
  shift_ = Double4{};
  solution_is_exact_ = light_is_known_ = false;
  has_solution_ = true;
}

// x ← previous x + what full multigrid makes of the light's change, or of the residual.
void DiffusionSolver::start_warm(const DiffusionLight& light) {
  RunLevel& finest = levels_.front();
  const std::size_t inner = finest.inner_size(), outer = finest.surface.size();
  const bool by_light = light_is_known_ && !inner_light_ && !light.source;
  warm_by_light_ = by_light;
  const std::vector<Float4> old_light = lights_[0].outer;
  const Double4 old_scale = scale_;
  if (previous_.inner.bytes() == 0) previous_ = LevelVector<float>(inner, outer);
  if (solution_is_exact_)
    for_entries(previous_, exact_, inner, [](float& to, double& from, int) { to = static_cast<float>(from); });
  else
    std::swap(previous_, finest.x);
  previous_deep_.resize(levels_.size());
  for (std::size_t l = 0; l < levels_.size(); ++l) {
    DeepPart& deep = hierarchy_.deep[l];
    if (deep.empty()) continue;
    if (previous_deep_[l].bytes() == 0) previous_deep_[l] = ChannelPlanes<float>(deep.unknown.size());
    std::swap(previous_deep_[l], deep.part.x.inner);
  }
  set_light(light);
  const Double4 factor = safe_quotient(old_scale, scale_);
  const std::vector<Float4> own_light = lights_[0].outer;
  const bool own_inner = inner_light_;
  if (by_light) {
    for (std::size_t s = 0; s < outer; ++s) lights_[0].outer[s] -= to_float(factor) * old_light[s];
    full_multigrid(false);
  } else {
    for (int c = 0; c < 3; ++c) {
      float* x = previous_.inner[c];
      const auto f = static_cast<float>(factor[c]);
      const auto shift = static_cast<float>(shift_[c]);
      parallel_for(
          inner, [&](std::size_t i) { x[i] = f * (x[i] + shift); }, level_grain);
    }
    for (Float4& x : previous_.outer) x = to_float(factor * (to_double(x) + shift_));
    for (std::size_t l = 0; l < levels_.size(); ++l) {
      DeepPart& deep = hierarchy_.deep[l];
      for (int c = 0; c < 3 && !deep.empty(); ++c)
        for (std::size_t u = 0; u < deep.unknown.size(); ++u) {
          float& x = previous_deep_[l][c][u];
          x = static_cast<float>(factor[c]) * (x + static_cast<float>(shift_[c]));
          deep.part.x.inner[c][u] = x;
        }
      if (deep.empty()) continue;
      apply_level(deep.part, deep.part.x, deep.part.before);
      for (int c = 0; c < 3; ++c)
        for (std::size_t u = 0; u < deep.unknown.size(); ++u)
          deep.part.right_side.inner[c][u] =
              (own_inner ? deep.part.right_side.inner[c][u] : 0.0f) - deep.part.before.inner[c][u];
    }
    apply_level(finest, previous_, finest.before);
    for (std::size_t l = 0; l < levels_.size(); ++l)
      if (lights_[l].inner.bytes() == 0) lights_[l].inner = ChannelPlanes<float>(levels_[l].inner_size());
    for (int c = 0; c < 3; ++c) {
      float* residual = lights_[0].inner[c];
      const float* image = finest.before.inner[c];
      parallel_for(
          inner, [&](std::size_t i) { residual[i] = (own_inner ? residual[i] : 0.0f) - image[i]; }, level_grain);
    }
    for (std::size_t s = 0; s < outer; ++s) lights_[0].outer[s] -= finest.before.outer[s];
    inner_light_ = true;
    full_multigrid(true);
    inner_light_ = own_inner;
    if (own_inner) set_light(light);
  }
  lights_[0].outer = own_light;
  warm_factor_ = by_light ? factor : Double4{1, 1, 1, 1};
  for (std::size_t s = 0; s < outer; ++s) {
    const Float4 change = finest.x.outer[s] - first_outer_[s];
    finest.x.outer[s] += (by_light ? to_float(factor) : Float4{1, 1, 1, 1}) * previous_.outer[s];
    first_outer_[s] = finest.x.outer[s] - change;
  }
  for (int c = 0; c < 3; ++c) {
    float* to = finest.x.inner[c];
    const float* from = previous_.inner[c];
    const float f = by_light ? static_cast<float>(factor[c]) : 1.0f;
    parallel_for(
        inner, [&](std::size_t i) { to[i] += f * from[i]; }, level_grain);
  }
  for (std::size_t l = 0; l < levels_.size(); ++l) {
    DeepPart& deep = hierarchy_.deep[l];
    for (int c = 0; c < 3 && !deep.empty(); ++c) {
      const float f = by_light ? static_cast<float>(factor[c]) : 1.0f;
      for (std::size_t u = 0; u < deep.unknown.size(); ++u) deep.part.x.inner[c][u] += f * previous_deep_[l][c][u];
    }
  }
  load_light(0, false);
}

// Whether the old solution dwarfs the new one: then what rounding and its own error left of it would, too.
bool DiffusionSolver::started_far_off() const {
  const RunLevel& finest = levels_.front();
  Double4 old_size = {}, new_size = {};
  for (std::size_t s = 0; s < finest.surface.size(); ++s) {
    const Double4 weight = to_double(finest.reaction.outer[s]), now = to_double(finest.x.outer[s]);
    const Double4 before = warm_factor_ * to_double(previous_.outer[s]);
    old_size += weight * before * before;
    new_size += weight * now * now;
  }
  for (int c = 0; c < 3; ++c)
    if (!(old_size[c] <= 100 * new_size[c])) return true;
  return false;
}

}  // namespace shellgrid
