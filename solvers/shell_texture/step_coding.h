// SPDX-License-Identifier: AGPL-3.0-or-later
// Whole steps about 0 as symbols: classes of how widely they are spread, each with its table.
#pragma once
#include <algorithm>
#include <cstdint>
#include <vector>

#include "solvers/shell_texture/symbol_coder.h"

namespace shellgrid {

constexpr int spreads = 40;  // classes of spread; 0: all steps are zero
// The class of steps of that mean magnitude.
std::uint8_t spread_of(double mean);
// By class; that of 0 is empty.
std::vector<SymbolTable> step_tables();

// A block's steps are spread more or less widely than those of other blocks: for each group of components it says by
// how many classes.
constexpr int shift_group = 6, shift_bits = 3, shifts = 1 << shift_bits, shift_step = 3, no_shift = 5;
inline std::uint8_t shifted(std::uint8_t spread, int shift) {
  return static_cast<std::uint8_t>(std::clamp(spread + shift_step * (shift - no_shift), 1, spreads - 1));
}

// What a step is coded as; steps beyond the tables are written out after it.
std::uint32_t symbol_of(int step);
// Bits that each class's symbols take.
std::vector<std::vector<float>> symbol_lengths(const std::vector<SymbolTable>& tables);

void put_step(SymbolEncoder& encoder, const SymbolTable& table, int step);
int take_step(SymbolDecoder& decoder, const SymbolTable& table);

}  // namespace shellgrid
