// SPDX-License-Identifier: AGPL-3.0-or-later
// Lists of small values within a number archive, byte by byte.
#pragma once
#include <algorithm>
#include <cstdint>
#include <cstring>
#include <string>
#include <vector>

#include "meshing/core/error.h"
#include "meshing/formats/number_archive.h"

namespace shellgrid {

[[noreturn]] inline void fail_lists(const std::string& path) {
  throw InputError(path + ": is damaged: its lists do not fit");
}

template <class T>
void put_list(NumberArchive& archive, const std::string& name, const std::vector<T>& values) {
  std::vector<std::uint64_t>& words = archive.counts[name];
  words.assign((values.size() * sizeof(T) + 7) / 8, 0);
  if (!values.empty()) std::memcpy(words.data(), values.data(), values.size() * sizeof(T));
}

// Throws: InputError where the list is missing or of another length.
template <class T>
std::vector<T> take_list(const NumberArchive& archive, const std::string& name, std::size_t count,
                         const std::string& path) {
  const auto found = archive.counts.find(name);
  if (found == archive.counts.end() || found->second.size() != (count * sizeof(T) + 7) / 8) fail_lists(path);
  std::vector<T> values(count);
  if (count > 0) std::memcpy(values.data(), found->second.data(), count * sizeof(T));
  return values;
}

// Sizes of a grid along x, y, z, then others; none beyond what anyone would write.
inline std::vector<std::uint64_t> take_sizes(const NumberArchive& archive, const std::string& name, std::size_t count,
                                             const std::string& path) {
  const std::vector<std::uint64_t> sizes = take_list<std::uint64_t>(archive, name, count, path);
  for (std::size_t k = 0; k < count; ++k)
    if (sizes[k] > (k < 3 ? 4096u : k < 5 ? 100'000u : 4'000'000'000u)) fail_lists(path);
  const double places = static_cast<double>(sizes[0]) * static_cast<double>(sizes[1]) * static_cast<double>(sizes[2]);
  if (!(places >= 1 && places <= 2e8)) fail_lists(path);
  return sizes;
}

inline std::vector<std::uint8_t> packed_bits(const std::vector<char>& flags) {
  std::vector<std::uint8_t> bits((flags.size() + 7) / 8);
  for (std::size_t k = 0; k < flags.size(); ++k)
    if (flags[k]) bits[k / 8] |= static_cast<std::uint8_t>(1u << (k % 8));
  return bits;
}

inline std::vector<char> unpacked_bits(const std::vector<std::uint8_t>& bits, std::size_t count) {
  std::vector<char> flags(count);
  for (std::size_t k = 0; k < count; ++k) flags[k] = static_cast<char>(bits[k / 8] >> (k % 8) & 1);
  return flags;
}

inline void check_offsets(const std::vector<std::uint32_t>& offset, std::size_t bytes, const std::string& path) {
  if (offset.front() != 0 || offset.back() != bytes || !std::is_sorted(offset.begin(), offset.end())) fail_lists(path);
}

}  // namespace shellgrid
