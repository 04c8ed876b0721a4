// SPDX-License-Identifier: AGPL-3.0-or-later
#include "meshing/polycube/stair_annealing.h"

#include <array>
#include <cmath>

#include "meshing/core/random.h"

namespace shellgrid {
namespace {

// What a lattice point's window adds to the cost: a singular edge 1, shared by its two ends, excess valence and a
// corner that cannot see its faces.
const std::array<float, 256>& window_costs() {
  static const std::array<float, 256> table = [] {
    std::array<float, 256> costs{};
    for (int window = 1; window < 255; ++window) {
      double cost = 0.5 * std::abs(boundary_valence(window) - 4) + (has_visible_normal(window) ? 0 : 2);
      for (int half : {0x55, 0xaa, 0x33, 0xcc, 0x0f, 0xf0}) {
        const int filled = __builtin_popcount(static_cast<unsigned>(window & half));
        if (filled == 1 || filled == 3) cost += 0.5;
      }
      costs[window] = static_cast<float>(cost);
    }
    return costs;
  }();
  return table;
}

unsigned blocks_around(const BlockGrid& grid, std::size_t b) {
  const std::size_t row = grid.size.x(), layer = row * grid.size.y();
  unsigned around = 0;
  int bit = 0;
  for (std::size_t z : {b - layer, b, b + layer})
    for (std::size_t y : {z - row, z, z + row})
      for (std::size_t x : {y - 1, y, y + 1}) around |= static_cast<unsigned>(grid.filled[x] != 0) << bit++;
  return around;
}

}  // namespace

void anneal_stairs(BlockGrid& grid, const std::vector<double>& fill_cost, const std::vector<std::size_t>& blocks,
                   const BlockParts& parts, BlockCover& inner, BlockCover& outer, int sweeps) {
  const std::array<float, 256>& costs = window_costs();
  for (int sweep = 0; sweep < sweeps; ++sweep) {
    const double temperature = 1.5 * std::pow(1 - static_cast<double>(sweep) / sweeps, 1.5);
    for (std::size_t b : blocks) {
      const unsigned around = blocks_around(grid, b);
      if (around == 0 || around == (1u << 27) - 1) continue;
      const bool fills = !grid.filled[b];
      double change = fills ? fill_cost[b] : -fill_cost[b];
      for (int corner = 0; corner < 8; ++corner) {
        const int window = window_of(around, corner);
        change += costs[window ^ 1 << (7 - corner)] - costs[window];
      }
      if (change > 0 && to_unit(hash64(0x57a125u, sweep, b)) >= std::exp(-change / temperature)) continue;
      if (!is_simple_flip(around)) continue;
      BlockCover& lost = fills ? outer : inner;
      BlockCover& gained = fills ? inner : outer;
      if (lost.is_needed(b)) continue;
      if (fills && parts.joins_parts(grid, grid.place(b))) continue;
      lost.remove(b);
      gained.add(b);
      grid.filled[b] ^= 1;
    }
  }
}

}  // namespace shellgrid
