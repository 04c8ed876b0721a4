// SPDX-License-Identifier: AGPL-3.0-or-later
#include "pipeline/cli/failure.h"

#include <fmt/format.h>
#include <unistd.h>

#include <algorithm>
#include <atomic>
#include <cstdlib>
#include <filesystem>
#include <memory>
#include <new>
#include <system_error>
#include <vector>

#include "meshing/core/error.h"
#include "pipeline/cli/nearest_name.h"
#include "pipeline/cli/option_table.h"
#include "pipeline/cli/record.h"
#include "pipeline/cli/termination.h"

namespace shellgrid {
namespace {

constexpr const char* out_of_memory = "out of memory; try a coarser grid (larger voxel or spacing, fewer nodes)";

// Threads need memory, too: where there is none left, they cannot start.
bool is_shortage(const std::system_error& error) {
  return error.code() == std::errc::resource_unavailable_try_again || error.code() == std::errc::not_enough_memory;
}

bool is_shortage(const std::exception_ptr& error) {
  try {
    std::rethrow_exception(error);
  } catch (const std::bad_alloc&) {
    return true;
  } catch (const std::system_error& system) {
    return is_shortage(system);
  } catch (const std::exception& other) {
    // TBB throws its own kind where a thread cannot start.
    return std::string_view(other.what()).find("Resource temporarily unavailable") != std::string_view::npos;
  } catch (...) {
    return false;
  }
}

// What the handler of uncaught exceptions needs, made while there is memory.
struct LastWords {
  std::string program, shortage_line, fault_line;
  std::vector<std::string> folders;
  std::unique_ptr<char[]> reserve;
};
LastWords* last_words = nullptr;

void say(const std::string& line) {
  if (::write(STDERR_FILENO, line.data(), line.size()) < 0) return;
}

[[noreturn]] void end_program() {
  static std::atomic_flag ending = ATOMIC_FLAG_INIT;
  static std::atomic<int> code = 1;
  static bool has_spoken = false;
  thread_local bool is_ending_it = false;
  constexpr unsigned patience = 10;  // seconds
  if (is_ending_it) {
    // What ends the program failed itself, where no exception may pass.
    if (!has_spoken) say(last_words->fault_line);
    ::_exit(code);
  }
  if (ending.test_and_set()) {
    // Another thread already ends it, unless it waits for what it will not get.
    for (unsigned left = patience; left > 0;) left = ::sleep(left);
    ::_exit(code);
  }
  is_ending_it = true;
  const std::exception_ptr error = std::current_exception();
  if (error && is_shortage(error)) {
    code = 3;
    say(last_words->shortage_line);
    has_spoken = true;
  }
  last_words->reserve.reset();
  try {
    if (code != 3) {
      const Failure failure = error ? describe_failure(last_words->program, error) : Failure{code, {}};
      code = failure.code;
      say(error ? failure.message + "\n" : last_words->fault_line);
      has_spoken = true;
    }
    remove_half_written_files(last_words->folders);
  } catch (...) {
    // The next run removes them.
  }
  ::_exit(code);
}

// A history of many numbers as its first and last few.
std::string shortened(const std::string& text) {
  constexpr std::size_t most = 9, shown = 3;
  const auto is_number = [](const std::string& word) {
    if (word.empty()) return false;
    char* end = nullptr;
    std::strtod(word.c_str(), &end);
    return *end == '\0';
  };
  std::vector<std::string> words;
  for (std::size_t at = 0; at <= text.size();) {
    const std::size_t end = std::min(text.find(' ', at), text.size());
    words.push_back(text.substr(at, end - at));
    at = end + 1;
  }
  std::vector<std::string> kept;
  for (std::size_t i = 0; i < words.size();) {
    std::size_t end = i;
    while (end < words.size() && is_number(words[end])) ++end;
    if (end - i <= most) {
      end = std::max(end, i + 1);
      kept.insert(kept.end(), words.begin() + i, words.begin() + end);
    } else {
      kept.insert(kept.end(), words.begin() + i, words.begin() + i + shown);
      kept.push_back(fmt::format("… ({} in all) …", end - i));
      kept.insert(kept.end(), words.begin() + end - shown, words.begin() + end);
    }
    i = end;
  }
  return fmt::format("{}", fmt::join(kept, " "));
}

}  // namespace

Failure describe_failure(const std::string& program, const std::exception_ptr& error) {
  const auto failure = [&](int code, const std::string& message) {
    return Failure{code, program + ": error: " + one_line(message)};
  };
  if (is_shortage(error))
    return failure(3, fmt::format("out of memory, {} MiB in use; try a coarser grid (larger voxel or spacing, fewer "
                                  "nodes)",
                                  peak_memory_mib()));
  try {
    std::rethrow_exception(error);
  } catch (const UsageError& usage) {
    return failure(2, std::string(usage.what()) + " (" + program + " --help explains)");
  } catch (const InputError& input) {
    return failure(3, input.what());
  } catch (const NumericalError& numerical) {
    return failure(4, shortened(numerical.what()));
  } catch (const std::filesystem::filesystem_error& file) {
    return failure(3, file.what());
  } catch (const std::exception& other) {
    return failure(1, std::string("internal fault: ") + other.what());
  } catch (...) {
    return failure(1, "internal fault: unknown exception");
  }
}

void end_cleanly_on_uncaught_exceptions(const std::string& program, const std::vector<std::string>& folders) {
  constexpr std::size_t reserve_bytes = std::size_t{4} << 20;
  // Never given back: threads may fail while the program already ends.
  static LastWords words;
  words = {program, program + ": error: " + out_of_memory + "\n",
           program + ": error: internal fault: no way to go on\n", folders, std::make_unique<char[]>(reserve_bytes)};
  last_words = &words;
  std::set_terminate(end_program);
}

}  // namespace shellgrid
