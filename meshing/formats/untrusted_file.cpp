// SPDX-License-Identifier: AGPL-3.0-or-later
#include "meshing/formats/untrusted_file.h"

#include <fmt/format.h>
#include <sys/mman.h>
#include <sys/resource.h>
#include <unistd.h>
#include <xxhash.h>

#include <algorithm>
#include <fstream>
#include <memory>

#include "meshing/core/error.h"
#include "meshing/core/guarded_child.h"
#include "meshing/formats/output_file.h"

namespace shellgrid {
namespace {

// Bytes of addresses that this process has mapped.
rlim_t address_space() {
  rlim_t pages = 0;
  std::ifstream("/proc/self/statm") >> pages;
  return pages * static_cast<rlim_t>(::sysconf(_SC_PAGESIZE));
}

// In the child. Writes 'k' for a good file or 'e' and a message.
bool send_verdict(int pipe, std::size_t memory, const std::function<void()>& read) {
  const int warnings = ::memfd_create("warnings", 0);
  if (warnings >= 0) ::dup2(warnings, STDERR_FILENO);
  lower_limit(RLIMIT_AS, memory);
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
  return write_all(pipe, verdict.data(), std::min<std::size_t>(verdict.size(), 4000));
}

using HashState = std::unique_ptr<XXH3_state_t, XXH_errorcode (*)(XXH3_state_t*)>;

HashState started_hash() {
  HashState state(XXH3_createState(), XXH3_freeState);
  XXH3_128bits_reset(state.get());
  return state;
}

std::string digits(const HashState& state) {
  const XXH128_hash_t hash = XXH3_128bits_digest(state.get());
  return fmt::format("{:016x}{:016x}", hash.high64, hash.low64);
}

}  // namespace

std::string seal_of(std::string_view bytes, std::string_view more_bytes) {
  const HashState state = started_hash();
  XXH3_128bits_update(state.get(), bytes.data(), bytes.size());
  if (!more_bytes.empty()) XXH3_128bits_update(state.get(), more_bytes.data(), more_bytes.size());
  return digits(state);
}

std::string seal_of_file(const std::string& path, std::uint64_t left_out, std::uint64_t size) {
  const HashState state = started_hash();
  std::uint64_t at = 0;
  read_blocks(path, [&](std::string_view block) {
    const std::uint64_t end = at + block.size();
    const auto update = [&](std::uint64_t first, std::uint64_t last) {
      if (first < last) XXH3_128bits_update(state.get(), block.data() + (first - at), last - first);
    };
    update(at, std::min(end, left_out));
    update(std::max(at, left_out + size), end);
    at = end;
  });
  return digits(state);
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
  const std::string verdict =
      run_guarded(seconds, 20 * seconds, [&](int pipe) { return send_verdict(pipe, memory, read); }).bytes;
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
