// SPDX-License-Identifier: AGPL-3.0-or-later
// The parsers behind read_mesh, one a format. Each takes the whole file and its name for messages.
#pragma once
#include <charconv>
#include <cmath>
#include <cstdint>
#include <string>
#include <string_view>
#include <vector>

#include "meshing/core/triangle_mesh.h"

namespace shellgrid {

AttributedMesh parse_ply(const std::string& path, std::string_view bytes);
AttributedMesh parse_obj(const std::string& path, std::string_view bytes);
AttributedMesh parse_off(const std::string& path, std::string_view bytes);
AttributedMesh parse_stl(const std::string& path, std::string_view bytes);

// Collects corners and fans polygons into triangles.
class MeshBuilder {
 public:
  explicit MeshBuilder(const std::string& path) : path_(path) {}
  void reserve(std::size_t vertices, std::size_t faces);
  // Throws: InputError where a coordinate is not finite.
  void add_vertex(double x, double y, double z);
  // Throws: InputError where there are fewer than three corners.
  void add_polygon(const std::vector<std::int64_t>& corners);
  std::size_t vertex_count() const { return coordinates_.size() / 3; }
  // Throws: InputError where an index is out of range.
  TriangleMesh build() const;

 private:
  std::string path_;
  std::vector<double> coordinates_;
  std::vector<std::int32_t> triangles_;
  std::vector<std::int64_t> polygon_of_triangle_;
  std::int64_t polygons_ = 0;
};

// Walks a text line by line and each line word by word; does not depend on the locale.
class TextScanner {
 public:
  explicit TextScanner(std::string_view text) : rest_(text) {}
  // The next line without its end; false at the end of the text.
  bool next_line();
  // Skips empty lines and what follows `comment`.
  bool next_content_line(char comment);
  void skip_line() { line_ = {}; }
  // The next word of the line; empty at its end.
  std::string_view next_word();
  // The next word of the text on whatever line; empty at the end of the text.
  std::string_view next_word_anywhere();
  std::int64_t line_number() const { return line_number_; }
  std::size_t bytes_left() const { return rest_.size() + line_.size(); }

 private:
  std::string_view rest_, line_;
  std::int64_t line_number_ = 0;
};

// The whole word as a number; false where it is none.
template <class Number>
bool parse_number(std::string_view word, Number& number) {
  if (!word.empty() && word.front() == '+') word.remove_prefix(1);
  const auto parsed = std::from_chars(word.data(), word.data() + word.size(), number);
  return parsed.ec == std::errc() && parsed.ptr == word.data() + word.size();
}

}  // namespace shellgrid
