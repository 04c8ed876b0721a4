// SPDX-License-Identifier: AGPL-3.0-or-later
// One multigrid level: its points in runs, its outer points, its couplings, its vectors, and the passes over them.
#pragma once
#include <array>
#include <cstdint>
#include <vector>

#include "solvers/diffusion/channel_lanes.h"
#include "solvers/diffusion/lattice_runs.h"
#include "solvers/diffusion/wide_lanes.h"

namespace shellgrid {

template <class Real>
struct RealLanes4;
template <>
struct RealLanes4<float> {
  using Type = Float4;
};
template <>
struct RealLanes4<double> {
  using Type = Double4;
};

// Red, green and blue of inner unknowns, a plane each.
template <class Value>
class ChannelPlanes {
 public:
  ChannelPlanes() = default;
  explicit ChannelPlanes(std::size_t size) : stride_((size + 31) / 32 * 32 + 32), buffer_(3 * stride_) {}
  Value* operator[](int channel) { return buffer_.data() + channel * stride_; }
  const Value* operator[](int channel) const { return buffer_.data() + channel * stride_; }
  std::size_t bytes() const { return buffer_.bytes(); }

 private:
  std::size_t stride_ = 0;
  StreamBuffer<Value> buffer_;
};

// A value of each unknown and channel.
template <class Real>
struct LevelVector {
  ChannelPlanes<Real> inner;
  std::vector<typename RealLanes4<Real>::Type> outer;

  LevelVector() = default;
  LevelVector(std::size_t inner_size, std::size_t outer_size) : inner(inner_size), outer(outer_size) {}
};

// The outer points of a level and which of them are neighbours. An outer point s couples with outer points; its twin,
// an inner point, couples with the same ones; and it with their twins.
struct SurfaceLayout {
  std::vector<std::int32_t> twin;          // inner unknown of each outer point, ascending
  std::vector<std::int32_t> first_of_run;  // runs + 1: the outer points whose twins the run holds
  std::vector<std::int32_t> start;         // outer points + 1
  std::vector<std::int32_t> neighbour;     // outer points

  std::size_t size() const { return twin.size(); }
};

// Of a pair of neighbours s, t: outer with outer, twin of s with outer t, outer s with twin of t.
template <class Store>
struct SurfaceCoupling {
  Store outer_outer[3], twin_outer[3], outer_twin[3];
};

// A symmetric operator (A x)_i = reaction_i x_i + Σ_j coupling_ij (x_i − x_j) on a level.
template <class Store>
struct LevelCouplings {
  int copies = 3;                // 1: the three channels' couplings are proportional
  StreamBuffer<Store> values;    // see RunLayout::place
  Float4 factor = {1, 1, 1, 1};  // stored values times it are couplings
  std::vector<SurfaceCoupling<Store>> surface;
  Float4 surface_factor = {1, 1, 1, 1};

  explicit operator bool() const { return static_cast<bool>(values); }
  std::size_t bytes() const { return values.size() * sizeof(Store) + surface.size() * sizeof(surface[0]); }
};

// What fine points take from each of their coarse ones, where these are not equal shares.
struct TransferWeights {
  StreamBuffer<float> values;                                      // of runs without a list: see `line`
  std::vector<std::int64_t> start;                                 // runs + 1, in `values`
  std::vector<Float4> inner_up, inner_down, outer_up, outer_down;  // of the lists' entries

  explicit operator bool() const { return static_cast<bool>(values); }
  // Of a run's points and one of its coarse lines. Kind 0: of points at 2 X of the line's point X; 1, 2: of points at
  // 2 X + 1 of the line's points X, X + 1. Red; green and blue follow `coarse_length` apart.
  float* line(std::size_t run, std::int32_t coarse_length, int line, int kind) {
    return values.data() + start[run] + static_cast<std::int64_t>(3 * (3 * line + kind)) * coarse_length;
  }
  const float* line(std::size_t run, std::int32_t coarse_length, int line, int kind) const {
    return const_cast<TransferWeights*>(this)->line(run, coarse_length, line, kind);
  }
};

// Restriction and prolongation between a level and the next coarser one: the fine points of a run take the mean of 1, 2
// or 4 coarse lines, and at odd x of two points of each. Other runs and outer points have lists.
struct LevelTransfer {
  struct FineRun {
    std::array<std::int32_t, 4> coarse{};  // coarse unknowns at the run's first x, halved and rounded down
    std::int32_t lines = 0;                // 1, 2, 4; 0: by list
    std::int32_t coarse_length = 0;        // coarse places that the run touches in each line
    std::int32_t half_start = 0;           // where its residual, summed along x, stands; by list: its first row
  };
  struct CoarsePart {
    std::int32_t fine_run, coarse_place;  // first coarse place it adds to
    float weight;
    std::int32_t line;  // which of the fine run's
  };
  struct List {
    std::vector<std::int32_t> row;  // the unknowns that have an entry; all where empty
    std::vector<std::int64_t> start;
    std::vector<std::int32_t> index;
    std::vector<float> weight;  // of each entry; empty: equal shares
  };
  std::vector<FineRun> fine_runs;
  std::vector<CoarsePart> parts;  // by coarse run
  std::vector<std::int32_t> part_start;
  std::int64_t half_size = 0;
  List inner_up, inner_down;  // of irregular runs: coarse of fine, fine of coarse
  List outer_up, outer_down;
  TransferWeights weights;  // none: equal shares

  bool empty() const { return fine_runs.empty(); }
};

// Polynomial smoothing, the first step of `x + keep (x − x_before) + take Z r`.
struct SmoothingStep {
  float keep = 0, take = 1;
};

// The cells of a level, as their elements are added up.
struct LevelCells {
  std::vector<std::int32_t> corners;          // 8 inner unknowns a cell, bit k of the corner's number towards + axis k
  std::vector<std::uint8_t> octant;           // place in the parent: bit k for the half towards + axis k
  std::vector<std::int32_t> parent;           // cell of the next coarser level
  std::vector<std::int32_t> boundary;         // cells with boundary elements, ascending
  std::vector<std::uint8_t> outer_mask;       // of each of those: the corners above which outer points couple
  std::vector<std::int32_t> outer;            // 8 of each of those: the outer points above its corners or −1
  std::vector<std::int32_t> boundary_parent;  // of each of those: its parent's place among the coarser level's
  std::vector<std::int32_t> slab_start;       // cells of slabs that share z / 2, ascending
  std::vector<std::int32_t> boundary_slab_start;  // the same of cells with boundary elements

  std::size_t size() const { return octant.size(); }
};

struct RunLevel {
  RunLayout layout;
  LevelCells cells;
  SurfaceLayout surface;
  LevelTransfer transfer;  // to the next coarser level; empty on the coarsest
  // Unknowns that keep the value which coarser levels give them: those on the faces of leaves of a composite grid.
  std::vector<std::int32_t> frozen;

  LevelCouplings<Half> half;
  LevelCouplings<float> single;
  LevelVector<float> reaction;
  // Through the thin layer: what flows from an outer point to its twin is link (x_outer − x_twin). Apart from the other
  // couplings, so that these keep their precision beside it where the layer is thin. Coarse levels take the sums of the
  // Galerkin product's rows: its other entries would hide the pairs' common part, which is weak, from the smoother.
  std::vector<Float4> link;                                       // of each outer point
  std::vector<Float4> extra;                                      // of layout.extras
  ChannelPlanes<UpperHalf> inverse;                               // smoother: of the diagonal or the pair's 2×2 block
  std::vector<Float4> twin_inverse, pair_inverse, outer_inverse;  // of the blocks; `inverse` is 0 at twins

  LevelVector<float> x, before, right_side;
  ChannelPlanes<float> halved;  // residuals summed along x, for the restriction

  std::size_t inner_size() const { return layout.size(); }
  std::size_t size() const { return layout.size() + surface.size(); }
};

// Sets the smoother from couplings and reaction.
void prepare_smoother(RunLevel& level);

// result = A x, with the couplings in single precision where they are kept; `rounded`: with those that smooth.
template <class Real>
void apply_level(const RunLevel& level, const LevelVector<Real>& x, LevelVector<Real>& result, bool rounded = false);

// x ← x + keep (x − before) + take Z (right_side − A x), before ← old x. `inner_light`: whether the right-hand side has
// inner parts.
void smooth_level(RunLevel& level, const SmoothingStep& step, bool inner_light);

// x ← take Z right_side.
void smooth_from_zero(RunLevel& level, float take, bool inner_light);

// coarse.right_side ← R (right_side − A x). Leaves `before` undefined.
void restrict_residual(RunLevel& level, RunLevel& coarse, bool inner_light);

// coarse ← R fine.
void restrict_vector(RunLevel& level, const LevelVector<float>& fine, const RunLayout& coarse_layout,
                     LevelVector<float>& coarse);

// The outer part alone.
void restrict_outer_vector(const RunLevel& level, const std::vector<Float4>& fine, std::vector<Float4>& coarse);

// fine ← P coarse, or fine += P coarse.
void prolong_vector(const RunLevel& level, const LevelVector<float>& coarse, LevelVector<float>& fine, bool add);

}  // namespace shellgrid
