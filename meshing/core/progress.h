// SPDX-License-Identifier: AGPL-3.0-or-later
// The library reports progress, the program displays it.
#pragma once
#include <string>

namespace shellgrid {

// Receives progress of one task at a time. Calls may come from several threads.
class Progress {
 public:
  virtual ~Progress() = default;
  // Starts a task of `total` equal steps (0: unknown).
  virtual void begin(const std::string& task, long total) { (void)task, (void)total; }
  virtual void advance(long steps = 1) { (void)steps; }
  virtual void end() {}
  // Says a remarkable thing once; it lands in the record's warnings and on stderr.
  virtual void warn(const std::string& message) { (void)message; }
};

// Swallows everything; the default argument of library functions.
Progress& no_progress();

}  // namespace shellgrid
