// SPDX-License-Identifier: AGPL-3.0-or-later
#pragma once
#include <array>

#include "meshing/core/vec.h"

namespace shellgrid {

struct LaplacianWeights {
  std::array<double, 6> weights;  // mm⁻²: Laplacian(f)(0) = Σ_j weights[j] (f_j − f_0)
  double condition;               // of the 6×6 matrix in the 1-norm, offsets in units of the spacing
  bool exact;                     // false: the matrix is singular; the weights are those of three orthogonal lines
};

// Weights of the Laplacian at a node from its six linked nodes, in the order −x +x −y +y −z +z. `offsets`
// (mm) are their places relative to the node, `spacing` (mm) the grid's. The local frame is the rotation
// nearest to the three lines through opposite nodes. Exact for quadratics without cross terms in that
// frame. Source: [Diffusion appendix B] eq. 10, 11.
LaplacianWeights laplacian_weights(const std::array<Vec3, 6>& offsets, double spacing);

}  // namespace shellgrid
