// SPDX-License-Identifier: AGPL-3.0-or-later
// Sums of a radial function over many points at many points, by a tree of each.
#pragma once
#include <cstdint>
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

// f(t) = Σ_s powers_s K(|t − s|) at each target t, per channel.
//
// Nodes are boxes of points along their own principal axes. Between nodes that are apart far enough K is interpolated
// at Chebyshev points of both boxes, of the least order (2 to 5 along each axis, fewer along thin ones) whose error,
// from K's decay and its powers of r, is below the tolerance relative to K itself: as all powers are positive, so it is
// to each sum, bright or dim. Pairs whose light is below half of the tolerance of what the target is sure to get are
// left out. Source: [JensenBuhler2002 §3.2] sums over one octree, with an angle as its criterion and no bound.
//
// targets, sources: mm; powers: W, ≥ 0. The same bits at any thread count.
// Throws: InputError for powers that are negative or not finite, or lists that do not match.
std::vector<Rgb> dual_tree_sums(const std::vector<Vec3f>& targets, const std::vector<Vec3f>& sources,
                                const std::vector<Rgb>& powers, const RadialProfile& profile,
                                const DualTreeOptions& options = {}, DualTreeStatistics* statistics = nullptr);

}  // namespace shellgrid
