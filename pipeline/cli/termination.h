// SPDX-License-Identifier: AGPL-3.0-or-later
#pragma once
#include <string>
#include <vector>

namespace shellgrid {

// From now on SIGTERM, SIGINT and SIGHUP remove this process's half-written files from `folders` and then end the
// process by that signal. To be called before the first thread starts.
void clean_up_on_termination(const std::vector<std::string>& folders);

// From now on the first SIGTERM or SIGINT is only remembered: `termination_asked` says so. After
// clean_up_on_termination.
void hold_termination();
bool termination_asked();

// While one lives, a signal that would end the process waits.
class UnbrokenPart {
 public:
  UnbrokenPart();
  ~UnbrokenPart();
  UnbrokenPart(const UnbrokenPart&) = delete;
  UnbrokenPart& operator=(const UnbrokenPart&) = delete;
};

// Removes this process's half-written files from `folders`.
void remove_half_written_files(const std::vector<std::string>& folders);

}  // namespace shellgrid
