// SPDX-License-Identifier: AGPL-3.0-or-later
#include "pipeline/cli/termination.h"

#include <signal.h>
#include <unistd.h>

#include <atomic>
#include <filesystem>
#include <mutex>
#include <string>
#include <thread>

namespace shellgrid {
namespace {

std::atomic<bool> held{false}, asked{false};
// Of what must not be broken off.
std::mutex& unbroken() {
  static std::mutex mutex;
  return mutex;
}

}  // namespace

UnbrokenPart::UnbrokenPart() { unbroken().lock(); }
UnbrokenPart::~UnbrokenPart() { unbroken().unlock(); }

void hold_termination() { held = true; }
bool termination_asked() { return asked; }

void remove_half_written_files(const std::vector<std::string>& folders) {
  const std::string mark = ".partial-" + std::to_string(getpid()) + "-";
  for (const std::string& folder : folders) {
    std::error_code ignored;
    for (const auto& entry : std::filesystem::directory_iterator(folder, ignored))
      if (entry.path().filename().string().find(mark) != std::string::npos)
        std::filesystem::remove(entry.path(), ignored);
  }
}

void clean_up_on_termination(const std::vector<std::string>& folders) {
  // A signal handler may do next to nothing; a thread that waits for the signals may do anything.
  sigset_t signals;
  sigemptyset(&signals);
  for (const int number : {SIGTERM, SIGINT, SIGHUP}) sigaddset(&signals, number);
  if (pthread_sigmask(SIG_BLOCK, &signals, nullptr) != 0) return;
  std::thread([folders, signals] {
    int number = 0;
    do {
      if (sigwait(&signals, &number) != 0) return;
    } while (held && number != SIGHUP && !asked.exchange(true));
    unbroken().lock();
    remove_half_written_files(folders);
    signal(number, SIG_DFL);
    pthread_sigmask(SIG_UNBLOCK, &signals, nullptr);
    raise(number);
    _exit(128 + number);
  }).detach();
}

}  // namespace shellgrid
