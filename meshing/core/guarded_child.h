// SPDX-License-Identifier: AGPL-3.0-or-later
// Guarded children: processes forked to call a library that may crash on what it is given, and whose death the parent
// expects. A build with sanitizers tells the library's faults there apart from our own by which of the two ran.
#pragma once
#include <cstddef>
#include <functional>
#include <string>

namespace shellgrid {

// To be called in the child, right after the fork; run_guarded does.
void enter_guarded_child();

// Writes all the bytes, for a child's answer through a pipe; false where that fails.
bool write_all(int file, const void* data, std::size_t bytes);

// Lowers a limit of this process, RLIMIT_DATA or another, for good; never raises it.
void lower_limit(int resource, std::size_t amount);

struct GuardedAnswer {
  std::string bytes;         // what the child wrote
  bool finished = false;     // it ended by itself, with work() true
  bool out_of_time = false;  // of the processor or of the clock
  double seconds = 0;        // of the processor that it used
};

// Calls work(pipe) in a guarded child, whose answer is what it writes into the pipe. There standard output and error go
// nowhere, signals do what they do by default, and no core is left behind; an exception counts as false.
// seconds: of the processor, rounded up; clock_seconds: after which the child is killed.
// Throws: InputError where no child can be started.
GuardedAnswer run_guarded(double seconds, double clock_seconds, const std::function<bool(int pipe)>& work);

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
