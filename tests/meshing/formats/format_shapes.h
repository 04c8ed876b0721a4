// SPDX-License-Identifier: AGPL-3.0-or-later
// Small shapes, folders and damage for the tests of the file formats.
#pragma once
#include <gtest/gtest.h>
#include <unistd.h>

#include <cmath>
#include <filesystem>
#include <fstream>
#include <functional>
#include <string>

#include "meshing/core/error.h"
#include "meshing/core/triangle_mesh.h"
#include "meshing/formats/output_file.h"

namespace shellgrid {

// A fresh folder that goes away with the object.
class TemporaryFolder {
 public:
  TemporaryFolder() {
    // In memory where the system has it: thousands of damaged files are written.
    const std::filesystem::path memory = "/dev/shm";
    std::string pattern =
        ((::access(memory.c_str(), W_OK) == 0 ? memory : std::filesystem::temp_directory_path()) / "shellgrid-XXXXXX")
            .string();
    path_ = ::mkdtemp(pattern.data());
  }
  ~TemporaryFolder() {
    std::error_code ignored;
    std::filesystem::remove_all(path_, ignored);
  }
  std::string operator/(const std::string& name) const { return (path_ / name).string(); }
  std::size_t file_count() const {
    std::size_t count = 0;
    for ([[maybe_unused]] const auto& entry : std::filesystem::directory_iterator(path_)) ++count;
    return count;
  }

 private:
  std::filesystem::path path_;
};

inline void write_raw(const std::string& path, const std::string& bytes) {
  std::ofstream(path, std::ios::binary) << bytes;
}

// The regular octahedron, closed and counter-clockwise.
inline TriangleMesh octahedron() {
  TriangleMesh mesh;
  mesh.vertices.resize(6, 3);
  mesh.vertices << 1, 0, 0, -1, 0, 0, 0, 1, 0, 0, -1, 0, 0, 0, 1, 0, 0, -1;
  mesh.faces.resize(8, 3);
  mesh.faces << 0, 2, 4, 2, 1, 4, 1, 3, 4, 3, 0, 4, 2, 0, 5, 1, 2, 5, 3, 1, 5, 0, 3, 5;
  return mesh;
}

// The message with which `action` throws InputError; fails where it does not.
inline std::string input_error_of(const std::function<void()>& action) {
  try {
    action();
  } catch (const InputError& error) {
    return error.what();
  }
  ADD_FAILURE() << "no InputError";
  return {};
}

// Expects that reading damaged copies of a file either works or throws an InputError of one line that names the path.
inline void expect_survives_damage(const std::string& path, const std::function<void()>& read, int truncations,
                                   int flips) {
  const std::string whole = read_text(path);
  const auto attempt = [&](const std::string& bytes, const std::string& what) {
    write_raw(path, bytes);
    try {
      read();
    } catch (const InputError& error) {
      const std::string message = error.what();
      EXPECT_EQ(message.find('\n'), std::string::npos) << message;
      EXPECT_EQ(message.rfind(path, 0), 0u) << message;
    } catch (const std::exception& error) {
      ADD_FAILURE() << what << ": " << error.what();
    }
  };
  for (int t = 0; t < truncations; ++t) {
    const std::size_t length = whole.size() * static_cast<std::size_t>(t) / static_cast<std::size_t>(truncations);
    attempt(whole.substr(0, length), "truncated to " + std::to_string(length));
  }
  std::uint64_t state = 0x9E3779B97F4A7C15u;
  const auto next = [&] {
    state ^= state << 13, state ^= state >> 7, state ^= state << 17;
    return state;
  };
  for (int f = 0; f < flips; ++f) {
    std::string damaged = whole;
    // Half of the damage goes where headers lie.
    const std::size_t range = f % 2 == 0 ? std::min<std::size_t>(whole.size(), 600) : whole.size();
    for (int n = 0; n <= f % 3; ++n) damaged[next() % range] = static_cast<char>(next());
    attempt(damaged, "flip " + std::to_string(f));
  }
  write_raw(path, whole);
}

}  // namespace shellgrid
