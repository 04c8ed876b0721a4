// SPDX-License-Identifier: AGPL-3.0-or-later
#include "pipeline/cli/nearest_name.h"

#include <fmt/format.h>

#include <algorithm>
#include <cctype>
#include <cstddef>

namespace shellgrid {
namespace {

// Edit distance with swaps of neighbours ("optimal string alignment").
std::size_t edit_distance(const std::string& a, const std::string& b) {
  const std::size_t columns = b.size() + 1;
  std::vector<std::size_t> table((a.size() + 1) * columns);
  const auto at = [&](std::size_t i, std::size_t j) -> std::size_t& { return table[i * columns + j]; };
  const auto same = [&](std::size_t i, std::size_t j) {
    return std::tolower(static_cast<unsigned char>(a[i])) == std::tolower(static_cast<unsigned char>(b[j]));
  };
  for (std::size_t i = 0; i <= a.size(); ++i) at(i, 0) = i;
  for (std::size_t j = 0; j <= b.size(); ++j) at(0, j) = j;
  for (std::size_t i = 1; i <= a.size(); ++i)
    for (std::size_t j = 1; j <= b.size(); ++j) {
      at(i, j) = std::min({at(i - 1, j) + 1, at(i, j - 1) + 1, at(i - 1, j - 1) + (same(i - 1, j - 1) ? 0 : 1)});
      if (i > 1 && j > 1 && same(i - 1, j - 2) && same(i - 2, j - 1))
        at(i, j) = std::min(at(i, j), at(i - 2, j - 2) + 1);
    }
  return at(a.size(), b.size());
}

}  // namespace

std::string nearest_name(const std::string& name, const std::vector<std::string>& candidates) {
  std::string best;
  std::size_t best_distance = 0;
  if (name.size() > 200) return best;
  for (const std::string& candidate : candidates) {
    // What is typed may be a name cut short.
    const bool beginning = name.size() > 2 && candidate.starts_with(name);
    const std::size_t distance = beginning ? 1 : edit_distance(name, candidate);
    const std::size_t allowed = (2 * std::max(name.size(), candidate.size()) + 4) / 5;
    if (distance <= allowed && (best.empty() || distance < best_distance)) best = candidate, best_distance = distance;
  }
  return best;
}

std::string did_you_mean(const std::string& name, const std::vector<std::string>& candidates) {
  const std::string near = nearest_name(name, candidates);
  return near.empty() ? "" : "; did you mean " + near + "?";
}

std::string one_line(const std::string& text) {
  std::string line;
  bool gap = false;
  for (const char character : text) {
    const auto code = static_cast<unsigned char>(character);
    if (character == '\n' || character == '\r' || character == '\t') {
      gap = true;
      continue;
    }
    if (gap && !line.empty() && line.back() != ' ' && character != ' ') line += ' ';
    gap = false;
    if (code < 0x20 || code == 0x7f)
      line += fmt::format("\\x{:02x}", code);
    else
      line += character;
  }
  return line;
}

}  // namespace shellgrid
