// SPDX-License-Identifier: AGPL-3.0-or-later
// Counter-based random numbers: a value is a function of seed and position, so results do not
// depend on the order or number of threads.
#pragma once
#include <cstdint>

namespace shellgrid {

// Mixes 64 bits well (the finaliser of splitmix64).
constexpr std::uint64_t hash64(std::uint64_t x) {
  x += 0x9e3779b97f4a7c15ull;
  x = (x ^ (x >> 30)) * 0xbf58476d1ce4e5b9ull;
  x = (x ^ (x >> 27)) * 0x94d049bb133111ebull;
  return x ^ (x >> 31);
}

constexpr std::uint64_t hash64(std::uint64_t a, std::uint64_t b) {
  return hash64(hash64(a) ^ (b * 0xd1342543de82ef95ull));
}
constexpr std::uint64_t hash64(std::uint64_t a, std::uint64_t b, std::uint64_t c) { return hash64(hash64(a, b), c); }

// Uniform in [0, 1).
constexpr double to_unit(std::uint64_t bits) { return static_cast<double>(bits >> 11) * 0x1.0p-53; }

// A stream of numbers for one (seed, index) pair.
class RandomStream {
 public:
  explicit RandomStream(std::uint64_t seed, std::uint64_t index = 0) : key_(hash64(seed, index)) {}
  std::uint64_t next_bits() { return hash64(key_, counter_++); }
  double next() { return to_unit(next_bits()); }  // uniform in [0, 1)

 private:
  std::uint64_t key_;
  std::uint64_t counter_ = 0;
};

}  // namespace shellgrid
