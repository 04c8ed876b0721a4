// SPDX-License-Identifier: AGPL-3.0-or-later
// The discretisation of the 2008 paper, kept for comparison: six neighbours, Δ(κφ).
#pragma once
#include <Eigen/Core>
#include <functional>
#include <span>
#include <vector>

#include "meshing/polycube/polygrid.h"
#include "solvers/diffusion/cell_coefficients.h"

namespace shellgrid {

enum class PaperMethod {
  bicgstab,   // stabilised bi-conjugate gradients with incomplete LU
  relaxation  // the paper's own update
};

// Where a relaxation stands.
struct PaperPass {
  int level;                   // 0: the finest
  int channel;                 // 0, 1, 2
  int passes;                  // so far over this level's nodes
  double residual;             // relative, before the last pass; 1 before the first
  const Eigen::VectorXd& psi;  // n: κφ at the level's interior nodes
};

struct PaperProblem {
  std::vector<Rgb> diffusion, absorption;  // n: κ and μ at the graph's interior nodes
  std::vector<Rgb> boundary_diffusion;     // b: κ at its boundary nodes
  std::vector<Rgb> boundary_light;         // b: right-hand side of the boundary condition
  double boundary_factor = 1;              // C
  double tolerance = 1e-6;                 // residual over right-hand side
  int most_iterations = 20000;
  PaperMethod method = PaperMethod::bicgstab;
  // Of the finest level, the next coarser one, …: how many links below its boundary nodes are relaxed; deeper ones keep
  // what the coarser level gave them. 0, and levels beyond the list: all nodes are. The last of `levels` has no coarser
  // one and relaxes all. Source: [Diffusion §5.3, fig. 8], where they are set by hand, too.
  std::vector<int> depths;
  // Called before the first and after each pass of a relaxation, each channel from one thread at a time; where it
  // returns true the channel has done with this level.
  std::function<bool(const PaperPass&)> watch;
};

// The coefficients and the light of a polygrid's graph: means of each cell's samples of κ = D and μ = σ_a, and of the
// irradiance at the corners of each boundary quad (W mm⁻², one a point). The paper's light is the irradiance itself.
// Throws: InputError where the graph does not match the cells.
PaperProblem paper_problem(const Polygrid& polygrid, const CellCoefficients& coefficients,
                           const std::vector<Rgb>& irradiance);

struct PaperSolution {
  std::vector<Rgb> interior, boundary;   // φ
  int iterations = 0;                    // the most of the channels
  double residual = 0;                   // relative, the largest of the channels; of nodes that were relaxed
  std::vector<double> residual_history;  // of the largest, for relaxation; else first and last
  std::vector<int> coarse_iterations;    // of the levels that gave the start, coarsest first
  std::size_t relaxed = 0;               // nodes of the finest level that were not left to a coarser one
};

// Solves Σ_j w_ji (κ_j φ_j − κ_i φ_i) − μ_i φ_i = 0 with φ + 2 C κ (φ − φ_j) / d_ji = light at boundary nodes.
// Starts where the next coarser of `levels` ends, whose coefficients and light are the means of their children, each
// node taking its parent's fluence; at zero without levels, or where a level does not converge. Source: [Diffusion eq.
// 9; §5.3]. This is Δ(κφ), not D1: where κ varies it does not converge to D1's solution, and on sheared grids its
// weights are inconsistent. Throws: InputError where sizes disagree, the graph's indices are out of range, or depths
// are given without relaxation, NumericalError where it does not converge.
PaperSolution solve_paper_operator(const PolygridGraph& graph, const PaperProblem& problem,
                                   std::span<const PolygridLevel> levels = {});

}  // namespace shellgrid
