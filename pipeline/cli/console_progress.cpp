// SPDX-License-Identifier: AGPL-3.0-or-later
#include "pipeline/cli/console_progress.h"

#include <fmt/format.h>
#include <sys/ioctl.h>
#include <unistd.h>

#include <algorithm>
#include <cstdio>
#include <nlohmann/json.hpp>
#include <utility>

#include "pipeline/cli/nearest_name.h"

namespace shellgrid {
namespace {

std::string clock_text(double seconds) {
  const long whole = static_cast<long>(std::min(seconds, 3.6e6) + 0.5);
  return whole >= 3600 ? fmt::format("{}:{:02}:{:02}", whole / 3600, whole / 60 % 60, whole % 60)
                       : fmt::format("{}:{:02}", whole / 60, whole % 60);
}

int terminal_width() {
  winsize size{};
  return ioctl(STDERR_FILENO, TIOCGWINSZ, &size) == 0 && size.ws_col > 0 ? size.ws_col : 80;
}

}  // namespace

ConsoleProgress::ConsoleProgress(std::string program, Display display)
    : program_(std::move(program)), display_(display) {}

ConsoleProgress::~ConsoleProgress() { clear(); }

void ConsoleProgress::begin(const std::string& task, long total) {
  const std::lock_guard lock(mutex_);
  finish();
  task_ = one_line(task);
  total_ = std::max(0L, total);
  done_ = 0;
  running_ = true;
  started_ = Clock::now();
  draw(started_);
}

void ConsoleProgress::advance(long steps) {
  done_.fetch_add(steps, std::memory_order_relaxed);
  if (display_ == Display::none) return;
  const Clock::time_point now = Clock::now();
  if (now.time_since_epoch().count() < next_draw_.load(std::memory_order_relaxed)) return;
  const std::unique_lock lock(mutex_, std::try_to_lock);
  if (lock.owns_lock() && running_) draw(now);
}

void ConsoleProgress::end() {
  const std::lock_guard lock(mutex_);
  finish();
}

void ConsoleProgress::finish() {
  if (running_ && display_ == Display::json) {
    if (total_ > 0) done_ = total_;
    draw(Clock::now());
  }
  running_ = false;
  if (drawn_) std::fputs("\r\033[K", stderr), drawn_ = false;
}

void ConsoleProgress::clear() {
  const std::lock_guard lock(mutex_);
  if (drawn_) std::fputs("\r\033[K", stderr), drawn_ = false;
}

void ConsoleProgress::warn(const std::string& message) {
  const std::lock_guard lock(mutex_);
  const std::string line = one_line(message);
  if (std::find(warnings_.begin(), warnings_.end(), line) != warnings_.end()) return;
  warnings_.push_back(line);
  if (drawn_) std::fputs("\r\033[K", stderr), drawn_ = false;
  std::fputs(fmt::format("{}: warning: {}\n", program_, line).c_str(), stderr);
}

void ConsoleProgress::draw(Clock::time_point now) {
  if (display_ == Display::none) return;
  next_draw_ = (now + std::chrono::milliseconds(100)).time_since_epoch().count();
  const double elapsed = std::chrono::duration<double>(now - started_).count();
  const long done = std::max(0L, total_ > 0 ? std::min(done_.load(), total_) : done_.load());
  const double share = total_ > 0 ? static_cast<double>(done) / static_cast<double>(total_) : 0;
  const double left = share > 0 ? elapsed * (1 - share) / share : -1;
  if (display_ == Display::json) {
    nlohmann::json line = {{"program", program_}, {"task", task_}, {"done", done}, {"seconds", elapsed}};
    if (total_ > 0) line["total"] = total_;
    if (left >= 0) line["seconds_left"] = left;
    std::fputs((line.dump(-1, ' ', false, nlohmann::json::error_handler_t::replace) + "\n").c_str(), stderr);
    return;
  }
  std::string text = program_ + ": " + task_;
  if (total_ > 0) {
    const std::string figures =
        fmt::format(" {:3.0f} %{}", 100 * share, left >= 0 && elapsed > 0.5 ? "  " + clock_text(left) + " left" : "");
    const int room = std::min(30, terminal_width() - static_cast<int>(text.size() + figures.size()) - 5);
    if (room >= 5) {
      const int filled = static_cast<int>(share * room);
      text += " [" + std::string(static_cast<std::size_t>(filled), '#') +
              std::string(static_cast<std::size_t>(room - filled), ' ') + "]";
    }
    text += figures;
  } else {
    text += fmt::format(" {}  {}", done > 0 ? std::to_string(done) : "", clock_text(elapsed));
  }
  std::fputs(("\r" + text + "\033[K").c_str(), stderr);
  std::fflush(stderr);
  drawn_ = true;
}

}  // namespace shellgrid
