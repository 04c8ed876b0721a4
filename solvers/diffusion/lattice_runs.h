// SPDX-License-Identifier: AGPL-3.0-or-later
// The inner points of one multigrid level in runs along x, and who couples with whom: the layout in which the solver's
// couplings are stored and read as streams.
#pragma once
#include <array>
#include <cstdint>
#include <vector>

#include "meshing/core/vec.h"

namespace shellgrid {

// Of the 26 neighbours of a lattice point the 13 that follow it in the order (z, y, x) have slots: slot 0 is +x, slots
// 1 + 3 line + (dx + 1) are those of the four following lines. A coupling is stored once, with the former point.
inline constexpr int coupling_slots = 13;
struct FollowingLine {
  int dy, dz;
};
inline constexpr FollowingLine following_lines[4] = {{1, 0}, {-1, 1}, {0, 1}, {1, 1}};

// The slot of the step to a neighbour that follows; −1 where it does not.
inline constexpr int slot_of_step(int dx, int dy, int dz) {
  if (dy == 0 && dz == 0) return dx == 1 ? 0 : -1;
  for (int line = 0; line < 4; ++line)
    if (following_lines[line].dy == dy && following_lines[line].dz == dz) return 1 + 3 * line + dx + 1;
  return -1;
}

// Consecutive unknowns at consecutive x.
struct LatticeRun {
  std::int32_t start, length;  // unknowns
  std::int32_t x, y, z;        // of the first
};

// The couplings between a run and one in a neighbouring line. At place p of the run the unknown of the other one with
// the same x is start + p + shift. For a following line entry dx + 1 belongs to the step (dx, dy, dz) from this run's
// point; for a preceding one to the step from the other's point to this run's, whose coupling stands with the other.
struct RunLink {
  std::int32_t run = -1, shift = 0;
  std::array<std::int16_t, 3> begin{}, end{};  // places of this run
  std::int8_t line = 0;
  bool follows = true;
};

// A coupling that has no slot, where parts that nearly touch come apart between levels.
struct ExtraCoupling {
  std::int32_t first, second;  // unknowns
};

struct RunLayout {
  std::vector<LatticeRun> runs;           // ascending in (z, y, x)
  std::vector<std::int32_t> run_of;       // of each unknown
  std::vector<std::int32_t> unknown_of;   // of each point; −1 for those left out
  std::vector<std::int32_t> point_of;     // of each unknown
  std::vector<RunLink> links;             // by run, those to preceding runs first
  std::vector<std::int64_t> link_start;   // runs + 1
  std::vector<ExtraCoupling> extras;      // each once
  std::vector<std::int32_t> extra_entry;  // 2·extra + (0: its first is here, 1: its second), by run
  std::vector<std::int32_t> extra_start;  // runs + 1
  std::vector<std::uint8_t> irregular;    // of each cell: some coupling of it is an extra

  std::size_t size() const { return point_of.size(); }
  // Where couplings of an unknown's slot stand: slot s, copy c of `copies` at place(u, copies) + (s·copies + c)·length.
  std::int64_t place(std::int32_t unknown, int copies) const {
    const LatticeRun& run = runs[run_of[unknown]];
    return static_cast<std::int64_t>(coupling_slots) * copies * run.start + (unknown - run.start);
  }
};

// `lattice`: of each point. `takes_part`: of each point, empty for all. `corners`: 8 points a cell, bit k of a corner's
// number towards + axis k.
RunLayout lay_out_runs(const std::vector<Vec3i>& lattice, const std::vector<char>& takes_part,
                       const std::vector<std::int32_t>& corners);

}  // namespace shellgrid
