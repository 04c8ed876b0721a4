// SPDX-License-Identifier: AGPL-3.0-or-later
// Sums and changes over the entries of a level's vectors, in the same order whatever the threads.
#pragma once
#include "meshing/core/parallel.h"
#include "solvers/diffusion/run_level.h"

namespace shellgrid {

// Entries that one task takes.
inline constexpr std::size_t level_grain = 4096;

// Σ term(a, b) of each channel, in double precision.
template <class A, class B, class Term>
Double4 sum_over(const LevelVector<A>& a, const LevelVector<B>& b, std::size_t inner, const Term& term) {
  Double4 total = parallel_sum((inner + level_grain - 1) / level_grain, Double4{},
                               [&](std::size_t k) {
                                 Double4 sum = {};
                                 const std::size_t end = std::min(inner, (k + 1) * level_grain);
                                 for (int c = 0; c < 3; ++c) {
                                   double part[8] = {};
                                   const A* x = a.inner[c];
                                   const B* y = b.inner[c];
                                   for (std::size_t i = k * level_grain; i < end; ++i)
                                     part[i % 8] += term(static_cast<double>(x[i]), static_cast<double>(y[i]));
                                   for (double p : part) sum[c] += p;
                                 }
                                 return sum;
                               },
                               1);
  for (std::size_t s = 0; s < a.outer.size(); ++s)
    for (int c = 0; c < 3; ++c) total[c] += term(a.outer[s][c], b.outer[s][c]);
  return total;
}

template <class A, class B>
Double4 dot(const LevelVector<A>& a, const LevelVector<B>& b, std::size_t inner) {
  return sum_over(a, b, inner, [](double x, double y) { return x * y; });
}

// Calls body(value of a, value of b, channel) with references, for all entries.
template <class A, class B, class Body>
void for_entries(LevelVector<A>& a, LevelVector<B>& b, std::size_t inner, const Body& body) {
  parallel_chunks(inner, 4 * level_grain, [&](std::size_t begin, std::size_t end) {
    for (int c = 0; c < 3; ++c) {
      auto* x = a.inner[c];
      auto* y = b.inner[c];
      for (std::size_t i = begin; i < end; ++i) body(x[i], y[i], c);
    }
  });
  for (std::size_t s = 0; s < a.outer.size(); ++s)
    for (int c = 0; c < 3; ++c) {
      A x = a.outer[s][c];
      B y = b.outer[s][c];
      body(x, y, c);
      a.outer[s][c] = x;
      b.outer[s][c] = y;
    }
}

}  // namespace shellgrid
