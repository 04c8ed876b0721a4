// SPDX-License-Identifier: AGPL-3.0-or-later
#include "meshing/formats/output_file.h"

#include <fcntl.h>
#include <fmt/format.h>
#include <signal.h>
#include <sys/stat.h>
#include <unistd.h>
#include <xxhash.h>

#include <atomic>
#include <cerrno>
#include <charconv>
#include <cstdio>
#include <cstring>
#include <filesystem>
#include <fstream>
#include <memory>
#include <mutex>
#include <vector>

#include "meshing/core/error.h"
#include "meshing/formats/output_set.h"

namespace shellgrid {
namespace {

namespace fs = std::filesystem;

constexpr std::size_t block_bytes = std::size_t{1} << 20;

[[noreturn]] void fail(const std::string& path, const std::string& what, int error) {
  throw InputError(fmt::format("{}: {}: {}", path, what, std::strerror(error)));
}

// An open file descriptor.
class File {
 public:
  File(const std::string& path, int flags) : descriptor_(::open(path.c_str(), flags | O_CLOEXEC, 0666)) {}
  ~File() {
    if (descriptor_ >= 0) ::close(descriptor_);
  }
  File(const File&) = delete;
  File& operator=(const File&) = delete;
  bool is_open() const { return descriptor_ >= 0; }
  int descriptor() const { return descriptor_; }
  // Closes and returns whether the system accepted everything.
  bool close() {
    const int descriptor = descriptor_;
    descriptor_ = -1;
    return ::close(descriptor) == 0;
  }

 private:
  int descriptor_;
};

// Opens a regular file for reading and returns its size through `bytes`.
std::unique_ptr<File> open_regular(const std::string& path, std::uint64_t& bytes) {
  // Non-blocking, so that a named pipe does not hang.
  auto file = std::make_unique<File>(path, O_RDONLY | O_NONBLOCK);
  struct stat status;
  if (!file->is_open() || ::fstat(file->descriptor(), &status) != 0) fail(path, "cannot be read", errno);
  if (S_ISDIR(status.st_mode)) throw InputError(path + ": cannot be read: it is a folder");
  if (!S_ISREG(status.st_mode)) throw InputError(path + ": cannot be read: it is not a regular file");
  bytes = static_cast<std::uint64_t>(status.st_size);
  return file;
}

// Reads up to `bytes` bytes; fewer only at the end of the file.
std::size_t read_block(const File& file, const std::string& path, char* data, std::size_t bytes) {
  std::size_t done = 0;
  while (done < bytes) {
    const ssize_t got = ::read(file.descriptor(), data + done, bytes - done);
    if (got < 0 && errno == EINTR) continue;
    if (got < 0) fail(path, "cannot be read", errno);
    if (got == 0) break;
    done += static_cast<std::size_t>(got);
  }
  return done;
}

bool same_bytes(const std::string& a, const std::string& b) {
  std::uint64_t bytes_a = 0, bytes_b = 0;
  const std::unique_ptr<File> file_a = open_regular(a, bytes_a), file_b = open_regular(b, bytes_b);
  if (bytes_a != bytes_b) return false;
  std::vector<char> block_a(block_bytes), block_b(block_bytes);
  for (;;) {
    const std::size_t got_a = read_block(*file_a, a, block_a.data(), block_bytes);
    const std::size_t got_b = read_block(*file_b, b, block_b.data(), block_bytes);
    if (got_a != got_b || std::memcmp(block_a.data(), block_b.data(), got_a) != 0) return false;
    if (got_a == 0) return true;
  }
}

void sync(const std::string& path, const std::string& shown) {
  const File file(path, O_RDONLY);
  if (!file.is_open()) fail(shown, "cannot be written", errno);
  // Some file systems cannot sync a folder and say so with EINVAL.
  if (::fsync(file.descriptor()) != 0 && errno != EINVAL && errno != ENOTSUP) fail(shown, "cannot be written", errno);
}

// A killed process that nobody has waited for yet, as in a container without an init, still has a number.
bool is_running(int process) {
  if (::kill(process, 0) != 0) return errno != ESRCH;
  std::ifstream status(fmt::format("/proc/{}/stat", process));
  std::string line;
  if (!std::getline(status, line)) return true;
  // The state follows the program's name, which stands in parentheses and may hold any character.
  const std::size_t end = line.rfind(") ");
  return end == std::string::npos || end + 2 >= line.size() || (line[end + 2] != 'Z' && line[end + 2] != 'X');
}

// Temporaries of killed runs are named after a process that no longer runs.
void remove_orphans(const fs::path& folder, const std::string& prefix) {
  std::error_code ignored;
  for (const fs::directory_entry& entry : fs::directory_iterator(folder, ignored)) {
    const std::string name = entry.path().filename().string();
    if (name.rfind(prefix, 0) != 0) continue;
    int process = 0;
    const char* begin = name.data() + prefix.size();
    const auto parsed = std::from_chars(begin, name.data() + name.size(), process);
    if (parsed.ec != std::errc() || process <= 0 || parsed.ptr == name.data() + name.size() || *parsed.ptr != '-')
      continue;
    if (!is_running(process)) fs::remove(entry.path(), ignored);
  }
}

// A file that is written and synced, and where it is to go.
struct Written {
  fs::path temporary, target;
  std::string shown;  // as the caller calls it

  void publish() const {
    const fs::path folder = target.parent_path().empty() ? fs::path(".") : target.parent_path();
    std::error_code error;
    if (fs::exists(target, error) && same_bytes(temporary.string(), target.string())) {
      fs::remove(temporary, error);
      return;
    }
    if (::rename(temporary.c_str(), target.c_str()) != 0) fail(shown, "cannot be written", errno);
    sync(folder.string(), shown);
  }
  void discard() const {
    std::error_code ignored;
    fs::remove(temporary, ignored);
  }
};

// The files of the process's output set.
struct PendingOutputs {
  std::mutex mutex;
  bool collecting = false;
  std::vector<Written> files;
};
PendingOutputs& pending_outputs() {
  static PendingOutputs pending;
  return pending;
}
thread_local int asides = 0;

// True where it is kept for an output set. Of two for one place the later one counts.
bool keep_pending(const Written& written) {
  PendingOutputs& pending = pending_outputs();
  const std::lock_guard lock(pending.mutex);
  if (!pending.collecting || asides > 0) return false;
  for (Written& file : pending.files)
    if (file.target == written.target) {
      file.discard();
      file = written;
      return true;
    }
  pending.files.push_back(written);
  return true;
}

// The file that a name stands for.
fs::path resolved(const std::string& path) {
  std::error_code error;
  const fs::path target(path);
  return fs::is_symlink(target, error) ? fs::weakly_canonical(target, error) : target;
}

}  // namespace

OutputSet::OutputSet() {
  PendingOutputs& pending = pending_outputs();
  const std::lock_guard lock(pending.mutex);
  if (pending.collecting) throw InternalError("two output sets at a time");
  pending.collecting = true;
}

OutputSet::~OutputSet() {
  PendingOutputs& pending = pending_outputs();
  const std::lock_guard lock(pending.mutex);
  for (const Written& file : pending.files) file.discard();
  pending.files.clear();
  pending.collecting = false;
}

void OutputSet::publish() {
  PendingOutputs& pending = pending_outputs();
  const std::lock_guard lock(pending.mutex);
  while (!pending.files.empty()) {
    pending.files.front().publish();
    pending.files.erase(pending.files.begin());
  }
}

std::string OutputSet::present_path(const std::string& path) {
  PendingOutputs& pending = pending_outputs();
  const std::lock_guard lock(pending.mutex);
  const fs::path target = resolved(path);
  for (const Written& file : pending.files)
    if (file.target == target) return file.temporary.string();
  return path;
}

OutputSet::Aside::Aside() { ++asides; }
OutputSet::Aside::~Aside() { --asides; }

void write_atomically(const std::string& path, const std::function<void(const std::string&)>& write) {
  std::error_code error;
  const fs::path target = resolved(path);
  if (target.filename().empty() || fs::is_directory(target, error))
    throw InputError(path + ": cannot be written: it is a folder");
  const bool exists = fs::exists(target, error);
  if (exists && !fs::is_regular_file(target, error))
    throw InputError(path + ": cannot be written: it is not a regular file");
  const fs::path folder = target.parent_path().empty() ? fs::path(".") : target.parent_path();
  if (!fs::is_directory(folder, error))
    throw InputError(fmt::format("{}: cannot be written: there is no folder {}", path, folder.string()));

  static std::atomic<unsigned> serial{0};
  std::string stem = target.stem().string();
  if (stem.size() > 160) stem.resize(160);
  const std::string prefix = "." + stem + ".partial-";
  remove_orphans(folder, prefix);
  const fs::path temporary =
      folder / fmt::format("{}{}-{}{}", prefix, ::getpid(), serial++, target.extension().string());
  try {
    {
      File created(temporary.string(), O_WRONLY | O_CREAT | O_EXCL);
      if (!created.is_open()) fail(path, "cannot be written", errno);
    }
    write(temporary.string());
    sync(temporary.string(), path);
    const Written written{temporary, target, path};
    if (!keep_pending(written)) written.publish();
  } catch (...) {
    fs::remove(temporary, error);
    throw;
  }
}

void write_text_atomically(const std::string& path, const std::string& text) {
  write_atomically(path, [&](const std::string& temporary) {
    File file(temporary, O_WRONLY | O_TRUNC);
    if (!file.is_open()) fail(path, "cannot be written", errno);
    std::size_t done = 0;
    while (done < text.size()) {
      const ssize_t put = ::write(file.descriptor(), text.data() + done, text.size() - done);
      if (put < 0 && errno == EINTR) continue;
      if (put < 0) fail(path, "cannot be written", errno);
      done += static_cast<std::size_t>(put);
    }
    if (!file.close()) fail(path, "cannot be written", errno);
  });
}

std::string read_text(const std::string& path) {
  std::uint64_t bytes = 0;
  const std::unique_ptr<File> file = open_regular(path, bytes);
  std::string text(bytes, '\0');
  text.resize(read_block(*file, path, text.data(), text.size()));
  return text;
}

std::string read_head(const std::string& path, std::size_t bytes) {
  std::uint64_t whole = 0;
  const std::unique_ptr<File> file = open_regular(path, whole);
  std::string text(std::min<std::uint64_t>(bytes, whole), '\0');
  text.resize(read_block(*file, path, text.data(), text.size()));
  return text;
}

void read_blocks(const std::string& path, const std::function<void(std::string_view)>& take) {
  std::uint64_t bytes = 0;
  const std::unique_ptr<File> file = open_regular(path, bytes);
  std::vector<char> block(block_bytes);
  while (const std::size_t got = read_block(*file, path, block.data(), block_bytes)) take({block.data(), got});
}

std::string hash_file(const std::string& path) {
  const std::unique_ptr<XXH64_state_t, XXH_errorcode (*)(XXH64_state_t*)> state(XXH64_createState(), XXH64_freeState);
  XXH64_reset(state.get(), 0);
  read_blocks(path, [&](std::string_view block) { XXH64_update(state.get(), block.data(), block.size()); });
  return fmt::format("{:016x}", XXH64_digest(state.get()));
}

std::uint64_t file_size(const std::string& path) {
  std::uint64_t bytes = 0;
  open_regular(path, bytes);
  return bytes;
}

}  // namespace shellgrid
