// SPDX-License-Identifier: AGPL-3.0-or-later
#include "meshing/core/guarded_child.h"

#include <unistd.h>

#include <cerrno>
#include <cstdlib>
#include <exception>

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

}  // namespace shellgrid
