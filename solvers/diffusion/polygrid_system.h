// SPDX-License-Identifier: AGPL-3.0-or-later
// The diffusion equation on a polygrid as three sparse linear systems, red, green and blue side by side.
#pragma once
#include <array>
#include <cstdint>
#include <vector>

#include "meshing/polycube/polygrid.h"
#include "solvers/diffusion/cell_coefficients.h"
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

// Where the unknowns of one level take their values from on the next coarser one: the polygrid's hierarchy, seen from
// the corners of its cells. Outer points have coarse points of their own above those that their twins take.
struct UnknownTransfer {
  std::vector<std::int64_t> start;               // fine unknowns + 1
  std::vector<std::int32_t> parent;              // coarse unknowns whose equal mean a fine one takes: 1, 2, 4 or 8
  std::vector<std::array<std::int32_t, 4>> key;  // of the coarse unknowns: place on their lattice, and 1 for outer ones
};

// Discretisation of D1 and D2 by trilinear elements.
struct PolygridSystem {
  CouplingOperator matrix;
  // Unknowns are the polygrid's points in the order of their lattice coordinates, an inner point before its twin.
  std::vector<std::int32_t> point_of_unknown, unknown_of_point;
  std::vector<std::array<std::int32_t, 4>> key;  // lattice x, y, z, and 0 for an inner point, 1 for an outer one
  std::vector<UnknownTransfer> transfers;        // finest first
  std::vector<Double4> absorption;               // n: ∫ σ_a h_i dV, mm²
  std::vector<double> boundary_area;             // n: ∫ h_i dA over the boundary quads, mm²; 0 off the surface
  double boundary_factor = 1;                    // C
  double current_reflectance = 0;                // R_j
  double surface_area = 0;                       // mm², of the boundary quads
  double volume = 0;                             // mm³, of the cells
};

// Throws InputError where an index is out of range, an array's length is wrong, or a cell is inverted or flat; returns
// the cells' volume, mm³.
double check_polygrid(const Polygrid& polygrid);

// Assembles ∫ D ∇φ·∇v + ∫ σ_a φ v + ∫_A φ v / (2C) on trilinear elements. Source: PHYSICS D1, D2.
// Core cells take 2×2×2 Gauss points; thin boundary cells take their corners, which decouples the two
// faces' points but for the links, so that a layer of any thinness stays solvable; absorption and surface
// terms are lumped, so that strong absorption cannot make the fluence negative.
// `ior` ≥ 1. Throws: InputError for an inverted or flat cell, indices out of range, no boundary quads.
PolygridSystem assemble_polygrid_system(const Polygrid& polygrid, const CellCoefficients& coefficients, double ior);

// Right-hand side for irradiance q (W mm⁻², one an unknown; read at outer points): 2 q / (1 + R_j) per area.
std::vector<Double4> boundary_source(const PolygridSystem& system, const std::vector<Double4>& irradiance);

// M = q − D ∂φ/∂n of D3 with D2 for the normal derivative, at outer points; 0 elsewhere.
std::vector<Double4> boundary_exitance(const PolygridSystem& system, const std::vector<Double4>& fluence,
                                       const std::vector<Double4>& irradiance);

// The terms of D4, W per channel.
struct EnergyBalance {
  Double4 entering = {}, leaving = {}, absorbed = {};
  Double4 relative_defect = {};  // |entering − leaving − absorbed| / entering; 0 where nothing enters
};
EnergyBalance energy_balance(const PolygridSystem& system, const std::vector<Double4>& fluence,
                             const std::vector<Double4>& irradiance);

}  // namespace shellgrid
