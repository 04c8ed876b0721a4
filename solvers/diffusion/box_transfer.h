// SPDX-License-Identifier: AGPL-3.0-or-later
// Prolongation that follows the couplings, for materials with jumps: a fine point takes from its coarse neighbours what
// its own row, summed over the directions in which it stands on the coarse lattice, would have it take.
// Source: [Dendy1982], [Dendy1986] (black-box multigrid). Deviates: an outer point and its twin take the same weights,
// from their rows' sum; weights below zero become zero; absorption counts where it takes more than half.
#pragma once
#include "solvers/diffusion/element_lanes.h"
#include "solvers/diffusion/run_level.h"

namespace shellgrid {

// Weights of 16 children's corners, by the parents' corners.
struct ParentWeights {
  Float16Lanes weight[3][8][8];  // channel, child's corner, parent's corner
};

// Fills transfer.weights from the level's couplings in single precision and its reaction.
void set_box_weights(RunLevel& level);

// Of `count` cells from `first`; other lanes get zeros.
void load_parent_weights(const RunLevel& level, std::int32_t first, int count, ParentWeights& weights);

// Couplings of the parents' corners that each child brings: Pᵀ K P; and in `absorption` the sums of its rows, which are
// not zero where weights do not add up to one.
void coarsen_elements(const ElementLanes& children, const ParentWeights& weights, ElementLanes& parents);

// parent += Pᵀ child P with the weights of core cell `cell`; `lost`: the sums of its rows.
void add_coarse_boundary(const BoundaryElement& child, const RunLevel& level, std::int32_t cell,
                         BoundaryElement& parent, std::array<Float4, 16>& lost);

}  // namespace shellgrid
