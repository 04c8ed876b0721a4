// SPDX-License-Identifier: AGPL-3.0-or-later
// Geometric multigrid on the polygrid's lattice, and conjugate gradients around it.
#pragma once
#include <Eigen/Cholesky>
#include <array>
#include <cstdint>
#include <string>
#include <vector>

#include "solvers/diffusion/diffusion_solver.h"
#include "solvers/diffusion/polygrid_system.h"

namespace shellgrid {

struct MultigridParameters {
  int smoothing_degree = 2;  // of the Chebyshev polynomial before and after each coarse correction
  // Upper end of the spectrum that the polynomial damps. The true one never exceeds 2 (see `Level`), where the
  // polynomial of degree 2 for the bound 1.6 has size 1: so the cycle stays positive definite.
  double spectral_bound = 1.6;
  std::size_t coarsest_size = 400;  // unknowns that are solved directly
};

// One V-cycle as an approximate inverse, three channels at once, in single precision.
//
// Its levels are the polygrid's hierarchy, seen from the corners of the cells: a fine unknown takes the trilinear mean
// of the corners of its cell's parent, so that parts that nearly touch share no coarse unknown. Outer points keep
// unknowns of their own, interpolated as their inner twins are. The coarse operators are the Galerkin products of the
// couplings; reactions are lumped.
class Multigrid {
 public:
  explicit Multigrid(const PolygridSystem& system, const MultigridParameters& parameters = {});
  Multigrid(const Multigrid&) = delete;
  Multigrid& operator=(const Multigrid&) = delete;

  // correction = B residual, B ≈ A⁻¹ symmetric.
  void apply(const std::vector<Double4>& residual, std::vector<Double4>& correction);

  int level_count() const { return static_cast<int>(levels_.size()); }
  std::vector<std::size_t> level_sizes() const;

 private:
  struct Operator {
    std::vector<std::int64_t> row_start;
    std::vector<std::int32_t> column;
    std::vector<Float4> coupling;
    std::vector<Float4> reaction;
  };
  struct Restriction {
    std::vector<std::int64_t> start;
    std::vector<std::int32_t> index;
    std::vector<float> weight;
  };
  // The smoother's block diagonal holds pairs (inner point, outer twin) and, on the diagonal, what a row's
  // couplings of the wrong sign exceed it by: then its spectrum ends at 2 whatever the cells' shapes and contrasts.
  struct Level {
    const Operator* matrix = nullptr;
    Operator own;  // of coarse levels
    std::vector<std::array<std::int32_t, 4>> key;
    std::vector<std::int32_t> partner;  // the twin's unknown, or the own one
    std::vector<Float4> inverse_own, inverse_partner;
    UnknownTransfer prolongation;  // from the next coarser level
    Restriction restriction;       // to it
    std::vector<Float4> x, right_side, residual, step;
  };

  static Operator single_precision(const CouplingOperator& matrix);
  void prepare_smoother(Level& level) const;
  // Appends the next coarser level.
  void coarsen(const UnknownTransfer& transfer);
  void prepare_coarsest();
  void smooth(Level& level, bool from_zero) const;
  void residual(Level& level) const;
  void cycle(std::size_t index);
  void solve_coarsest(Level& level) const;

  MultigridParameters parameters_;
  Operator finest_;
  std::vector<Level> levels_;
  std::array<Eigen::LDLT<Eigen::MatrixXd>, 3> coarsest_;
  bool direct_ = false;
};

// Solves A φ = source for the three channels by conjugate gradients around the V-cycle, until the exitance's
// estimated relative error is below `tolerance`. The estimate is the V-cycle of the residual, seen through D3. At the
// end a constant is added that makes D4 exact to rounding at any tolerance (it lowers the error in the energy norm
// too). `irradiance` is that of the source, used to know M. Starts at `fluence` where its size fits, else at 0. Throws:
// NumericalError with the residual's history where it does not converge within `most_iterations`, or meets a number
// that is not finite or a direction of negative energy.
SolveReport solve_conjugate_gradients(const PolygridSystem& system, Multigrid& multigrid,
                                      const std::vector<Double4>& source, const std::vector<Double4>& irradiance,
                                      double tolerance, int most_iterations, std::vector<Double4>& fluence);

}  // namespace shellgrid
