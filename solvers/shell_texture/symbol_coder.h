// SPDX-License-Identifier: AGPL-3.0-or-later
// Entropy coding of small whole numbers with fixed tables.
#pragma once
#include <cstddef>
#include <cstdint>
#include <vector>

namespace shellgrid {

// Of symbols 0 … n−1 the frequencies, with sum 2¹² and none zero, and where a slot's symbol is found.
// Throws: InputError for more than 2¹² symbols or, in restore, for frequencies that do not sum up.
class SymbolTable {
 public:
  static constexpr int bits = 12;
  static constexpr std::uint32_t whole = 1u << bits;

  SymbolTable() = default;
  // In proportion to weights, at least one each.
  static SymbolTable from_weights(const std::vector<std::uint64_t>& weights);
  static SymbolTable from_frequencies(const std::vector<std::uint16_t>& frequencies);

  std::size_t size() const { return frequency_.size(); }
  std::uint32_t frequency(std::uint32_t symbol) const { return frequency_[symbol]; }
  std::uint32_t start(std::uint32_t symbol) const { return start_[symbol]; }
  std::uint32_t symbol_at(std::uint32_t slot) const { return symbol_[slot]; }

 private:
  void find_starts();
  std::vector<std::uint16_t> frequency_, start_, symbol_;
};

// Symbols are put in reverse and taken forward. Source: range variant of asymmetric numeral systems [Duda2013].
class SymbolEncoder {
 public:
  void put(const SymbolTable& table, std::uint32_t symbol);
  void put_bits(std::uint32_t value, int bits);  // evenly distributed; at most 12
  // What a decoder reads; begins anew.
  std::vector<std::uint8_t> finish();

 private:
  void put(std::uint32_t start, std::uint32_t frequency);
  std::uint32_t state_ = 1u << 23;
  std::vector<std::uint8_t> bytes_;  // last first
};

// Never reads beyond `end`: there it goes on with zeros.
class SymbolDecoder {
 public:
  SymbolDecoder(const std::uint8_t* begin, const std::uint8_t* end) : at_(begin), end_(end) {
    for (int k = 0; k < 4; ++k) state_ = state_ << 8 | next();
  }
  std::uint32_t take(const SymbolTable& table) {
    const std::uint32_t slot = state_ & (SymbolTable::whole - 1), symbol = table.symbol_at(slot);
    advance(table.start(symbol), table.frequency(symbol), slot);
    return symbol;
  }
  std::uint32_t take_bits(int bits) {
    const std::uint32_t slot = state_ & (SymbolTable::whole - 1), value = slot >> (SymbolTable::bits - bits);
    advance(value << (SymbolTable::bits - bits), 1u << (SymbolTable::bits - bits), slot);
    return value;
  }

 private:
  std::uint32_t next() { return at_ < end_ ? *at_++ : 0; }
  void advance(std::uint32_t start, std::uint32_t frequency, std::uint32_t slot) {
    state_ = frequency * (state_ >> SymbolTable::bits) + slot - start;
    while (state_ < 1u << 23) {
      state_ = state_ << 8 | next();
      if (state_ == 0) state_ = 1u << 23;  // of damaged bytes
    }
  }
  const std::uint8_t *at_, *end_;
  std::uint32_t state_ = 0;
};

}  // namespace shellgrid
