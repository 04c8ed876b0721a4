// SPDX-License-Identifier: AGPL-3.0-or-later
// Random numbers of one light path, and the two variates that every flight needs.
#pragma once
#include <bit>
#include <cmath>
#include <cstdint>

#include "meshing/core/random.h"

namespace shellgrid {

// −ln u for u in (0, 1]; relative error below 1e-9.
inline double negative_log(double u) {
  constexpr std::int64_t square_root_of_half = 0x3fe6a09e667f3bcd;
  const auto bits = std::bit_cast<std::int64_t>(u);
  const std::int64_t exponent = (bits - square_root_of_half) >> 52;
  const double m = std::bit_cast<double>(bits - (exponent << 52));  // in [√½, √2)
  const double s = (m - 1) / (m + 1), z = s * s;
  const double series = 1 + z * (1.0 / 3 + z * (1.0 / 5 + z * (1.0 / 7 + z * (1.0 / 9 + z * (1.0 / 11)))));
  return -(static_cast<double>(exponent) * 0.693147180559945309417 + 2 * s * series);
}

// Cosine and sine of 2π u for u in [0, 1), to 3e-9.
struct CosineSine {
  double cosine, sine;
};
inline CosineSine turn(double u) {
  const double quarter = std::floor(4 * u + 0.5);
  const double x = (4 * u - quarter) * 1.57079632679489661923, z = x * x;
  const double sine = x * (1 + z * (-1.0 / 6 + z * (1.0 / 120 + z * (-1.0 / 5040 + z * (1.0 / 362880)))));
  const double cosine = 1 + z * (-0.5 + z * (1.0 / 24 + z * (-1.0 / 720 + z * (1.0 / 40320 + z * (-1.0 / 3628800)))));
  const int quadrant = static_cast<int>(quarter) & 3;
  const double c = quadrant & 1 ? sine : cosine, s = quadrant & 1 ? cosine : sine;
  return {(quadrant + 1) & 2 ? -c : c, quadrant & 2 ? -s : s};
}

// The random numbers of one path: a function of seed and path index alone, so a path is the same whichever thread
// follows it, and whenever. Each path steps through the counter with an odd stride of its own: no two share a stretch.
// Source: [Steele2014] (splitmix64 and its split).
class PathRandom {
 public:
  PathRandom(std::uint64_t seed, std::uint64_t path_index)
      : counter_(hash64(seed, path_index)), stride_(stride(hash64(counter_ ^ 0x5851f42d4c957f2dull))) {}

  std::uint64_t next_bits() {
    std::uint64_t x = counter_ += stride_;
    x = (x ^ (x >> 30)) * 0xbf58476d1ce4e5b9ull;
    x = (x ^ (x >> 27)) * 0x94d049bb133111ebull;
    return x ^ (x >> 31);
  }
  double next() { return to_unit(next_bits()); }  // uniform in [0, 1)
  // With mean one; the free path in units of 1/σ_t.
  double exponential() { return negative_log((static_cast<double>(next_bits() >> 12) + 0.5) * 0x1.0p-52); }
  CosineSine azimuth() { return turn(next()); }

 private:
  static std::uint64_t stride(std::uint64_t bits) {
    bits |= 1;
    return std::popcount(bits ^ (bits >> 1)) < 24 ? bits ^ 0xaaaaaaaaaaaaaaaaull : bits;
  }
  std::uint64_t counter_, stride_;
};

}  // namespace shellgrid
