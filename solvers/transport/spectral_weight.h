// SPDX-License-Identifier: AGPL-3.0-or-later
// One path carries red, green and blue. Each chance event is drawn as one channel would have it, the channel chosen in
// proportion to the path's present weights; then all weights are multiplied by their own density over the mean density
// with which it was drawn (the balance heuristic over channels). Unbiased in each channel, and the sum of the weights
// stays what it was, whatever the coefficients: no weight explodes.
// Source: [Wilkie2014] (hero wavelength), with the choice renewed at each event.
#pragma once
#include <bit>
#include <cmath>
#include <cstdint>

#include "solvers/diffusion/channel_lanes.h"

namespace shellgrid {

// e^x in each lane for x in [−700, 700], below that 0; relative error below 1e-9.
inline Double4 lane_exponential(Double4 x) {
  constexpr double round = 0x1.8p52;
  x = x < -700 ? Double4{-700, -700, -700, -700} : x;
  const Double4 scaled = x * 1.4426950408889634074, shifted = scaled + round, whole = shifted - round;
  const Double4 f = (scaled - whole) * 0.693147180559945309417;  // in [−½ ln 2, ½ ln 2]
  const Double4 series =
      1 +
      f * (1 + f * (1.0 / 2 +
                    f * (1.0 / 6 + f * (1.0 / 24 + f * (1.0 / 120 + f * (1.0 / 720 + f * (1.0 / 5040 + f / 40320)))))));
  using Bits4 = std::int64_t __attribute__((vector_size(32)));
  const Bits4 exponent = (std::bit_cast<Bits4>(shifted) << 52);
  return std::bit_cast<Double4>(std::bit_cast<Bits4>(series) + exponent);
}

inline double lane_sum(Double4 a) { return a[0] + a[1] + a[2]; }
inline Double4 lane_broadcast(double a) { return Double4{a, a, a, 0}; }

// The weights after an event whose densities, times the weights, are `drawn`: in their proportion, with the old sum.
inline Double4 reweighted(Double4 weight, Double4 drawn) {
  const double sum = lane_sum(drawn);
  return sum > 0 ? drawn * (lane_sum(weight) / sum) : weight;
}

// A channel, in proportion to the weights; u in [0, 1).
inline int choose_channel(Double4 weight, double u) {
  const double at = u * lane_sum(weight);
  if (at < weight[0]) return 0;
  if (at < weight[0] + weight[1] || !(weight[2] > 0)) return weight[1] > 0 ? 1 : 0;
  return 2;
}

}  // namespace shellgrid
