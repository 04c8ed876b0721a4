// SPDX-License-Identifier: AGPL-3.0-or-later
#pragma once
#include <string>

#include "solvers/transport/path_tally.h"

namespace shellgrid {

// What light paths have gathered, in a file, bit by bit; `fingerprint` is of all inputs and options that they depend
// on. Throws: InputError.
void write_path_state(const std::string& path, const std::string& fingerprint, const PathState& state);

// The state, of the same sizes as `expected`. Throws: InputError for a damaged file or one of another fingerprint.
PathState read_path_state(const std::string& path, const std::string& fingerprint, const PathState& expected);

}  // namespace shellgrid
