// SPDX-License-Identifier: AGPL-3.0-or-later
// What the solver tells of its solution.
#include <cmath>

#include "meshing/core/parallel.h"
#include "solvers/diffusion/diffusion_solver.h"

namespace shellgrid {
namespace {

constexpr std::size_t grain = 4096;

}  // namespace

// The constant whose residual sums to nothing: D4 exactly.
void DiffusionSolver::conserve_energy(const DiffusionLight& light) {
  const RunLevel& finest = levels_.front();
  const std::size_t inner = finest.inner_size();
  // In the terms of `energy`: only the same numbers cancel.
  Double4 entering = light.source_total, loss = {}, reaction = {};
  for (std::size_t s = 0; s < finest.surface.size(); ++s) {
    if (!light.source) entering += to_double(light.irradiance[s]) * (2 * terms_.area[s] / (1 + current_reflectance_));
    const Double4 own = to_double(terms_.absorption[s]) + terms_.area[s] / (2 * boundary_factor_);
    loss += own * (solution_is_exact_ ? exact_.outer[s] : to_double(finest.x.outer[s]));
    reaction += own;
  }
  for (int c = 0; c < 3; ++c) {
    const float* absorption = finest.reaction.inner[c];
    const float* single = finest.x.inner[c];
    const double* exact = solution_is_exact_ ? exact_.inner[c] : nullptr;
    const auto sum = [&](const auto& value) {
      return parallel_sum(
          inner, 0.0, [&](std::size_t i) { return absorption[i] * value(i); }, grain);
    };
    loss[c] += exact ? sum([&](std::size_t i) { return exact[i]; })
                     : sum([&](std::size_t i) { return static_cast<double>(single[i]); });
    reaction[c] += sum([](std::size_t) { return 1.0; });
  }
  for (const DeepPart& deep : hierarchy_.deep)
    for (int c = 0; c < 3 && !deep.empty(); ++c) {
      const float* absorption = deep.part.reaction.inner[c];
      loss[c] += parallel_sum(deep.unknown.size(), 0.0, [&](std::size_t u) {
        return static_cast<double>(absorption[u]) * static_cast<double>(deep.part.x.inner[c][u]);
      });
      reaction[c] +=
          parallel_sum(deep.unknown.size(), 0.0, [&](std::size_t u) { return static_cast<double>(absorption[u]); });
    }
  const Double4 light_sum = safe_quotient(entering, scale_);
  shift_ = safe_quotient(light_sum - loss, reaction);
}

std::vector<Double4> DiffusionSolver::fluence() const {
  const RunLevel& finest = levels_.front();
  std::vector<Double4> result(static_cast<std::size_t>(polygrid_.points.rows()), Double4{});
  const auto value = [&](const auto& x) {
    parallel_for(
        finest.inner_size(),
        [&](std::size_t u) {
          result[finest.layout.point_of[u]] =
              scale_ * (Double4{static_cast<double>(x.inner[0][u]), static_cast<double>(x.inner[1][u]),
                                static_cast<double>(x.inner[2][u]), 0} +
                        shift_);
        },
        grain);
    for (std::size_t s = 0; s < finest.surface.size(); ++s)
      for (int c = 0; c < 3; ++c)
        result[fine_.outer_point[s]][c] = scale_[c] * (static_cast<double>(x.outer[s][c]) + shift_[c]);
  };
  if (solution_is_exact_)
    value(exact_);
  else
    value(finest.x);
  if (hierarchy_.skipped == 0) return result;
  std::vector<Double4> values, coarse;
  for (std::size_t l = levels_.size(); l-- > 0;) {
    const DeepPart& deep = hierarchy_.deep[l];
    const InterpolatedPoints& points = hierarchy_.interpolated[l];
    coarse = std::move(values);
    if (l > 0) values.assign(hierarchy_.points[l], Double4{});
    for (std::size_t u = 0; u < deep.unknown.size(); ++u)
      for (int c = 0; c < 3; ++c)
        values[deep.part.layout.point_of[u]][c] =
            scale_[c] * (static_cast<double>(deep.part.x.inner[c][u]) + shift_[c]);
    std::vector<Double4>& to = l > 0 ? values : result;
    for (std::size_t k = 0; k < points.point.size(); ++k) {
      Double4 sum = {};
      for (std::int64_t e = points.start[k]; e < points.start[k + 1]; ++e) sum += coarse[points.parent[e]];
      to[points.point[k]] = sum / static_cast<double>(points.start[k + 1] - points.start[k]);
    }
  }
  return result;
}

std::vector<Double4> DiffusionSolver::exitance(const DiffusionLight& light) const {
  const std::size_t n = levels_.front().surface.size();
  const double reflected = light.source ? 0 : (1 - current_reflectance_) / (1 + current_reflectance_);
  std::vector<Double4> result(n, Double4{});
  for (std::size_t s = 0; s < n; ++s) {
    if (!(terms_.area[s] > 0)) continue;
    const Double4 x = solution_is_exact_ ? exact_.outer[s] : to_double(levels_.front().x.outer[s]);
    result[s] = scale_ * (x + shift_) / (2 * boundary_factor_);  // PHYSICS D3 with D2
    if (!light.source) result[s] -= reflected * to_double(light.irradiance[s]);
  }
  return result;
}

EnergyBalance DiffusionSolver::energy(const DiffusionLight& light) const {
  const RunLevel& finest = levels_.front();
  const std::vector<Double4> exitances = exitance(light);
  EnergyBalance balance;
  const std::size_t inner = finest.inner_size();
  LevelVector<float> unused;
  for (std::size_t s = 0; s < exitances.size(); ++s) {
    const Double4 x = solution_is_exact_ ? exact_.outer[s] : to_double(finest.x.outer[s]);
    if (!light.source) balance.entering += terms_.area[s] * to_double(light.irradiance[s]);
    balance.leaving += terms_.area[s] * exitances[s];
    balance.absorbed += to_double(terms_.absorption[s]) * scale_ * (x + shift_);
  }
  for (int c = 0; c < 3; ++c) {
    const float* absorption = finest.reaction.inner[c];
    const float* single = finest.x.inner[c];
    const double* exact = solution_is_exact_ ? exact_.inner[c] : nullptr;
    balance.absorbed[c] +=
        scale_[c] * parallel_sum(
                        inner, 0.0,
                        [&](std::size_t i) { return absorption[i] * ((exact ? exact[i] : single[i]) + shift_[c]); },
                        4096);
  }
  for (const DeepPart& deep : hierarchy_.deep)
    for (int c = 0; c < 3 && !deep.empty(); ++c)
      balance.absorbed[c] += scale_[c] * parallel_sum(deep.unknown.size(), 0.0, [&](std::size_t u) {
                               return deep.part.reaction.inner[c][u] * (deep.part.x.inner[c][u] + shift_[c]);
                             });
  balance.relative_defect = safe_quotient(balance.entering - balance.leaving - balance.absorbed, balance.entering);
  for (int c = 0; c < 4; ++c) balance.relative_defect[c] = std::abs(balance.relative_defect[c]);
  return balance;
}

std::size_t DiffusionSolver::sweep_bytes() const {
  const RunLevel& l = levels_.front();
  const std::size_t n = l.inner_size();
  // Couplings, links, reaction and inverse read; three vectors read, one of them written.
  return (l.half ? l.half.bytes() : l.single.bytes()) + l.layout.links.size() * sizeof(RunLink) +
         n * 3 * (sizeof(float) + sizeof(UpperHalf)) + n * 3 * 3 * sizeof(float) + l.surface.size() * 12 * 16;
}

std::size_t DiffusionSolver::memory_bytes() const {
  std::size_t bytes = fine_.cell.size() * 4 + fine_.position.bytes();
  for (const PatchCorrection& patches : patches_) bytes += patches.bytes();
  for (const RunLevel& l : levels_) {
    bytes += l.half.bytes() + l.single.bytes() + l.layout.links.size() * sizeof(RunLink) + l.layout.size() * 8 +
             l.layout.unknown_of.size() * 4 + l.inverse.bytes() + l.halved.bytes() + l.surface.size() * 12 * 16 +
             l.cells.size() * 37 + l.cells.boundary.size() * 41 + l.transfer.parts.size() * 12;
    for (const LevelVector<float>* v : {&l.x, &l.before, &l.right_side, &l.reaction}) bytes += v->inner.bytes();
  }
  return bytes;
}

}  // namespace shellgrid
