// SPDX-License-Identifier: AGPL-3.0-or-later
#include "solvers/shell_texture/symbol_coder.h"

#include <algorithm>
#include <numeric>

#include "meshing/core/error.h"

namespace shellgrid {

SymbolTable SymbolTable::from_weights(const std::vector<std::uint64_t>& weights) {
  if (weights.empty() || weights.size() > whole) throw InputError("symbols: 1 … 4096 of them");
  const std::uint64_t sum = std::accumulate(weights.begin(), weights.end(), std::uint64_t{0});
  SymbolTable table;
  const auto spare = static_cast<std::uint64_t>(whole - weights.size());
  std::uint64_t used = 0;
  for (const std::uint64_t weight : weights) {
    const std::uint64_t share =
        sum > 0 ? static_cast<std::uint64_t>(static_cast<unsigned __int128>(weight) * spare / sum) : 0;
    table.frequency_.push_back(static_cast<std::uint16_t>(1 + share));
    used += 1 + share;
  }
  // What rounding left goes to the most frequent one.
  *std::max_element(table.frequency_.begin(), table.frequency_.end()) += static_cast<std::uint16_t>(whole - used);
  table.find_starts();
  return table;
}

SymbolTable SymbolTable::from_frequencies(const std::vector<std::uint16_t>& frequencies) {
  SymbolTable table;
  table.frequency_ = frequencies;
  std::uint32_t sum = 0;
  for (const std::uint16_t f : frequencies) {
    if (f == 0) throw InputError("symbols: a frequency is zero");
    sum += f;
  }
  if (sum != whole) throw InputError("symbols: the frequencies do not sum up to 4096");
  table.find_starts();
  return table;
}

void SymbolTable::find_starts() {
  std::uint32_t start = 0;
  for (std::size_t k = 0; k < frequency_.size(); ++k) {
    start_.push_back(static_cast<std::uint16_t>(start));
    symbol_.insert(symbol_.end(), frequency_[k], static_cast<std::uint16_t>(k));
    start += frequency_[k];
  }
}

void SymbolEncoder::put(std::uint32_t start, std::uint32_t frequency) {
  // Frequencies of all 4096 slots would overflow: the state stays below 2³¹.
  const std::uint64_t limit = (std::uint64_t{1} << (23 - SymbolTable::bits + 8)) * frequency;
  while (state_ >= limit) {
    bytes_.push_back(static_cast<std::uint8_t>(state_));
    state_ >>= 8;
  }
  state_ = (state_ / frequency << SymbolTable::bits) + state_ % frequency + start;
}

void SymbolEncoder::put(const SymbolTable& table, std::uint32_t symbol) {
  put(table.start(symbol), table.frequency(symbol));
}

void SymbolEncoder::put_bits(std::uint32_t value, int bits) {
  put(value << (SymbolTable::bits - bits), 1u << (SymbolTable::bits - bits));
}

std::vector<std::uint8_t> SymbolEncoder::finish() {
  for (int k = 0; k < 4; ++k) {
    bytes_.push_back(static_cast<std::uint8_t>(state_));
    state_ >>= 8;
  }
  std::vector<std::uint8_t> bytes(bytes_.rbegin(), bytes_.rend());
  // Zeros at the end need not be kept.
  while (!bytes.empty() && bytes.back() == 0) bytes.pop_back();
  bytes_.clear();
  state_ = 1u << 23;
  return bytes;
}

}  // namespace shellgrid
