// SPDX-License-Identifier: AGPL-3.0-or-later
// Light that goes to and fro between a shell and its core.
#pragma once
#include <array>
#include <cstdint>
#include <functional>
#include <vector>

#include "solvers/dipole/dual_tree.h"

namespace shellgrid {

// The core's surface as points, and what the shell does with light there.
struct CoreSurface {
  std::vector<Vec3f> points;          // mm
  std::vector<float> areas;           // of the core's surface that each stands for, mm²; 0 where the core has ended
  std::vector<Rgb> power;             // that comes down from the shell, lit from outside, W
  std::vector<Rgb> shell_reflection;  // share of what leaves the core that comes down again; empty: none
  // Of each point, where it lies: 1 on the core, towards 0 where the shell leaves none; empty: all on it.
  std::vector<float> presence;
};

// The same surface by fewer points, for light that goes to and fro.
struct CoarserCore {
  CoreSurface surface;
  const RadialProfile* profile = nullptr;
  std::function<std::vector<Rgb>(const std::vector<Rgb>&)> at_points;  // its values at the finer surface's points
};

struct CoreExchangeOptions {
  DualTreeOptions sums;
  const CoarserCore* coarser = nullptr;  // or none
  // The paper's is 0: light that comes out of the core does not enter it again. Source: [STF §7].
  int bounces = 12;         // at most
  double tolerance = 4e-3;  // of what is not followed further: root mean square over the surface, relative
  // The share of its light that each point is to get back in all, that of a plane: a folded or thin core would return
  // more, a small one, which the profile's far end misses, less; so each point's light is scaled, up to fourfold.
  // White matter then returns all light, whatever its shape. Negative: not asked for, as in the paper.
  std::array<double, 3> returned = {-1, -1, -1};
};

struct CoreExchange {
  std::vector<Rgb> exitance;  // M of each point, into the shell, W mm⁻²
  std::vector<Rgb> first;     // of that, what comes from the power given, loosely; empty where nothing bounces
  std::vector<Rgb> power;     // all that enters, with what has come down again, W
  int bounces = 0;            // followed
  // By how much the bounces' sum was none before the last one: root mean square over the surface, relative.
  double residual = 0;
  double greatest_return = 0;     // of any point and channel, over `returned`
  std::int64_t evaluations = 0;   // of the profile, in all sums
  DualTreeStatistics statistics;  // of the sum at the end
};

// M = K (P + R A M): K the profile's sum over the points, A their areas, R the shell's reflection. Bounces
// are followed at four times the tolerance and combined as GMRES does, until what is missed is below it; the last sum
// is that of all that comes, at the tolerance itself. With a coarser surface its bounces are taken, as what they add to
// the first. Throws: InputError where lists do not match or hold what is none,
// NumericalError where bounces do not shrink.
CoreExchange exchange_core_light(const CoreSurface& surface, const RadialProfile& profile,
                                 const CoreExchangeOptions& options = {});

}  // namespace shellgrid
