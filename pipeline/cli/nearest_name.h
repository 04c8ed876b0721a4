// SPDX-License-Identifier: AGPL-3.0-or-later
#pragma once
#include <string>
#include <vector>

namespace shellgrid {

// The candidate with the least edit distance to `name` (insertions, deletions, substitutions and swaps of neighbours,
// case ignored), or empty where none is near: more than 2/5 of the longer name, rounded up, would have to change.
std::string nearest_name(const std::string& name, const std::vector<std::string>& candidates);

// "; did you mean NAME?" or empty.
std::string did_you_mean(const std::string& name, const std::vector<std::string>& candidates);

// A text as one line: runs of line breaks and tabs become one space, other control characters \xNN.
std::string one_line(const std::string& text);

}  // namespace shellgrid
