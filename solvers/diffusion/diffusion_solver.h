// SPDX-License-Identifier: AGPL-3.0-or-later
// Diffusion on a polygrid solved by full multigrid, and by conjugate gradients around it where more is asked.
#pragma once
#include <Eigen/Cholesky>
#include <array>
#include <optional>
#include <string>
#include <vector>

#include "solvers/diffusion/level_assembly.h"
#include "solvers/diffusion/patch_correction.h"
#include "solvers/diffusion/polygrid_system.h"

namespace shellgrid {

// Degrees of the smoothing polynomial before and after a coarse correction.
struct Smoothing {
  int before = 3, after = 3;
};

struct SolverParameters {
  int smoothing_degree = 3;  // of the polynomial before and after each coarse correction
  // Upper end of the spectrum that the polynomial damps. The true one never exceeds 2, where cells are flat, and there
  // the polynomials up to degree 4 for this bound stay below one: so the cycle is positive definite.
  double spectral_bound = 1.9;
  int first_degree = 2;             // before full multigrid's finest correction: its start is smooth already
  int last_degree = 4;              // after it
  std::size_t coarsest_size = 400;  // unknowns that are solved directly
  double exact_below = 1e-3;        // tolerances below it take couplings in single and iterates in double precision
  double rough_contrast = 50;       // of σ_t' over the object, beyond which conjugate gradients take over at once
  double thick_layer = 0.2;         // mean thickness of the thin layer, in cells, beyond which they do as well
  int most_cycles = 4;              // before conjugate gradients take over
  // Cells that must lie between the surface and a cell of their size that stands for its eight children; 0: none does.
  int depth = 0;
  int most_composite_cycles = 10;
  int most_iterations = 200;
};

// What the solver did.
struct SolveReport {
  int cycles = 0;      // full multigrid counts as one
  int iterations = 0;  // of conjugate gradients
  double tolerance = 0;
  // Estimated relative error of the exitance (L2 over the surface), the largest of the channels, after each cycle or
  // before each iteration; and the residual's norm over the right-hand side's, where it is known.
  std::vector<double> error_history, residual_history;
  double estimated_error = 0;
  double deep_error = 0;    // the part of it that deep cells bring which stand for their children
  std::size_t skipped = 0;  // points of the polygrid that are no unknowns because of them
  std::size_t unknowns = 0;
  std::vector<std::size_t> level_sizes;
};

// Greatest ratio of two σ_t' of one channel.
double extinction_contrast(const CellCoefficients& coefficients);

// What lights the object, at the solver's unknowns.
struct DiffusionLight {
  std::vector<Float4> irradiance;                 // of each outer unknown, W mm⁻²; q of D2
  std::optional<LevelVector<float>> source;       // W: ∫ Q h dV, instead of what D2 makes of the irradiance
  Double4 source_total = {};                      // its sum before it was rounded
  std::vector<ChannelPlanes<float>> deep_source;  // of each level's leaves, as LevelHierarchy::deep
};

// The solver of one polygrid: its levels once, its couplings for each material, a solution for each light.
class DiffusionSolver {
 public:
  // Keeps a reference to the polygrid. Throws: InputError where its parts do not fit together, or a cell is inverted.
  explicit DiffusionSolver(const Polygrid& polygrid, const SolverParameters& parameters = {});
  DiffusionSolver(const DiffusionSolver&) = delete;
  DiffusionSolver& operator=(const DiffusionSolver&) = delete;

  // `least_tolerance`: the least that will be asked for. `ior` ≥ 1. Throws: InputError.
  void set_material(const CellCoefficients& coefficients, double ior, double least_tolerance);

  // Solves D1, D2 until the estimated relative error of the exitance is below the tolerance. Cold: by full multigrid.
  // `warm`: the last solution, or what `set_initial` gave, plus full multigrid's answer to what has changed in the
  // light (which needs no correction on the finest level), or to the residual. The fluence ends with a constant added
  // that makes D4 exact. On a composite grid (depth > 0) there are cycles only, and where they or the grid do not reach
  // the tolerance the estimate says so: a deeper one, or the whole polygrid, is wanted then. Throws: NumericalError
  // with the history where it does not converge, or meets a number that is not finite.
  SolveReport solve(const DiffusionLight& light, double tolerance, bool warm = false);

  // A fluence to start from warm, one a point of the polygrid. Throws: InputError where it does not fit or is not
  // finite.
  void set_initial(const std::vector<Rgb>& fluence);

  std::size_t size() const { return levels_.front().size(); }
  // Points of the polygrid that are no unknowns, because coarser cells stand for those around them.
  std::size_t skipped() const { return hierarchy_.skipped; }
  const RunLevel& finest() const { return levels_.front(); }
  const FineGrid& grid() const { return fine_; }
  // Vectors of the finest level from values one a polygrid point, in the solver's order.
  LevelVector<float> to_level(const std::vector<Double4>& point_values) const;
  DiffusionLight source_light(const std::vector<Double4>& point_values) const;
  std::vector<Float4> to_outer(const std::vector<Rgb>& point_values) const;
  const SurfaceTerms& surface() const { return terms_; }
  std::vector<std::size_t> level_sizes() const;

  // Of the last solution. Fluence: one a point of the polygrid. Exitance: one an outer unknown.
  std::vector<Double4> fluence() const;
  std::vector<Double4> exitance(const DiffusionLight& light) const;
  EnergyBalance energy(const DiffusionLight& light) const;

  // One V-cycle from zero as an approximate inverse, for measurements: x = B right_side.
  void apply_cycle(const LevelVector<double>& right_side, LevelVector<double>& x);

  // Bytes that one pass over the finest level's couplings and vectors moves, and all that the solver holds.
  std::size_t sweep_bytes() const;
  // Share of the error that a cycle leaves, as full multigrid measured it on the next coarser level.
  double error_left() const { return error_left_; }
  std::size_t memory_bytes() const;

 private:
  double deep_error() const;
  void prepare_coarsest();
  void solve_coarsest();
  void smooth(std::size_t level, int degree, bool inner_light, bool from_zero);
  void cycle(std::size_t level, bool inner_light, bool from_zero, Smoothing smoothing);
  void full_multigrid(bool correct_finest);
  void start_warm(const DiffusionLight& light);
  bool started_far_off() const;
  void load_light(std::size_t level, bool whole);
  void add_deep_residual(std::size_t level, bool inner_light);
  void keep_deep_solution(std::size_t level, bool add);
  std::vector<ChannelPlanes<float>> gather_deep(const std::vector<Double4>& point_values) const;
  void set_light(const DiffusionLight& light);
  static Double4 surface_change(const RunLevel& level, const std::vector<Float4>& x, const std::vector<Float4>& y);
  double relative_change(const Double4& surface_change) const;
  double exitance_change(const std::vector<Float4>& before) const;
  void solve_by_conjugate_gradients(double tolerance, SolveReport& report);
  void conserve_energy(const DiffusionLight& light);

  SolverParameters parameters_;
  const Polygrid& polygrid_;
  LevelHierarchy hierarchy_;
  FineGrid& fine_ = hierarchy_.fine;
  std::vector<RunLevel>& levels_ = hierarchy_.levels;
  SurfaceTerms terms_;
  double boundary_factor_ = 1, current_reflectance_ = 0;
  double contrast_ = 1, layer_share_ = 0;
  bool has_material_ = false;
  std::vector<PatchCorrection> patches_;  // of each level
  std::array<Eigen::LDLT<Eigen::MatrixXd>, 3> coarsest_;
  bool direct_ = false;

  std::vector<LevelVector<float>> lights_;  // of each level, for full multigrid; inner parts only with inner light
  double error_left_ = 0.1;          // share of the first cycle's change that the second one makes, a level below
  Double4 second_change_ = {};       // the latter's surface_change
  std::vector<Float4> first_outer_;  // the outer points before the last cycle
  bool inner_light_ = false;
  Double4 scale_ = {};         // the light's; iterates are in units of it
  LevelVector<double> exact_;  // the solution in double precision, where that was asked for
  bool has_solution_ = false, solution_is_exact_ = false;
  bool light_is_known_ = false;  // lights_ belongs to the solution
  bool warm_by_light_ = false;
  double last_estimate_ = 0;
  LevelVector<float> previous_;  // where a warm start begins
  Double4 warm_factor_ = {};     // on it, for the present light
  std::vector<ChannelPlanes<float>> previous_deep_;
  Double4 shift_ = {};
};

}  // namespace shellgrid
