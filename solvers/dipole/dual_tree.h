// SPDX-License-Identifier: AGPL-3.0-or-later
// Sums of a radial function over many points at many points, by a tree of each.
#pragma once
#include <cstdint>
#include <memory>
#include <vector>

#include "meshing/core/vec.h"
#include "solvers/dipole/radial_profile.h"

namespace shellgrid {

struct DualTreeOptions {
  double tolerance = 0.01;     // of each sum: its greatest relative error
  double dynamic_range = 1e6;  // sums below the greatest one's share of 1 / this may be less exact
  bool brute_force = false;    // all pairs in double precision: the check
};

struct DualTreeStatistics {
  std::int64_t nodes = 0;
  std::int64_t point_pairs = 0;    // evaluated one by one
  std::int64_t node_pairs = 0;     // of nodes, evaluated through their interpolation points
  std::int64_t evaluations = 0;    // of the function, in all
  std::int64_t skipped_pairs = 0;  // of nodes, as all their light is below what matters
  std::size_t bytes = 0;           // of the trees
};

// f(t) = Σ_s powers_s K(|t − s|) at each target t, per channel; for several lists of powers, one after the other.
//
// Nodes are boxes of points along their own principal axes. Between nodes that are apart far enough K is interpolated
// at Chebyshev points of both boxes, of the least order (2 to 5 along each axis, fewer along thin ones) whose error,
// from K's decay and its powers of r, is below the tolerance relative to K itself: as all powers are positive, so it is
// to each sum, bright or dim. Pairs that give less than a small share of the tolerance of what
// the target is sure to get are left out; those that give little more may be wrong by as much more of themselves.
// Source: [JensenBuhler2002 §3.2] sums over one octree, with an angle as its criterion and no bound.
class DualTree {
 public:
  // targets, sources: mm; all that is given but the options must outlive this. Throws: InputError for points that are
  // not finite, a tolerance that is none.
  DualTree(const std::vector<Vec3f>& targets, const std::vector<Vec3f>& sources, const RadialProfile& profile,
           const DualTreeOptions& options = {});
  ~DualTree();

  // powers: W, ≥ 0, of each source. tolerance: the options', or more: it counts by steps of four times. The same bits
  // at any thread count. Throws: InputError for powers that are negative or not finite, or not of the sources' number.
  std::vector<Rgb> sums(const std::vector<Rgb>& powers, double tolerance, DualTreeStatistics* statistics = nullptr);

 private:
  struct Impl;
  const std::vector<Vec3f>& targets_;
  const std::vector<Vec3f>& sources_;
  const RadialProfile& profile_;
  DualTreeOptions options_;
  std::unique_ptr<Impl> impl_;
};

// The same for one list of powers.
std::vector<Rgb> dual_tree_sums(const std::vector<Vec3f>& targets, const std::vector<Vec3f>& sources,
                                const std::vector<Rgb>& powers, const RadialProfile& profile,
                                const DualTreeOptions& options = {}, DualTreeStatistics* statistics = nullptr);

}  // namespace shellgrid
