// SPDX-License-Identifier: AGPL-3.0-or-later
#include "pipeline/cli/failure.h"

#include <gtest/gtest.h>

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

}  // namespace
}  // namespace shellgrid
