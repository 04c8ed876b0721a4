// SPDX-License-Identifier: AGPL-3.0-or-later
// Samples against a density, in bins.
#pragma once
#include <cmath>
#include <cstddef>
#include <vector>

namespace shellgrid::test {

// Normal deviate of χ² (Wilson and Hilferty): above 4 about once in 30 000 times by chance.
inline double chi_square_deviate(const std::vector<double>& counts, const std::vector<double>& expected) {
  double sum = 0;
  std::size_t bins = 0;
  for (std::size_t k = 0; k < counts.size(); ++k) {
    if (expected[k] < 5) continue;
    sum += (counts[k] - expected[k]) * (counts[k] - expected[k]) / expected[k];
    ++bins;
  }
  const double n = static_cast<double>(bins) - 1, spread = 2 / (9 * n);
  return (std::cbrt(sum / n) - (1 - spread)) / std::sqrt(spread);
}

}  // namespace shellgrid::test
