// SPDX-License-Identifier: AGPL-3.0-or-later
#include "solvers/diffusion/diffusion_system.h"

#include <cmath>

#include "meshing/core/parallel.h"

namespace shellgrid {

void CouplingOperator::apply(const std::vector<Double4>& x, std::vector<Double4>& result) const {
  result.resize(size());
  parallel_for(
      size(),
      [&](std::size_t i) {
        const Double4 own = x[i];
        Double4 sum = reaction[i] * own;
        for (std::int64_t k = row_start[i]; k < row_start[i + 1]; ++k)
          sum += to_double(coupling[k]) * (own - x[column[k]]);
        result[i] = sum;
      },
      1024);
}

void set_reaction(DiffusionSystem& system) {
  system.matrix.reaction = system.absorption;
  for (std::size_t i = 0; i < system.boundary_area.size(); ++i)
    system.matrix.reaction[i] += system.boundary_area[i] / (2 * system.boundary_factor);
}

std::vector<Double4> boundary_source(const DiffusionSystem& system, const std::vector<Double4>& irradiance) {
  std::vector<Double4> source(system.boundary_area.size(), Double4{});
  for (std::size_t i = 0; i < source.size(); ++i)
    source[i] = irradiance[i] * (2 * system.boundary_area[i] / (1 + system.current_reflectance));  // PHYSICS D2
  return source;
}

std::vector<Double4> boundary_exitance(const DiffusionSystem& system, const std::vector<Double4>& fluence,
                                       const std::vector<Double4>& irradiance) {
  std::vector<Double4> exitance(fluence.size(), Double4{});
  const double reflected = (1 - system.current_reflectance) / (1 + system.current_reflectance);
  for (std::size_t i = 0; i < exitance.size(); ++i)
    if (system.boundary_area[i] > 0)
      exitance[i] = fluence[i] / (2 * system.boundary_factor) - reflected * irradiance[i];  // PHYSICS D3 with D2
  return exitance;
}

EnergyBalance energy_balance(const DiffusionSystem& system, const std::vector<Double4>& fluence,
                             const std::vector<Double4>& irradiance) {
  const std::vector<Double4> exitance = boundary_exitance(system, fluence, irradiance);
  EnergyBalance balance;
  for (std::size_t i = 0; i < fluence.size(); ++i) {
    balance.entering += system.boundary_area[i] * irradiance[i];
    balance.leaving += system.boundary_area[i] * exitance[i];
    balance.absorbed += system.absorption[i] * fluence[i];
  }
  balance.relative_defect = safe_quotient(balance.entering - balance.leaving - balance.absorbed, balance.entering);
  for (int c = 0; c < 4; ++c) balance.relative_defect[c] = std::abs(balance.relative_defect[c]);
  return balance;
}

}  // namespace shellgrid
