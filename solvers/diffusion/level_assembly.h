// SPDX-License-Identifier: AGPL-3.0-or-later
// The couplings of all multigrid levels, for one material.
#pragma once
#include <vector>

#include "solvers/diffusion/cell_coefficients.h"
#include "solvers/diffusion/diffusion_levels.h"

namespace shellgrid {

struct AssemblyOptions {
  double boundary_factor = 1;  // C of D2
  bool keep_single = false;    // couplings of the finest level in single precision as well
  bool box_transfer = false;   // prolongation follows the couplings
};

// What the finest level's outer points have of their own.
struct SurfaceTerms {
  std::vector<Float4> absorption;  // ∫ σ_a h dV
  std::vector<double> area;        // ∫ h dA over the boundary quads, mm²
  double total_area = 0;           // mm²
};

// Fills couplings, reactions and smoothers of all levels. Core cells take 2×2×2 Gauss points, 16 cells at a time; cells
// of the thin layer take their corners; absorption and surface terms are lumped (PHYSICS D1, D2). A coarse element is
// the Galerkin product of its children's: so is the coarse operator. A cell that stands for its children takes their
// coefficients' means at its own Gauss points.
// Throws: InputError where the coefficients do not belong to the polygrid's cells.
SurfaceTerms assemble_levels(const Polygrid& polygrid, const CellCoefficients& coefficients,
                             const AssemblyOptions& options, LevelHierarchy& hierarchy);

}  // namespace shellgrid
