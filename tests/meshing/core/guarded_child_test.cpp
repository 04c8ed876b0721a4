// SPDX-License-Identifier: AGPL-3.0-or-later
#include "meshing/core/guarded_child.h"

#include <gtest/gtest.h>
#include <unistd.h>

#include <atomic>
#include <csignal>
#include <stdexcept>
#include <string>

namespace shellgrid {
namespace {

TEST(GuardedChild, SendsItsAnswer) {
  const std::string text(3'000'000, 'x');
  const GuardedAnswer answer = run_guarded(10, 60, [&](int pipe) { return write_all(pipe, text.data(), text.size()); });
  EXPECT_TRUE(answer.finished);
  EXPECT_FALSE(answer.out_of_time);
  EXPECT_EQ(answer.bytes, text);
}

TEST(GuardedChild, LeavesTheParentAsItWas) {
  int number = 1;
  const GuardedAnswer answer = run_guarded(10, 60, [&](int) {
    number = 2;
    return true;
  });
  EXPECT_TRUE(answer.finished);
  EXPECT_EQ(number, 1);
  EXPECT_EQ(answer.bytes, "");
}

TEST(GuardedChild, ThatEndsBadlyHasNotFinished) {
  const auto ends = [](const std::function<bool()>& how) {
    const GuardedAnswer answer = run_guarded(10, 60, [&](int pipe) { return write_all(pipe, "half", 4) && how(); });
    EXPECT_EQ(answer.bytes, "half");
    EXPECT_FALSE(answer.out_of_time);
    return answer.finished;
  };
  EXPECT_TRUE(ends([] { return true; }));
  EXPECT_FALSE(ends([] { return false; }));
  EXPECT_FALSE(ends([]() -> bool { throw std::runtime_error("no"); }));
  EXPECT_FALSE(ends([] { return ::raise(SIGTERM) == 0; }));
  EXPECT_FALSE(ends([]() -> bool { ::_exit(7); }));
}

TEST(GuardedChild, IsKilledWhenItsTimeIsUp) {
  const GuardedAnswer idle = run_guarded(10, 0.2, [](int) {
    for (;;) ::pause();
    return true;
  });
  EXPECT_TRUE(idle.out_of_time);
  EXPECT_FALSE(idle.finished);
  const GuardedAnswer busy = run_guarded(0.5, 100, [](int) {
    for (std::atomic<unsigned> n = 0;; ++n) {
    }
    return true;
  });
  EXPECT_TRUE(busy.out_of_time);
  EXPECT_FALSE(busy.finished);
  EXPECT_GT(busy.seconds, 0.5);
}

}  // namespace
}  // namespace shellgrid
