// SPDX-License-Identifier: AGPL-3.0-or-later
// What the benchmarks share: clocks and the choice between a short and a long form.
#pragma once
#include <algorithm>
#include <chrono>
#include <cstdlib>
#include <vector>

namespace shellgrid::test {

// SG_LONG=1 asks for larger problems and more repetitions.
inline bool long_form() { return std::getenv("SG_LONG") != nullptr; }

template <class Work>
double seconds_of(const Work& work) {
  const auto start = std::chrono::steady_clock::now();
  work();
  return std::chrono::duration<double>(std::chrono::steady_clock::now() - start).count();
}

inline double median(std::vector<double> values) {
  std::nth_element(values.begin(), values.begin() + values.size() / 2, values.end());
  return values[values.size() / 2];
}

template <class Work>
double median_seconds(int runs, const Work& work) {
  std::vector<double> seconds;
  for (int run = 0; run < runs; ++run) seconds.push_back(seconds_of(work));
  return median(seconds);
}

}  // namespace shellgrid::test
