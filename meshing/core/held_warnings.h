// SPDX-License-Identifier: AGPL-3.0-or-later
#pragma once
#include <string>
#include <vector>

#include "meshing/core/progress.h"

namespace shellgrid {

// Passes tasks on and keeps warnings back: of several attempts only those of the one that is taken are said.
class HeldWarnings : public Progress {
 public:
  explicit HeldWarnings(Progress& progress) : progress_(progress) {}
  void begin(const std::string& task, long total) override { progress_.begin(task, total); }
  void advance(long steps) override { progress_.advance(steps); }
  void end() override { progress_.end(); }
  void warn(const std::string& message) override { warnings.push_back(message); }

  std::vector<std::string> warnings;

 private:
  Progress& progress_;
};

}  // namespace shellgrid
