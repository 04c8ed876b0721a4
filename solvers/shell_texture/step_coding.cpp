// SPDX-License-Identifier: AGPL-3.0-or-later
#include "solvers/shell_texture/step_coding.h"

#include <cmath>
#include <cstdlib>

namespace shellgrid {
namespace {

constexpr int largest_step = 60;  // beyond it steps are written out
constexpr std::uint32_t escape = 2 * largest_step + 1;
constexpr int escape_bits = 12, escape_parts = 2;
constexpr double spread_ratio = 1.35;  // of one class to the next
constexpr double least_mean = 0.002;   // magnitude of the first class

// Frequencies of steps whose magnitude falls by a constant ratio: whole numbers alone, the same on every machine.
SymbolTable geometric_table(int spread) {
  double mean = least_mean;
  for (int k = 1; k < spread; ++k) mean *= spread_ratio;
  const double ratio = (std::sqrt(1 + mean * mean) - 1) / mean;
  const auto fall = static_cast<std::uint64_t>(std::lround(ratio * 65536));
  std::vector<std::uint64_t> weights(escape + 1);
  std::uint64_t weight = std::uint64_t{1} << 40;
  for (int q = 0; q <= largest_step; ++q) {
    if (q == 0) {
      weights[0] = weight;
    } else {
      weights[2 * q - 1] = weights[2 * q] = weight;
    }
    weight = weight * fall >> 16;
  }
  weights[escape] = 2 * weight;
  return SymbolTable::from_weights(weights);
}

int step_of(std::uint32_t symbol) {
  const int magnitude = static_cast<int>(symbol + 1) / 2;
  return symbol % 2 == 1 ? magnitude : -magnitude;
}

}  // namespace

std::uint8_t spread_of(double mean) {
  if (!(mean > 0)) return 0;
  const double at = std::log(mean / least_mean) / std::log(spread_ratio);
  return static_cast<std::uint8_t>(std::clamp(static_cast<int>(std::lround(at)) + 1, 1, spreads - 1));
}

std::vector<SymbolTable> step_tables() {
  std::vector<SymbolTable> tables(1);
  for (int k = 1; k < spreads; ++k) tables.push_back(geometric_table(k));
  return tables;
}

std::uint32_t symbol_of(int step) {
  if (step == 0) return 0;
  const int magnitude = std::abs(step);
  if (magnitude > largest_step) return escape;
  return static_cast<std::uint32_t>(2 * magnitude - (step > 0 ? 1 : 0));
}

std::vector<std::vector<float>> symbol_lengths(const std::vector<SymbolTable>& tables) {
  std::vector<std::vector<float>> lengths;
  for (const SymbolTable& table : tables) {
    lengths.emplace_back();
    for (std::uint32_t symbol = 0; symbol < table.size(); ++symbol)
      lengths.back().push_back(static_cast<float>(SymbolTable::bits) -
                               std::log2(static_cast<float>(table.frequency(symbol))));
  }
  return lengths;
}

// What is decoded first is put last.
void put_step(SymbolEncoder& encoder, const SymbolTable& table, int step) {
  const std::uint32_t symbol = symbol_of(step);
  if (symbol == escape) {
    const auto zigzag = static_cast<std::uint32_t>(step > 0 ? 2 * step : -2 * step + 1);
    for (int part = escape_parts - 1; part >= 0; --part)
      encoder.put_bits(zigzag >> (escape_bits * part) & ((1u << escape_bits) - 1), escape_bits);
  }
  encoder.put(table, symbol);
}

int take_step(SymbolDecoder& decoder, const SymbolTable& table) {
  const std::uint32_t symbol = decoder.take(table);
  if (symbol != escape) return step_of(symbol);
  std::uint32_t zigzag = 0;
  for (int part = 0; part < escape_parts; ++part) zigzag |= decoder.take_bits(escape_bits) << (escape_bits * part);
  return zigzag % 2 == 0 ? static_cast<int>(zigzag / 2) : -static_cast<int>(zigzag / 2);
}

}  // namespace shellgrid
