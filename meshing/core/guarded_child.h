// SPDX-License-Identifier: AGPL-3.0-or-later
// Guarded children: processes forked to call a library that may crash on what it is given, and whose death the parent
// expects. A build with sanitizers tells the library's faults there apart from our own by which of the two ran.
#pragma once
#include <cstddef>

namespace shellgrid {

// To be called in the child, right after the fork.
void enter_guarded_child();

// Writes all the bytes, for a child's answer through a pipe; false where that fails.
bool write_all(int file, const void* data, std::size_t bytes);

// While one lives in a guarded child, code of a library runs: reports of the sanitizers go to LOG_PATH-foreign instead
// of LOG_PATH. In any other process, and without sanitizers or a log path, it does nothing. One at a time.
class ForeignCode {
 public:
  ForeignCode();
  ~ForeignCode();
  ForeignCode(const ForeignCode&) = delete;
  ForeignCode& operator=(const ForeignCode&) = delete;
};

}  // namespace shellgrid
