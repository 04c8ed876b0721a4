// SPDX-License-Identifier: AGPL-3.0-or-later
// The material below the shell, continued from the shell's bottom layer.
#pragma once
#include <vector>

#include "meshing/polycube/polygrid.h"
#include "meshing/shell/shell_volume.h"

namespace shellgrid {

// Coefficients at the polygrid's points below the shell and those of the cells that reach below it; 0 elsewhere.
struct CoreExtension {
  std::vector<Rgb> absorption, reduced_extinction;  // one a point, mm⁻¹
  std::size_t free_points = 0;                      // below the shell: solved for
  std::size_t boundary_points = 0;                  // in the shell: means of the deepest voxels about them
  int iterations = 0;
  double tolerance = 0;  // that was asked for
  double residual = 0;   // of the worst of the six fields, over the norm of its right-hand side
};

// Extends σ_a and σ_t' harmonically from the shell's deepest voxels (those within one voxel of its bottom, free space
// left out) to the points below the shell, along the edges of the cells with weights V/(4 l²) of each cell: positive
// ones, so that no value leaves the range of the boundary's, and a constant stays constant. Boundary points are points
// in the shell of a cell that reaches below it; each takes the mean of the deepest voxels about it, by weights
// that fall linearly to 0 at the spacing h (2h, 4h, … where there is none nearer). Solved by conjugate gradients to
// the relative residual `tolerance`. Without any deepest voxel the shell's homogeneous core stands everywhere.
// `in_shell`, `reaches_core`: of each point and cell. Throws: InputError for a coefficient that is not finite or
// negative, NumericalError where the iteration does not converge.
CoreExtension extend_core(const Polygrid& polygrid, const ShellVolume& shell, const std::vector<char>& in_shell,
                          const std::vector<char>& reaches_core, double tolerance = 1e-6);

}  // namespace shellgrid
