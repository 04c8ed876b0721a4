// SPDX-License-Identifier: AGPL-3.0-or-later
// The material as the diffusion solver sees it: eight samples a cell.
#pragma once
#include <cstdint>
#include <optional>
#include <vector>

#include "meshing/polycube/polygrid.h"
#include "meshing/shell/shell_volume.h"
#include "solvers/diffusion/core_extension.h"

namespace shellgrid {

// Coefficients at the eight Gauss points of each cell, in the order of the cell's corners.
struct CellCoefficients {
  std::vector<Rgb> absorption;          // 8·cells: σ_a, mm⁻¹
  std::vector<Rgb> reduced_extinction;  // 8·cells: σ_t', mm⁻¹, > 0
  std::int64_t from_shell = 0;          // samples that lie in the shell; the others are the core's
  std::int64_t floored = 0;             // samples whose σ_t' was raised to the floor (voids)
  std::optional<CoreExtension> core;    // where the shell asks for an interpolated core
};

// The same material everywhere. Throws: InputError where a coefficient is negative, not finite, or σ_t' is 0.
CellCoefficients homogeneous_coefficients(const Polygrid& polygrid, const Material& material);

// σ_a and σ_t' of the shell, interpolated trilinearly between the active samples about each Gauss point
// (free space counts as σ = 0), and of the core where none is active: homogeneous, or interpolated from the extension.
// σ_t' is at least 0.01/h: light crosses a void within the object freely. Throws: InputError as above.
CellCoefficients sample_coefficients(const Polygrid& polygrid, const ShellVolume& shell);

// The Gauss point of a cell nearest to its corner, mm.
Vec3 gauss_point(const Polygrid& polygrid, int cell_index, int corner);

}  // namespace shellgrid
