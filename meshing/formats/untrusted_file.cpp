// SPDX-License-Identifier: AGPL-3.0-or-later
#include "meshing/formats/untrusted_file.h"

#include <fcntl.h>
#include <fmt/format.h>
#include <poll.h>
#include <signal.h>
#include <sys/mman.h>
#include <sys/resource.h>
#include <sys/wait.h>
#include <unistd.h>
#include <xxhash.h>

#include <algorithm>
#include <cerrno>
#include <chrono>
#include <cstring>
#include <fstream>
#include <memory>

#include "meshing/core/error.h"
#include "meshing/core/guarded_child.h"
#include "meshing/formats/output_file.h"

namespace shellgrid {
namespace {

constexpr bool sanitized =
#ifdef __SANITIZE_ADDRESS__
    true;
#else
    false;
#endif

// Bytes of addresses that this process has mapped.
rlim_t address_space() {
  rlim_t pages = 0;
  std::ifstream("/proc/self/statm") >> pages;
  return pages * static_cast<rlim_t>(::sysconf(_SC_PAGESIZE));
}

void limit(int resource, rlim_t amount) {
  rlimit bound{amount, amount};
  rlimit present;
  if (::getrlimit(static_cast<__rlimit_resource>(resource), &present) == 0 && present.rlim_max < amount)
    bound = {present.rlim_max, present.rlim_max};
  ::setrlimit(static_cast<__rlimit_resource>(resource), &bound);
}

// The child: never returns. Writes 'k' for a good file or 'e' and a message.
[[noreturn]] void rehearse(int pipe_end, rlim_t memory, rlim_t seconds, const std::function<void()>& read) {
  enter_guarded_child();
  // A sanitizer reports crashes by its own handlers.
  if (!sanitized)
    for (int number : {SIGSEGV, SIGABRT, SIGBUS, SIGFPE, SIGILL}) ::signal(number, SIG_DFL);
  for (int number : {SIGINT, SIGTERM}) ::signal(number, SIG_DFL);
  const int nowhere = ::open("/dev/null", O_RDWR), warnings = ::memfd_create("warnings", 0);
  if (nowhere >= 0) ::dup2(nowhere, STDOUT_FILENO);
  if (warnings >= 0) ::dup2(warnings, STDERR_FILENO);
  limit(RLIMIT_CORE, 0);
  limit(RLIMIT_CPU, seconds);
  limit(RLIMIT_AS, memory);
  std::string verdict = "k";
  try {
    read();
  } catch (const std::exception& error) {
    verdict = std::string("e") + error.what();
  } catch (...) {
    verdict = "e";
  }
  // What a library warns about it would print again in the parent: such files are refused.
  char warning[1000];
  const ssize_t warned = verdict == "k" && warnings >= 0 ? ::pread(warnings, warning, sizeof warning, 0) : 0;
  if (warned > 0) verdict = "e" + std::string(warning, static_cast<std::size_t>(warned));
  const ssize_t put = ::write(pipe_end, verdict.data(), std::min<std::size_t>(verdict.size(), 4000));
  ::_exit(put > 0 ? 0 : 1);
}

}  // namespace

std::string seal_of(std::string_view bytes, std::string_view more_bytes) {
  const std::unique_ptr<XXH3_state_t, XXH_errorcode (*)(XXH3_state_t*)> state(XXH3_createState(), XXH3_freeState);
  XXH3_128bits_reset(state.get());
  XXH3_128bits_update(state.get(), bytes.data(), bytes.size());
  if (!more_bytes.empty()) XXH3_128bits_update(state.get(), more_bytes.data(), more_bytes.size());
  const XXH128_hash_t hash = XXH3_128bits_digest(state.get());
  return fmt::format("{:016x}{:016x}", hash.high64, hash.low64);
}

std::string one_line(std::string message) {
  for (char& c : message)
    if (static_cast<unsigned char>(c) < ' ' || c == 127) c = ' ';
  message.erase(std::find_if(message.rbegin(), message.rend(), [](char c) { return c != ' '; }).base(), message.end());
  if (message.size() > 300) message.resize(300);
  return message;
}

void rehearse_reading(const std::string& path, const std::string& kind, const std::function<void()>& read) {
  const std::uint64_t bytes = file_size(path);
  // On top of what this process has: compressed grids rarely grow more than sixtyfold.
  const rlim_t memory = address_space() + (rlim_t{512} << 20) + 64 * bytes;
  const int seconds = 4 + static_cast<int>(bytes / 20'000'000);
  int ends[2];
  if (::pipe2(ends, O_CLOEXEC) != 0) throw InternalError(fmt::format("pipe: {}", std::strerror(errno)));
  const pid_t child = ::fork();
  if (child < 0) {
    ::close(ends[0]), ::close(ends[1]);
    throw InternalError(fmt::format("fork: {}", std::strerror(errno)));
  }
  if (child == 0) rehearse(ends[1], memory, static_cast<rlim_t>(seconds), read);
  ::close(ends[1]);
  std::string verdict;
  const auto deadline = std::chrono::steady_clock::now() + std::chrono::seconds(20 * seconds);
  for (;;) {
    const auto left =
        std::chrono::duration_cast<std::chrono::milliseconds>(deadline - std::chrono::steady_clock::now()).count();
    pollfd waiting{ends[0], POLLIN, 0};
    const int ready = left <= 0 ? 0 : ::poll(&waiting, 1, static_cast<int>(left));
    if (ready < 0 && errno == EINTR) continue;
    if (ready <= 0) break;
    char block[4096];
    const ssize_t got = ::read(ends[0], block, sizeof block);
    if (got < 0 && errno == EINTR) continue;
    if (got <= 0) break;
    verdict.append(block, static_cast<std::size_t>(got));
  }
  ::close(ends[0]);
  ::kill(child, SIGKILL);
  int status = 0;
  while (::waitpid(child, &status, 0) < 0 && errno == EINTR) {
  }
  if (verdict == "k") return;
  if (verdict.size() > 1 && verdict[0] == 'e') {
    const std::string message = one_line(verdict.substr(1));
    if (message.rfind(path, 0) == 0) throw InputError(message);
    throw InputError(fmt::format("{}: not a readable {} file: {}", path, kind, message));
  }
  throw InputError(
      fmt::format("{}: this {} file is corrupt (reading it crashed, or took too much memory or time)", path, kind));
}

}  // namespace shellgrid
