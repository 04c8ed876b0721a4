// SPDX-License-Identifier: AGPL-3.0-or-later
// The diffusion equation on any elements as three sparse linear systems, red, green and blue side by side.
#pragma once
#include <cstdint>
#include <vector>

#include "solvers/diffusion/channel_lanes.h"

namespace shellgrid {

// A symmetric operator in the form that keeps constants exactly:
//   (A x)_i = reaction_i x_i + Σ_j coupling_ij (x_i − x_j).
// Energy is then conserved to rounding although the couplings are single precision.
struct CouplingOperator {
  std::vector<std::int64_t> row_start;  // n + 1
  std::vector<std::int32_t> column;     // j of each coupling; never i itself
  std::vector<Float4> coupling;         // −A_ij, mm² times mm⁻¹
  std::vector<Double4> reaction;        // n: absorption and what leaves at the surface, ≥ 0

  std::size_t size() const { return reaction.size(); }
  // result = A x. Vectors hold one entry an unknown.
  void apply(const std::vector<Double4>& x, std::vector<Double4>& result) const;
};

// A discretisation of D1 and D2 with lumped absorption and surface terms.
struct DiffusionSystem {
  CouplingOperator matrix;
  std::vector<Double4> absorption;    // n: ∫ σ_a h_i dV, mm²
  std::vector<double> boundary_area;  // n: ∫ h_i dA over the surface, mm²; 0 off it
  double boundary_factor = 1;         // C
  double current_reflectance = 0;     // R_j
  double surface_area = 0;            // mm²
  double volume = 0;                  // mm³
};

// To the matrix's reaction, which it sets: what is absorbed, and what leaves at the surface. Source: PHYSICS D2.
void set_reaction(DiffusionSystem& system);

// Right-hand side for irradiance q (W mm⁻², one an unknown; read at outer points): 2 q / (1 + R_j) per area.
std::vector<Double4> boundary_source(const DiffusionSystem& system, const std::vector<Double4>& irradiance);

// M = q − D ∂φ/∂n of D3 with D2 for the normal derivative, at outer points; 0 elsewhere.
std::vector<Double4> boundary_exitance(const DiffusionSystem& system, const std::vector<Double4>& fluence,
                                       const std::vector<Double4>& irradiance);

// The terms of D4, W per channel.
struct EnergyBalance {
  Double4 entering = {}, leaving = {}, absorbed = {};
  Double4 relative_defect = {};  // |entering − leaving − absorbed| / entering; 0 where nothing enters
};
EnergyBalance energy_balance(const DiffusionSystem& system, const std::vector<Double4>& fluence,
                             const std::vector<Double4>& irradiance);

}  // namespace shellgrid
