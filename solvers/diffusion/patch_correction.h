// SPDX-License-Identifier: AGPL-3.0-or-later
// Small patches of a multigrid level that are solved exactly beside its smoothing: where cells are stretched or
// sheared, smoothing and coarser levels both leave some errors of a few points.
#pragma once
#include <cstdint>
#include <vector>

#include "solvers/diffusion/channel_lanes.h"
#include "solvers/diffusion/run_level.h"

namespace shellgrid {

// Which points have patches.
struct PatchLimits {
  float slow = 0.06f;     // of values that began in (−1, 1): what eight sweeps leave where points are slow
  double share = 0.0012;  // of the level's points that may be slow ones, the slowest first; 200 always may
  std::size_t seeds = 8;  // slow points of one patch
};
// Materials with jumps leave pockets and threads without coarse points, on all levels.
inline constexpr PatchLimits rough_patches{0.15f, 0.01, 32};

// Points are found by compatible relaxation: what smoothing does not damp with the coarse level's points held at zero,
// the coarse level does not represent. Source: [Brandt2000 §3].
class PatchCorrection {
 public:
  PatchCorrection() = default;

  // Finds the level's slow points with its present couplings, and factors the patches around them. Uses the level's
  // vectors. Points on the coarsest level have no patches.
  void prepare(RunLevel& level, const PatchLimits& limits = {});

  // x ← x + what solves each patch for right_side − A x, patch by patch; `backward`: in the reverse order, which makes
  // the two orders each other's transposes. `inner_light`: whether the right-hand side has inner parts.
  void apply(RunLevel& level, bool inner_light, bool backward) const;

  bool empty() const { return patches_.empty(); }
  std::size_t points() const { return patch_points_; }
  std::size_t bytes() const;

 private:
  struct Entry {
    Float4 coupling;
    std::int32_t other;  // place in the patch's reach
  };
  // Unknowns: inner ones by their number, outer ones after them.
  struct Patch {
    std::size_t reach;  // its first in `reach_`: its own points, then those they couple with
    std::int32_t points = 0, reached = 0;
    std::size_t row;     // its first in `row_`
    std::size_t factor;  // its first in `factors_`
  };
  struct Row {
    std::int64_t begin, end;  // in `entries_`
    Float4 reaction, inverse_pivot;
    std::int32_t first;  // column where the factor's row begins
  };

  void solve(const Patch& patch, RunLevel& level, bool inner_light) const;
  void factor(const Patch& patch);

  std::vector<Patch> patches_;  // by colour: those of one do not touch each other
  std::vector<std::size_t> colour_start_;
  std::vector<std::int32_t> reach_;
  std::vector<Row> row_;
  std::vector<Entry> entries_;
  std::vector<Float4> factors_;  // L's rows of all patches, without the unit diagonal
  std::size_t patch_points_ = 0;
};

}  // namespace shellgrid
