// SPDX-License-Identifier: AGPL-3.0-or-later
// Walks shared among all directions against paths of each direction: χ² over voxels and directions, and the sums over
// each layer and ring, where errors of single voxels cancel.
#include <gtest/gtest.h>

#include <algorithm>
#include <cmath>
#include <cstdio>
#include <string>

#include "solvers/shell_texture/irradiance_tracing.h"
#include "tests/support/base_volumes.h"
#include "tests/support/timing.h"

namespace shellgrid {
namespace {

struct Agreement {
  double chi_square = 0;   // mean of the squared differences over their variances
  double worst_layer = 0;  // relative difference of I_m summed over a layer and ring, in the magnitude
  double mean_layer = 0;   // the same, mean of the magnitudes
  double worst_below = 0;  // of what passes down, summed over a ring
  double total = 0;        // relative difference of all
};

Agreement compare(const BaseVolume& volume, double paths, double shared_paths) {
  IrradianceOptions options;
  options.directions = {3, 6};
  options.smooth = false;
  options.march_rays = 16;
  options.march_error = 0.002;
  // Many batches, for standard errors that are known well.
  options.target_error = 1e-9;
  options.paths = paths / 8;
  options.most_paths = paths;
  options.estimator = IrradianceEstimator::track_length;
  const ShellTexture judge = trace_irradiance(volume, options);
  options.estimator = IrradianceEstimator::shared_walks;
  options.paths = shared_paths / 8;
  options.most_paths = shared_paths;
  options.seed = 1;
  const ShellTexture shared = trace_irradiance(volume, options);
  Agreement a;
  double count = 0, all = 0, all_judge = 0, layers = 0;
  const std::size_t texels = judge.texel_count();
  for (int ring = 0; ring <= options.directions.rings; ++ring) {
    const int turns = ring == options.directions.rings ? 1 : options.directions.turns;
    double below = 0, below_judge = 0;
    for (int z = 0; z < volume.size.z(); ++z) {
      double layer = 0, layer_judge = 0;
      for (int turn = 0; turn < turns; ++turn)
        for (std::size_t k = 0; k < texels; ++k) {
          const int l = ring * options.directions.turns + turn;
          const std::size_t v = z * texels + k, at = judge.at(l, v);
          if (z == 0) {
            below += static_cast<double>(shared.below[l * texels + k].mean());
            below_judge += static_cast<double>(judge.below[l * texels + k].mean());
          }
          if (judge.matter[v] < 0.05f) continue;
          const double one = static_cast<double>(shared.multiple[at].mean());
          const double other = static_cast<double>(judge.multiple[at].mean());
          layer += judge.matter[v] * one;
          layer_judge += judge.matter[v] * other;
          if (judge.error[at] < 0 || shared.error[at] < 0) continue;
          const double variance = std::pow(one * shared.error[at], 2) + std::pow(other * judge.error[at], 2);
          if (!(variance > 0)) continue;
          a.chi_square += (one - other) * (one - other) / variance;
          ++count;
        }
      if (layer_judge > 0) {
        const double off = layer / layer_judge - 1;
        a.worst_layer = std::max(a.worst_layer, std::abs(off));
        a.mean_layer += std::abs(off);
        ++layers;
        if (test::long_form()) std::printf("    ring %d layer %d: %+.4f\n", ring, z, off);
      }
      all += layer;
      all_judge += layer_judge;
    }
    if (below_judge > 0) a.worst_below = std::max(a.worst_below, std::abs(below / below_judge - 1));
  }
  if (count > 0) a.chi_square /= count;
  if (layers > 0) a.mean_layer /= layers;
  if (all_judge > 0) a.total = all / all_judge - 1;
  return a;
}

TEST(IrradianceAgreement, SharedWalksAgreeWithPathsOfEachDirection) {
  std::printf("material                          χ²     all        layers mean / worst   below\n");
  const double more = test::long_form() ? 16 : 1;
  const std::vector<test::NamedVolume> all = test::base_volumes();
  for (std::size_t k = 0; k < all.size(); k += test::long_form() ? 1 : 2) {
    const test::NamedVolume& named = all[k];
    const Agreement a = compare(named.volume, 60 * more, 300 * more);
    std::printf("%-32s %.3f  %+.4f   %.4f %.4f   %.4f\n", named.name.c_str(), a.chi_square, a.total, a.mean_layer,
                a.worst_layer, a.worst_below);
    std::fflush(stdout);
    // Of the long form errors of a thousandth would show: there differences within voxels do that walks do not know of.
    EXPECT_LT(a.chi_square, test::long_form() ? 2 : 1.2) << named.name;
    EXPECT_LT(std::abs(a.total), test::long_form() ? 0.01 : 0.03) << named.name;
    EXPECT_LT(a.mean_layer, test::long_form() ? 0.02 : 0.04) << named.name;
  }
}

}  // namespace
}  // namespace shellgrid
