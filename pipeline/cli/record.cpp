// SPDX-License-Identifier: AGPL-3.0-or-later
#include "pipeline/cli/record.h"

#include <sys/resource.h>

#include <algorithm>
#include <cmath>
#include <filesystem>
#include <fstream>
#include <limits>

#include "meshing/formats/output_file.h"
#include "meshing/formats/output_set.h"

namespace shellgrid {
namespace {

// In parts of 1/`parts`, so that the record shows no more digits.
double rounded(double value, double parts) { return std::round(value * parts) / parts; }

}  // namespace

void PartTimer::start(const std::string& part) {
  stop();
  part_ = part;
  part_begin_ = Clock::now();
}

void PartTimer::stop() {
  if (part_.empty()) return;
  const double seconds = std::chrono::duration<double>(Clock::now() - part_begin_).count();
  bool known = false;
  for (auto& [name, sum] : parts_)
    if (name == part_) sum += seconds, known = true;
  if (!known) parts_.emplace_back(part_, seconds);
  part_.clear();
}

nlohmann::ordered_json PartTimer::seconds() const {
  nlohmann::ordered_json all = nlohmann::ordered_json::object();
  for (const auto& [name, sum] : parts_) all[name] = rounded(sum, 1e4);
  all["total"] = rounded(std::chrono::duration<double>(Clock::now() - begin_).count(), 1e4);
  return all;
}

nlohmann::ordered_json describe_file(const std::string& path) {
  const std::string now = OutputSet::present_path(path);
  nlohmann::ordered_json file = {{"path", path}, {"bytes", file_size(now)}, {"xxh64", hash_file(now)}};
  std::error_code error;
  if (std::filesystem::is_symlink(path, error)) {
    const std::filesystem::path target = std::filesystem::read_symlink(path, error);
    if (!error) file["link_to"] = target.string();
  }
  return file;
}

double peak_memory_mib() {
  // Of this program alone: getrusage would still count what its parent held before it started this one.
  std::ifstream status("/proc/self/status");
  for (std::string word; status >> word;)
    if (word == "VmHWM:") {
      double kib = 0;
      if (status >> kib) return rounded(kib / 1024, 10);
    }
  rusage usage{};
  getrusage(RUSAGE_SELF, &usage);
  return rounded(static_cast<double>(usage.ru_maxrss) / 1024, 10);
}

double available_memory_mib() {
  double available = std::numeric_limits<double>::infinity(), in_use = 0;
  const auto take = [](const char* file, const std::string& key, double& value) {
    std::ifstream lines(file);
    for (std::string word; lines >> word;)
      if (double kib = 0; word == key && lines >> kib) {
        value = kib / 1024;
        return;
      }
  };
  take("/proc/meminfo", "MemAvailable:", available);
  take("/proc/self/status", "VmSize:", in_use);
  rlimit limit{};
  if (getrlimit(RLIMIT_AS, &limit) == 0 && limit.rlim_cur != RLIM_INFINITY)
    available = std::min(available, static_cast<double>(limit.rlim_cur) / (1 << 20) - in_use);
  return available;
}

std::string shell_command(const std::vector<std::string>& arguments) {
  std::string line;
  for (const std::string& argument : arguments) {
    if (!line.empty()) line += ' ';
    const bool plain = !argument.empty() && argument.find_first_not_of(
                                                "abcdefghijklmnopqrstuvwxyzABCDEFGHIJKLMNOPQRSTUVWXYZ"
                                                "0123456789_-+=./,:@%") == std::string::npos;
    if (plain) {
      line += argument;
      continue;
    }
    line += '\'';
    for (const char character : argument) {
      if (character == '\'')
        line += "'\\''";
      else
        line += character;
    }
    line += '\'';
  }
  return line;
}

std::string record_path(const std::string& output) { return output + ".json"; }

}  // namespace shellgrid
