// SPDX-License-Identifier: AGPL-3.0-or-later
// The diffusion equation on a polygrid as three sparse linear systems, red, green and blue side by side.
#pragma once
#include <array>
#include <cstdint>
#include <vector>

#include "meshing/polycube/polygrid.h"
#include "solvers/diffusion/cell_coefficients.h"
#include "solvers/diffusion/diffusion_system.h"

namespace shellgrid {

// Where the unknowns of one level take their values from on the next coarser one: the polygrid's hierarchy, seen from
// the corners of its cells. Outer points have coarse points of their own above those that their twins take.
struct UnknownTransfer {
  std::vector<std::int64_t> start;               // fine unknowns + 1
  std::vector<std::int32_t> parent;              // coarse unknowns whose equal mean a fine one takes: 1, 2, 4 or 8
  std::vector<std::array<std::int32_t, 4>> key;  // of the coarse unknowns: place on their lattice, and 1 for outer ones
};

// Discretisation of D1 and D2 by trilinear elements.
struct PolygridSystem : DiffusionSystem {
  // Unknowns are the polygrid's points in the order of their lattice coordinates, an inner point before its twin.
  std::vector<std::int32_t> point_of_unknown, unknown_of_point;
  std::vector<std::array<std::int32_t, 4>> key;  // lattice x, y, z, and 0 for an inner point, 1 for an outer one
  std::vector<UnknownTransfer> transfers;        // finest first
};

// Throws InputError where an index is out of range, an array's length is wrong, or a cell is inverted or flat; returns
// the cells' volume, mm³.
double check_polygrid(const Polygrid& polygrid);

// ∫ h_a dA over a boundary quad for its four corners, mm²; 2×2 Gauss points.
std::array<double, 4> quad_areas(const Polygrid& polygrid, Eigen::Index quad);

// Assembles ∫ D ∇φ·∇v + ∫ σ_a φ v + ∫_A φ v / (2C) on trilinear elements. Source: PHYSICS D1, D2.
// Core cells take 2×2×2 Gauss points; thin boundary cells take their corners, which decouples the two
// faces' points but for the links, so that a layer of any thinness stays solvable; absorption and surface
// terms are lumped, so that strong absorption cannot make the fluence negative.
// `ior` ≥ 1. Throws: InputError for an inverted or flat cell, indices out of range, no boundary quads.
PolygridSystem assemble_polygrid_system(const Polygrid& polygrid, const CellCoefficients& coefficients, double ior);

}  // namespace shellgrid
