// SPDX-License-Identifier: AGPL-3.0-or-later
#pragma once
#include <cstdint>
#include <map>
#include <string>
#include <vector>

namespace shellgrid {

// Named lists of numbers in one file, bit by bit as they are in memory: what a program needs to go on where it stopped.
struct NumberArchive {
  std::string kind;         // what the numbers are
  std::string fingerprint;  // of what they belong to
  std::map<std::string, std::vector<double>> numbers;
  std::map<std::string, std::vector<std::uint64_t>> counts;
};

// A line of text, `shellgrid numbers 1`, then little-endian lengths, names and values, then a hash of all that.
// Appears whole or not at all. Throws: InputError.
void write_number_archive(const std::string& path, const NumberArchive& archive);

// Throws: InputError for a file that is no such archive, or damaged.
NumberArchive read_number_archive(const std::string& path);

}  // namespace shellgrid
