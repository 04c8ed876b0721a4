// SPDX-License-Identifier: AGPL-3.0-or-later
#include "meshing/formats/number_archive.h"

#include <fmt/format.h>
#include <xxhash.h>

#include <bit>
#include <cstring>

#include "meshing/core/error.h"
#include "meshing/formats/output_file.h"

namespace shellgrid {
namespace {

static_assert(std::endian::native == std::endian::little, "values are written as they are in memory");

constexpr const char* first_line = "shellgrid numbers 1\n";

void append(std::string& bytes, std::uint64_t value) { bytes.append(reinterpret_cast<const char*>(&value), 8); }
void append(std::string& bytes, const std::string& text) {
  append(bytes, static_cast<std::uint64_t>(text.size()));
  bytes += text;
}
template <class Value>
void append(std::string& bytes, const std::map<std::string, std::vector<Value>>& lists) {
  append(bytes, static_cast<std::uint64_t>(lists.size()));
  for (const auto& [name, values] : lists) {
    append(bytes, name);
    append(bytes, static_cast<std::uint64_t>(values.size()));
    bytes.append(reinterpret_cast<const char*>(values.data()), 8 * values.size());
  }
}

// Reads what `append` wrote, never beyond the end.
class Reader {
 public:
  Reader(const std::string& path, const std::string& bytes, std::size_t at, std::size_t end)
      : path_(path), bytes_(bytes), at_(at), end_(end) {}
  std::uint64_t number() {
    need(8);
    std::uint64_t value;
    std::memcpy(&value, bytes_.data() + at_, 8);
    at_ += 8;
    return value;
  }
  std::string text() {
    const std::uint64_t size = number();
    need(size);
    at_ += size;
    return bytes_.substr(at_ - size, size);
  }
  template <class Value>
  std::map<std::string, std::vector<Value>> lists() {
    std::map<std::string, std::vector<Value>> result;
    for (std::uint64_t count = number(); count > 0; --count) {
      const std::string name = text();
      const std::uint64_t size = number();
      if (size > end_ / 8) fail();
      need(8 * size);
      std::vector<Value> values(size);
      if (size > 0) std::memcpy(values.data(), bytes_.data() + at_, 8 * size);
      at_ += 8 * size;
      result[name] = std::move(values);
    }
    return result;
  }

 private:
  void need(std::uint64_t bytes) const {
    if (bytes > end_ - at_) fail();
  }
  [[noreturn]] void fail() const { throw InputError(path_ + ": is damaged: a list reaches beyond its end"); }

  const std::string& path_;
  const std::string& bytes_;
  std::size_t at_, end_;
};

}  // namespace

void write_number_archive(const std::string& path, const NumberArchive& archive) {
  std::string bytes = first_line;
  append(bytes, archive.kind);
  append(bytes, archive.fingerprint);
  append(bytes, archive.numbers);
  append(bytes, archive.counts);
  append(bytes, static_cast<std::uint64_t>(XXH3_64bits(bytes.data(), bytes.size())));
  write_text_atomically(path, bytes);
}

NumberArchive read_number_archive(const std::string& path) {
  const std::string bytes = read_text(path);
  const std::size_t begin = std::strlen(first_line);
  if (bytes.compare(0, begin, first_line) != 0)
    throw InputError(path + ": is no saved state: it does not begin with 'shellgrid numbers 1'");
  if (bytes.size() < begin + 8) throw InputError(path + ": is damaged: it ends too early");
  const std::size_t end = bytes.size() - 8;
  std::uint64_t seal;
  std::memcpy(&seal, bytes.data() + end, 8);
  if (seal != XXH3_64bits(bytes.data(), end)) throw InputError(path + ": is damaged: its hash is another");
  Reader reader(path, bytes, begin, end);
  NumberArchive archive;
  archive.kind = reader.text();
  archive.fingerprint = reader.text();
  archive.numbers = reader.lists<double>();
  archive.counts = reader.lists<std::uint64_t>();
  return archive;
}

}  // namespace shellgrid
