// SPDX-License-Identifier: AGPL-3.0-or-later
// Where diffusion may be used: the error of its exitance against transport, as measured.
#pragma once
#include <string>
#include <vector>

#include "meshing/polycube/polygrid.h"
#include "solvers/diffusion/cell_coefficients.h"

namespace shellgrid {

// What the error hangs on, by channel.
struct DiffusionRegime {
  Rgb reduced_albedo = Rgb::Ones();  // σ_s'/σ_t'
  Rgb thickness = Rgb::Zero();       // the object's mean chord 4 V/A in reduced mean free paths 1/σ_t'
};

// Of a solved object: σ_t' is averaged over the volume, the albedo is 1 − ∫σ_a φ/∫σ_t' φ: that of the matter which
// the light meets. `fluence`: one a point of the polygrid.
DiffusionRegime diffusion_regime(const Polygrid& polygrid, const CellCoefficients& coefficients,
                                 const std::vector<Rgb>& fluence);

// Relative error of the exitance (L2 over the surface) that diffusion on a fine grid is expected to have: interpolated
// in the logarithms of thickness, 1 − albedo and error between the worst of sphere, plate and bunny under parallel
// light from the side, index 1.5, creases left out, as tests/accuracy/diffusion_map.py measured them. Beyond the map's
// ends it is that of the end. `first_collision`: of that source, else of boundary.
Rgb expected_diffusion_error(const DiffusionRegime& regime, bool first_collision);

// Errors that are expected to exceed this are warned of.
inline constexpr double tolerable_diffusion_error = 0.1;

// What to tell of a regime in one line: the worst channel's error and what causes it, what the other source would
// make of it where that helps, and sg-reference. Empty where every channel's error is tolerable. Channels that are not
// `lit` do not count.
std::string diffusion_warning(const DiffusionRegime& regime, bool first_collision, const Eigen::Array<bool, 3, 1>& lit);

}  // namespace shellgrid
