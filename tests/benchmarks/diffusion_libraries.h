// SPDX-License-Identifier: AGPL-3.0-or-later
// Other libraries' solvers on any discretisation of the diffusion equation.
#pragma once
#include <string>
#include <vector>

#include "solvers/diffusion/diffusion_system.h"
#include "tests/benchmarks/diffusion_measure.h"

namespace shellgrid::test {

// A discretisation with its light and its exact algebraic solution.
struct DiscreteProblem {
  // Where exitance is judged: it follows the fluence of one unknown.
  struct Outlet {
    std::int32_t unknown;
    double area;
    Double4 factor;    // ∂M/∂φ
    Double4 exitance;  // the exact one
  };
  std::string size, discretisation;
  CouplingOperator matrix;
  std::vector<Double4> source;
  std::vector<Double4> fluence;  // the exact one
  std::vector<Outlet> outlets;
  double assembly = 0;  // processor seconds that made the system
  // Of the exact exitance, and of that under a soft light, at the object's surface; 0: not known.
  double discretisation_error = 0, soft_error = 0;
};

struct Limits {
  double seconds = 20;                  // processor seconds that a method may take for a channel's iterations
  double bytes = 8e9;                   // that a factor may take
  double factor_seconds = 20;           // processor seconds that it may take
  std::size_t all_methods = 2'000'000;  // unknowns up to which every method is shown on every discretisation
  double triad = 1e10;                  // bytes a processor second
};

// The solutions for some right-hand sides by hypre: of the first, by which methods are judged, to a residual of 1e-8,
// of the others to 1e-5.
std::vector<std::vector<Double4>> solve_exactly(const CouplingOperator& matrix,
                                                const std::vector<std::vector<Double4>>& sources);

// Adds a row for each method and level: conjugate gradients with incomplete Cholesky and with Jacobi (Eigen),
// BoomerAMG with conjugate gradients (hypre), CHOLMOD; beyond `Limits::all_methods` unknowns on other discretisations
// than the polygrid's only what was quickest at the size before. Each channel stops at the iteration that brings its
// own error under the level.
void run_libraries(const DiscreteProblem& problem, const Limits& limits, Table& table);

}  // namespace shellgrid::test
