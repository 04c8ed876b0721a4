// SPDX-License-Identifier: AGPL-3.0-or-later
// Many collisions at once, deep inside homogeneous matter: a step from the centre of a sphere to its surface.
#pragma once
#include <algorithm>
#include <array>
#include <cmath>

#include "meshing/core/vec.h"
#include "solvers/diffusion/channel_lanes.h"
#include "solvers/transport/path_random.h"

namespace shellgrid {

constexpr std::uint64_t leaps_begin = 1000;  // collisions and meetings of a path, before its first leap

// One channel of matter. In it, many mean free paths from anything else, what light will do, averaged over its
// direction, is a solution of ∇²u = κ²u: exactly so, with transport's own κ, but for a part that falls off with the
// distance at least as exp(−distance/mean free path). Hence light that travels into any direction from the centre of a
// sphere is worth as much as κR/sinh(κR) of it that starts from anywhere on the sphere into any direction.
// Source: [CaseZweifel1967] (the discrete mode), [Muller1956] (steps on spheres).
class DiffuseLeap {
 public:
  DiffuseLeap() = default;
  // mm⁻¹; albedo 0 … 1. Matter for which κ is not far below the rate of those other parts knows no leap.
  DiffuseLeap(double extinction, double albedo, double anisotropy);

  bool possible() const { return margin_ > 0; }
  // The sphere's, mm, where nothing else is nearer than `clearance`; 0: too near to leap.
  double radius(double clearance) const {
    const double r = clearance - margin_;
    return margin_ > 0 && r >= least_ ? r : 0;
  }
  // What is absorbed on the way, of one.
  double loss(double radius) const;
  // The mean length of the way, weighted with what is left, mm.
  double length(double radius) const { return absorption_ > 0 ? loss(radius) / absorption_ : white_length(radius); }
  // Distance from the centre of a place on the way, drawn in proportion to what passes there.
  double place(double radius, PathRandom& random) const;
  double decay() const { return decay_; }  // κ, mm⁻¹

 private:
  double white_length(double radius) const { return 0.5 * reduced_scattering_ * radius * radius; }

  double absorption_ = 0, reduced_scattering_ = 0, decay_ = 0, margin_ = 0, least_ = 0;
};

// After a scattering by this cosine: whether it was by the even part of the phase function, which forgets the direction
// before. p = q/4π + (p − q/4π), q as large as it can be.
inline bool scattered_evenly(double anisotropy, double cosine, PathRandom& random) {
  const double g = anisotropy;
  if (std::abs(g) < 1e-6) return true;
  const double ratio = std::sqrt(std::max(0.0, 1 + g * g - 2 * g * cosine)) / (1 + std::abs(g));
  return random.next() < ratio * ratio * ratio;
}

// The three channels of matter that scatters alike in all of them.
struct ChannelLeaps {
  std::array<DiffuseLeap, 3> channel;
  double anisotropy = 0;
  bool possible = false;

  // The sphere's radius that all channels allow which the path has any weight in, mm; 0: none.
  double radius(double clearance, Double4 weight) const {
    if (!possible) return 0;
    double least = clearance, sum = weight[0] + weight[1] + weight[2];
    for (std::size_t c = 0; c < 3; ++c) {
      if (weight[c] <= nothing * sum) continue;
      least = std::min(least, channel[c].radius(clearance));
    }
    return least;
  }
  // Of each channel's weight what is absorbed.
  Double4 loss(double radius) const {
    Double4 share = {};
    for (std::size_t c = 0; c < 3; ++c) share[c] = channel[c].possible() ? channel[c].loss(radius) : 1;
    return share;
  }

 private:
  static constexpr double nothing = 1e-12;
};
inline ChannelLeaps channel_leaps(const Double4& extinction, const Double4& albedo, const Double4& anisotropy) {
  ChannelLeaps leaps;
  leaps.anisotropy = anisotropy[0];
  if (anisotropy[1] != anisotropy[0] || anisotropy[2] != anisotropy[0]) return leaps;
  for (std::size_t c = 0; c < 3; ++c) {
    leaps.channel[c] = DiffuseLeap(extinction[c], albedo[c], anisotropy[c]);
    leaps.possible = leaps.possible || leaps.channel[c].possible();
  }
  return leaps;
}

}  // namespace shellgrid
