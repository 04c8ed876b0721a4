// SPDX-License-Identifier: AGPL-3.0-or-later
#pragma once
#include <array>
#include <cstdint>

#include "meshing/core/vec.h"
#include "meshing/polycube/polygrid_graph.h"

namespace shellgrid {

enum class WeightMethod : std::uint8_t {
  appendix_b = 0,     // the matrix of appendix B, inverted
  least_squares = 1,  // not negative, for a matrix that is ill-conditioned
  three_lines = 2     // of three orthogonal lines, where all linked nodes lie to one side
};

struct LaplacianWeights {
  std::array<double, 6> weights;  // mm⁻²: Laplacian(f)(0) = Σ_j weights[j] (f_j − f_0)
  double condition;               // of appendix B's matrix in the 1-norm, offsets in units of the spacing; at most 1e12
  WeightMethod method;
};

// Above this condition number least squares are the better weights. Measured on the polygrids of bunny, femur and dino:
// to 20 both err alike; from 20 to 50 least squares err less by a sixth, and two nodes of a hundred have a negative
// weight of appendix B; from 50 to 100 four of ten do, beyond 100 nine of ten, and its error grows with the condition
// number to tens of times that of least squares, which stays where it was.
inline constexpr double ill_conditioned = 50;

// Weights of the Laplacian at a node from its six linked nodes, in the order −x +x −y +y −z +z. `offsets`
// (mm) are their places relative to the node, `spacing` (mm) the grid's.
//
// Appendix B: exact for quadratics without cross terms in the local frame, the rotation nearest to the three lines
// through opposite nodes. Source: [Diffusion appendix B] eq. 10, 11.
//
// Where its condition number exceeds `condition_limit`: the weights w ≥ 0 that are exact for linear functions and have
// the least error for quadratics of unit second derivatives, ‖Σ_j w_j d_j d_jᵀ − 2 I‖ with Σ_j w_j d_j = 0; they need
// no frame, and no value can leave the range of its neighbours'.
LaplacianWeights laplacian_weights(const std::array<Vec3, 6>& offsets, double spacing,
                                   double condition_limit = ill_conditioned);

// The weights of all nodes of a graph, their condition numbers and methods.
void weigh_links(PolygridGraph& graph, double spacing, double condition_limit);

}  // namespace shellgrid
