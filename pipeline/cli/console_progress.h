// SPDX-License-Identifier: AGPL-3.0-or-later
#pragma once
#include <atomic>
#include <chrono>
#include <mutex>
#include <string>
#include <vector>

#include "meshing/core/progress.h"

namespace shellgrid {

// Shows a task's progress on stderr: a bar with the time left, or one JSON object a line; redrawn ten times a second
// at most.
class ConsoleProgress : public Progress {
 public:
  enum class Display { none, bar, json };
  ConsoleProgress(std::string program, Display display);
  ~ConsoleProgress() override;

  void begin(const std::string& task, long total) override;
  void advance(long steps = 1) override;
  void end() override;
  void warn(const std::string& message) override;

  const std::vector<std::string>& warnings() const { return warnings_; }
  // Takes the bar off the terminal.
  void clear();

 private:
  using Clock = std::chrono::steady_clock;
  void draw(Clock::time_point now);
  void finish();

  const std::string program_;
  const Display display_;
  std::mutex mutex_;
  std::atomic<long> done_{0};
  std::atomic<Clock::rep> next_draw_{0};
  std::string task_;
  long total_ = 0;
  bool running_ = false, drawn_ = false;
  Clock::time_point started_{};
  std::vector<std::string> warnings_;
};

}  // namespace shellgrid
