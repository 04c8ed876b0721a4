// SPDX-License-Identifier: AGPL-3.0-or-later
// What the diffusion benchmark measures with: clocks, memory, rows of its table.
#pragma once
#include <malloc.h>

#include <algorithm>
#include <array>
#include <cmath>
#include <cstdio>
#include <cstdlib>
#include <cstring>
#include <ctime>
#include <fstream>
#include <map>
#include <string>
#include <utility>
#include <vector>

#include "solvers/diffusion/channel_lanes.h"

namespace shellgrid::test {

inline double clock_seconds(clockid_t clock) {
  timespec t;
  clock_gettime(clock, &t);
  return static_cast<double>(t.tv_sec) + 1e-9 * static_cast<double>(t.tv_nsec);
}

// Processor seconds of all threads, and seconds on the wall.
struct Seconds {
  double processor = 0, wall = 0;
  Seconds operator+(const Seconds& o) const { return {processor + o.processor, wall + o.wall}; }
  Seconds operator*(double f) const { return {f * processor, f * wall}; }
  static Seconds now() { return {clock_seconds(CLOCK_PROCESS_CPUTIME_ID), clock_seconds(CLOCK_MONOTONIC)}; }
  Seconds operator-(const Seconds& o) const { return {processor - o.processor, wall - o.wall}; }
};

template <class Work>
Seconds time_of(const Work& work) {
  const Seconds start = Seconds::now();
  work();
  return Seconds::now() - start;
}

// The least of some repetitions.
template <class Work>
Seconds least_time_of(int repetitions, const Work& work) {
  Seconds least{1e300, 1e300};
  for (int k = 0; k < repetitions; ++k) {
    const Seconds s = time_of(work);
    least = {std::min(least.processor, s.processor), std::min(least.wall, s.wall)};
  }
  return least;
}

// Of one thread, bytes a second: a ← b + 1.5 c, twelve bytes an entry counted.
inline double triad_speed() {
  const std::size_t n = 16 << 20;
  std::vector<float> a(n), b(n, 1.0f), c(n, 2.0f);
  const Seconds s = least_time_of(5, [&] {
    for (std::size_t i = 0; i < n; ++i) a[i] = b[i] + 1.5f * c[i];
  });
  return 12.0 * static_cast<double>(n) / s.processor;
}

// The most memory that the process has held since, above what it held then.
class PeakMemory {
 public:
  PeakMemory() {
    malloc_trim(0);
    std::ofstream("/proc/self/clear_refs") << "5";
    start_ = status("VmRSS:");
  }
  double bytes() const { return std::max(0.0, status("VmHWM:") - start_); }

 private:
  static double status(const char* key) {
    std::ifstream file("/proc/self/status");
    for (std::string line; std::getline(file, line);)
      if (line.rfind(key, 0) == 0) return 1024 * std::atof(line.c_str() + std::strlen(key));
    return 0;
  }
  double start_ = 0;
};

constexpr std::array<double, 5> error_levels = {0.1, 0.03, 0.01, 0.005, 0.001};

// What one method took to bring the exitance's algebraic error under one level.
struct Row {
  std::string size;  // of the polygrid that the method is set beside, in nodes
  std::string method, discretisation;
  std::size_t unknowns = 0;
  double level = 0, error = 0;
  double assembly = 0;  // processor seconds that made the matrix, where others are given it
  Seconds setup, solve;
  double bytes = 0;
  double application = 0;  // processor seconds of one product with the method's matrices, red, green and blue
  double floor = 0;        // processor seconds in which such a product's bytes pass at the triad's speed
  double discretisation_error = 0, soft_error = 0;
  std::string note;  // why there are no figures
};

constexpr const char* table_head =
    "size,method,discretisation,unknowns,level,error,assembly_s,setup_s,solve_s,setup_wall_s,solve_wall_s,bytes,ratio,"
    "solve_ratio,unknowns_per_core_s,applications_per_digit,floor_ratio,discretisation_error,"
    "soft_light_error,note";

// `own`: this project's cold row of the same size and level, or null.
inline void print(const Row& r, const Row* own) {
  std::printf("%s,%s,%s,%zu,%g,", r.size.c_str(), r.method.c_str(), r.discretisation.c_str(), r.unknowns, r.level);
  if (!r.note.empty()) {
    std::printf(",,,,,,,,,,,,,,%s\n", r.note.c_str());
    std::fflush(stdout);
    return;
  }
  std::printf("%.3e,%.4g,%.4g,%.4g,%.4g,%.4g,%.4g,", r.error, r.assembly, r.setup.processor, r.solve.processor,
              r.setup.wall, r.solve.wall, r.bytes);
  if (own && own->note.empty())
    std::printf("%.2f,%.2f,", (r.setup.processor + r.solve.processor) / (own->setup.processor + own->solve.processor),
                r.solve.processor / own->solve.processor);
  else
    std::printf(",,");
  const double solve = r.solve.processor;
  std::printf("%.4g,", 3 * static_cast<double>(r.unknowns) / solve);
  if (r.application > 0)
    std::printf("%.2f,%.1f,", solve / r.application / -std::log10(r.error), solve / r.floor);
  else
    std::printf(",,");
  if (r.discretisation_error > 0)
    std::printf("%.3e,%.3e", r.discretisation_error, r.soft_error);
  else
    std::printf(",");
  std::printf(",\n");
  std::fflush(stdout);
}

// Prints each row as soon as it is known; this project's cold ones come first in each size.
class Table {
 public:
  Table() { std::printf("%s\n", table_head); }
  void add(const Row& row) {
    if (row.method == "shellgrid cold") own_[{row.size, row.level}] = row;
    const auto found = own_.find({row.size, row.level});
    print(row, found == own_.end() ? nullptr : &found->second);
  }

 private:
  std::map<std::pair<std::string, double>, Row> own_;
};

}  // namespace shellgrid::test
