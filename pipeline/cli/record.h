// SPDX-License-Identifier: AGPL-3.0-or-later
// How an output came about: what lands in `OUTPUT.json` beside it.
#pragma once
#include <chrono>
#include <string>
#include <utility>
#include <vector>

#include <nlohmann/json.hpp>

namespace shellgrid {

// Seconds of named parts of a run, in the order they were first started.
class PartTimer {
 public:
  void start(const std::string& part);
  void stop();
  nlohmann::ordered_json seconds() const;  // parts and "total"

 private:
  using Clock = std::chrono::steady_clock;
  Clock::time_point begin_ = Clock::now(), part_begin_{};
  std::string part_;
  std::vector<std::pair<std::string, double>> parts_;
};

// {path, bytes, xxh64}, and link_to where the path is a symbolic link. Throws: InputError.
nlohmann::ordered_json describe_file(const std::string& path);

// This process's peak resident memory.
double peak_memory_mib();
// What this process may still take, MiB: what the machine can spare and its limits allow.
double available_memory_mib();

// Arguments as a line that a shell reads back as the same arguments.
std::string shell_command(const std::vector<std::string>& arguments);

// "OUTPUT.json".
std::string record_path(const std::string& output);

}  // namespace shellgrid
