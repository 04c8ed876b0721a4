// SPDX-License-Identifier: AGPL-3.0-or-later
#pragma once
#include <string>
#include <vector>

namespace shellgrid {

struct RunReport {
  std::string html;  // one page, pictures inside it, no scripts
  int stages = 0, stages_made = 0, pictures = 0;
  double seconds = 0;          // of all recorded stages
  double peak_memory_mib = 0;  // of the largest
};

// The run of a scene on one page: each stage's picture, figures, time, memory and the command that remakes it, and why
// the others were left out. It holds no path of this machine.
// Throws: InputError where the folder holds no plan or a record or mesh in it is damaged.
RunReport report_run(const std::string& folder);

}  // namespace shellgrid
