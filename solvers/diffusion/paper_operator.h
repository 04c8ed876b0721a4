// SPDX-License-Identifier: AGPL-3.0-or-later
// The discretisation of the 2008 paper, kept for comparison: six neighbours, Δ(κφ).
#pragma once
#include <span>
#include <vector>

#include "meshing/polycube/polygrid.h"

namespace shellgrid {

enum class PaperMethod {
  bicgstab,   // stabilised bi-conjugate gradients with incomplete LU
  relaxation  // the paper's own update
};

struct PaperProblem {
  std::vector<Rgb> diffusion, absorption;  // n: κ and μ at the graph's interior nodes
  std::vector<Rgb> boundary_diffusion;     // b: κ at its boundary nodes
  std::vector<Rgb> boundary_light;         // b: right-hand side of the boundary condition
  double boundary_factor = 1;              // C
  double tolerance = 1e-6;                 // residual over right-hand side
  int most_iterations = 20000;
  PaperMethod method = PaperMethod::bicgstab;
};

struct PaperSolution {
  std::vector<Rgb> interior, boundary;   // φ
  int iterations = 0;                    // the most of the channels
  double residual = 0;                   // relative, the largest of the channels
  std::vector<double> residual_history;  // of the largest, for relaxation; else first and last
  std::vector<int> coarse_iterations;    // of the levels that gave the start, coarsest first
};

// Solves Σ_j w_ji (κ_j φ_j − κ_i φ_i) − μ_i φ_i = 0 with φ + 2 C κ (φ − φ_j) / d_ji = light at boundary nodes.
// Starts where the next coarser of `levels` ends, whose coefficients and light are the means of their children, each
// node taking its parent's fluence; at zero without levels, or where a level does not converge. Source: [Diffusion eq.
// 9; §5.3]. This is Δ(κφ), not D1: where κ varies it does not converge to D1's solution, and on sheared grids its
// weights are inconsistent. Throws: InputError where sizes disagree or the graph's indices are out of range,
// NumericalError where it does not converge.
PaperSolution solve_paper_operator(const PolygridGraph& graph, const PaperProblem& problem,
                                   std::span<const PolygridLevel> levels = {});

}  // namespace shellgrid
