// SPDX-License-Identifier: AGPL-3.0-or-later
// Does what the sanitizers must find, where its arguments say, to test what becomes of the report.
//   sanitizer_probe FAULT PLACE
#include <sys/wait.h>
#include <unistd.h>

#include <cstdlib>
#include <cstring>
#include <functional>
#include <limits>
#include <map>
#include <string>
#include <vector>

#include "meshing/core/guarded_child.h"

namespace {

volatile int sink;
volatile int size = 4;
void* volatile lost;

void read_past_the_end() {
  int* values = new int[size];
  std::memset(values, 0, sizeof(int) * static_cast<std::size_t>(size));
  sink = values[size];
  delete[] values;
}

void overflow() {
  volatile int greatest = std::numeric_limits<int>::max();
  sink = greatest + size;
}

void leak() {
  lost = std::malloc(static_cast<std::size_t>(size));
  lost = nullptr;
}

void read_nowhere() { sink = *reinterpret_cast<volatile int*>(static_cast<std::size_t>(size)); }

void allocate_too_much() { lost = ::operator new (std::size_t{1} << 60 >> (size - 4)); }

void fail_an_assertion() {
  std::vector<int> none;
  sink = none[static_cast<std::size_t>(size)];
}

// Runs it in a forked process and waits.
void in_child(const std::function<void()>& work) {
  const pid_t child = ::fork();
  if (child == 0) {
    shellgrid::enter_guarded_child();
    work();
    ::_exit(0);
  }
  ::waitpid(child, nullptr, 0);
}

}  // namespace

int main(int count, char** arguments) {
  const std::map<std::string, std::function<void()>> faults{{"read-past-the-end", read_past_the_end},
                                                            {"overflow", overflow},
                                                            {"leak", leak},
                                                            {"read-nowhere", read_nowhere},
                                                            {"allocate-too-much", allocate_too_much},
                                                            {"fail-an-assertion", fail_an_assertion}};
  if (count != 3 || faults.count(arguments[1]) == 0) return 2;
  const auto& fault = faults.at(arguments[1]);
  const auto as_foreign = [&] {
    const shellgrid::ForeignCode foreign;
    fault();
  };
  const std::map<std::string, std::function<void()>> places{{"program", fault},
                                                            {"library", as_foreign},
                                                            {"guarded-child", [&] { in_child(fault); }},
                                                            {"library-in-guarded-child", [&] { in_child(as_foreign); }},
                                                            {"after-library-in-guarded-child",
                                                             [&] {
                                                               in_child([&] {
                                                                 { const shellgrid::ForeignCode foreign; }
                                                                 fault();
                                                               });
                                                             }},
                                                            {"after-guarded-child", [&] {
                                                               in_child([] { const shellgrid::ForeignCode foreign; });
                                                               fault();
                                                             }}};
  if (places.count(arguments[2]) == 0) return 2;
  places.at(arguments[2])();
  return 0;
}
