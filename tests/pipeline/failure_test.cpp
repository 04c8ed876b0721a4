// SPDX-License-Identifier: AGPL-3.0-or-later
#include "pipeline/cli/failure.h"

#include <gtest/gtest.h>

#include <filesystem>
#include <fstream>
#include <new>
#include <system_error>
#include <thread>

#include <unistd.h>

#include "meshing/core/error.h"

namespace shellgrid {
namespace {

std::string message_of(const std::string& what) {
  return describe_failure("sg-x", std::make_exception_ptr(NumericalError(what))).message;
}

TEST(Failure, LongHistoriesShowTheirFirstAndLastNumbers) {
  std::string history;
  for (int k = 1; k <= 200; ++k) history += " " + std::to_string(k) + "e-03";
  EXPECT_EQ(message_of("no convergence after 200 iterations; relative residuals" + history),
            "sg-x: error: no convergence after 200 iterations; relative residuals 1e-03 2e-03 3e-03 … (200 in all) … "
            "198e-03 199e-03 200e-03");
  EXPECT_EQ(message_of("after 3 iterations 1 2 3"), "sg-x: error: after 3 iterations 1 2 3");
}

// Its description fails where no exception may pass.
struct Indescribable : std::exception {
  const char* what() const noexcept override { std::terminate(); }
};

template <class Exception>
[[noreturn]] void fail_in_threads(int count, const std::vector<std::string>& folders, const Exception& exception) {
  ::alarm(60);
  end_cleanly_on_uncaught_exceptions("sg-x", folders);
  std::vector<std::thread> threads;
  for (int k = 0; k < count; ++k) threads.emplace_back([&] { throw exception; });
  for (;;) ::pause();
}

TEST(UncaughtExceptionDeathTest, EndsTheProgramInOneLine) {
  GTEST_FLAG_SET(death_test_style, "threadsafe");
  EXPECT_EXIT(fail_in_threads(1, {}, NumericalError("no convergence")), testing::ExitedWithCode(4),
              "^sg-x: error: no convergence\n$");
  EXPECT_EXIT(fail_in_threads(1, {}, std::bad_alloc()), testing::ExitedWithCode(3), "^sg-x: error: out of memory.*\n$");
  EXPECT_EXIT(fail_in_threads(8, {}, std::bad_alloc()), testing::ExitedWithCode(3), "^sg-x: error: out of memory.*\n$");
}

TEST(UncaughtExceptionDeathTest, AFailureOfTheEndItselfEndsItToo) {
  GTEST_FLAG_SET(death_test_style, "threadsafe");
  EXPECT_EXIT(fail_in_threads(1, {}, Indescribable()), testing::ExitedWithCode(1),
              "^sg-x: error: internal fault: no way to go on\n$");
}

TEST(UncaughtExceptionDeathTest, HalfWrittenFilesAreRemoved) {
  GTEST_FLAG_SET(death_test_style, "threadsafe");
  const std::filesystem::path folder = std::filesystem::path(testing::TempDir()) / "uncaught_exception";
  std::filesystem::create_directories(folder);
  EXPECT_EXIT(
      {
        std::ofstream(folder / ("a.vdb.partial-" + std::to_string(::getpid()) + "-1")) << "half";
        fail_in_threads(1, {folder.string()}, std::bad_alloc());
      },
      testing::ExitedWithCode(3), "");
  EXPECT_TRUE(std::filesystem::is_empty(folder));
  std::filesystem::remove_all(folder);
}

}  // namespace
}  // namespace shellgrid
