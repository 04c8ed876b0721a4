// SPDX-License-Identifier: AGPL-3.0-or-later
// What libraries throw. They never print and never exit: only the programs' `run_stage` catches.
#pragma once
#include <stdexcept>
#include <string>

namespace shellgrid {

// The input is missing, malformed or out of range (exit code 3). The message is one line: what is
// wrong, where, and what to try.
struct InputError : std::runtime_error {
  using std::runtime_error::runtime_error;
};

// The computation did not reach its stated accuracy (exit code 4).
struct NumericalError : std::runtime_error {
  using std::runtime_error::runtime_error;
};

// An invariant of the program is broken: a bug (exit code 1).
struct InternalError : std::logic_error {
  using std::logic_error::logic_error;
};

// Runs a call; an InputError it throws is given the file's name in front: `bunny.ply: 14 boundary edges …`.
template <class Call>
auto naming(const std::string& path, const Call& call) {
  try {
    return call();
  } catch (const InputError& error) {
    throw InputError(path + ": " + error.what());
  }
}

}  // namespace shellgrid
