// SPDX-License-Identifier: AGPL-3.0-or-later
// How a program ends when something goes wrong: one line and an exit code.
#pragma once
#include <exception>
#include <string>
#include <vector>

namespace shellgrid {

struct Failure {
  int code;             // 1 internal fault, 2 usage, 3 bad or missing input, or too little memory, 4 numerical failure
  std::string message;  // one line
};

// What an exception means to the caller of `program`.
Failure describe_failure(const std::string& program, const std::exception_ptr& error);

// From now on an exception that nobody can catch (in a thread of a library, in a destructor) ends the program like any
// other: with one line and an exit code, and without this process's half-written files in `folders`.
void end_cleanly_on_uncaught_exceptions(const std::string& program, const std::vector<std::string>& folders);

}  // namespace shellgrid
