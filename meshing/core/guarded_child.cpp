// SPDX-License-Identifier: AGPL-3.0-or-later
#include "meshing/core/guarded_child.h"

#include <fcntl.h>
#include <poll.h>
#include <sys/resource.h>
#include <sys/wait.h>
#include <unistd.h>

#include <algorithm>
#include <cerrno>
#include <chrono>
#include <cmath>
#include <csignal>
#include <cstdlib>
#include <cstring>
#include <exception>

#include "meshing/core/error.h"

#ifdef __SANITIZE_ADDRESS__
#include <sanitizer/common_interface_defs.h>

#include <cstdlib>
#include <string>

// Of the runtime library of GCC's undefined-behaviour sanitizer, which would otherwise start, and reset the path of
// reports, at its first report.
namespace __ubsan {
void InitAsStandaloneIfNecessary() __attribute__((weak));
}

namespace shellgrid {
namespace {

// Empty outside guarded children.
std::string log_path;

void report_to(const std::string& path) {
  if (!path.empty()) __sanitizer_set_report_path(path.c_str());
}

}  // namespace

void enter_guarded_child() {
  std::set_terminate([] { std::abort(); });  // the parent's handler would speak for the child
  if (__ubsan::InitAsStandaloneIfNecessary != nullptr) __ubsan::InitAsStandaloneIfNecessary();
  const char* text = std::getenv("ASAN_OPTIONS");
  const std::string options = text != nullptr ? text : "", key = "log_path=";
  const std::size_t at = options.find(key);
  if (at == std::string::npos) return;
  const std::size_t from = at + key.size();
  log_path = options.substr(from, options.find(':', from) - from);
}

ForeignCode::ForeignCode() { report_to(log_path.empty() ? log_path : log_path + "-foreign"); }
ForeignCode::~ForeignCode() { report_to(log_path); }

}  // namespace shellgrid
#else
namespace shellgrid {

void enter_guarded_child() {
  std::set_terminate([] { std::abort(); });  // the parent's handler would speak for the child
}
ForeignCode::ForeignCode() {}
ForeignCode::~ForeignCode() {}

}  // namespace shellgrid
#endif

namespace shellgrid {

bool write_all(int file, const void* data, std::size_t bytes) {
  const char* at = static_cast<const char*>(data);
  while (bytes > 0) {
    const ssize_t written = ::write(file, at, bytes);
    if (written < 0 && errno == EINTR) continue;
    if (written <= 0) return false;
    at += written;
    bytes -= static_cast<std::size_t>(written);
  }
  return true;
}

namespace {

constexpr bool sanitized =
#ifdef __SANITIZE_ADDRESS__
    true;
#else
    false;
#endif

[[noreturn]] void run_child(double seconds, int pipe, const std::function<bool(int)>& work) {
  enter_guarded_child();
  // A sanitizer reports crashes by its own handlers.
  if (!sanitized)
    for (const int number : {SIGSEGV, SIGABRT, SIGBUS, SIGFPE, SIGILL, SIGXCPU}) ::signal(number, SIG_DFL);
  for (const int number : {SIGINT, SIGTERM}) ::signal(number, SIG_DFL);
  const int nowhere = ::open("/dev/null", O_RDWR);
  if (nowhere >= 0) ::dup2(nowhere, STDOUT_FILENO), ::dup2(nowhere, STDERR_FILENO);
  lower_limit(RLIMIT_CORE, 0);
  lower_limit(RLIMIT_CPU, static_cast<std::size_t>(std::ceil(seconds)));
  bool done = false;
  try {
    done = work(pipe);
  } catch (...) {
  }
  ::_exit(done ? 0 : 1);
}

// Reads until the child closes the pipe. Returns whether it did so in time.
bool read_answer(int pipe, double clock_seconds, std::string& bytes) {
  const auto deadline = std::chrono::steady_clock::now() + std::chrono::duration<double>(clock_seconds);
  std::string block(1 << 16, '\0');
  for (;;) {
    const double left = std::chrono::duration<double>(deadline - std::chrono::steady_clock::now()).count();
    if (left <= 0) return false;
    pollfd waiting{pipe, POLLIN, 0};
    const int ready = ::poll(&waiting, 1, static_cast<int>(std::min(1000.0, 1000 * left)) + 1);
    if (ready < 0 && errno != EINTR) return false;
    if (ready <= 0) continue;
    const ssize_t got = ::read(pipe, block.data(), block.size());
    if (got < 0 && errno == EINTR) continue;
    if (got < 0) return false;
    if (got == 0) return true;
    bytes.append(block.data(), static_cast<std::size_t>(got));
  }
}

}  // namespace

void lower_limit(int resource, std::size_t amount) {
  rlimit present{};
  rlim_t bound = amount;
  if (::getrlimit(static_cast<__rlimit_resource>(resource), &present) == 0) bound = std::min(bound, present.rlim_max);
  const rlimit limits{bound, bound};
  ::setrlimit(static_cast<__rlimit_resource>(resource), &limits);
}

GuardedAnswer run_guarded(double seconds, double clock_seconds, const std::function<bool(int pipe)>& work) {
  const auto fail = [] { throw InputError(std::string("cannot start a child process: ") + std::strerror(errno)); };
  int ends[2];
  if (::pipe2(ends, O_CLOEXEC) != 0) fail();
  const pid_t child = ::fork();
  if (child < 0) {
    ::close(ends[0]), ::close(ends[1]);
    fail();
  }
  if (child == 0) run_child(seconds, ends[1], work);
  ::close(ends[1]);
  GuardedAnswer answer;
  answer.out_of_time = !read_answer(ends[0], clock_seconds, answer.bytes);
  ::close(ends[0]);
  if (answer.out_of_time) ::kill(child, SIGKILL);
  int status = 0;
  rusage usage{};
  while (::wait4(child, &status, 0, &usage) < 0 && errno == EINTR) {
  }
  const auto seconds_of = [](const timeval& time) {
    return static_cast<double>(time.tv_sec) + 1e-6 * static_cast<double>(time.tv_usec);
  };
  answer.seconds = seconds_of(usage.ru_utime) + seconds_of(usage.ru_stime);
  answer.finished = !answer.out_of_time && WIFEXITED(status) && WEXITSTATUS(status) == 0;
  // The system kills at the hard limit of processor time, which is the soft one.
  if (WIFSIGNALED(status) && (WTERMSIG(status) == SIGXCPU || WTERMSIG(status) == SIGKILL)) answer.out_of_time = true;
  return answer;
}

}  // namespace shellgrid
