// SPDX-License-Identifier: AGPL-3.0-or-later
#include "meshing/formats/mesh_readers.h"

#include <fmt/format.h>

#include <array>
#include <bit>
#include <cstring>
#include <limits>
#include <map>
#include <unordered_map>

#include "meshing/core/error.h"

namespace shellgrid {
namespace {

constexpr std::size_t most_vertices = std::numeric_limits<std::int32_t>::max();

bool is_space(char c) { return c == ' ' || c == '\t' || c == '\r' || c == '\v' || c == '\f'; }

[[noreturn]] void fail(const std::string& path, const std::string& what) { throw InputError(path + ": " + what); }

double parse_coordinate(const std::string& path, const TextScanner& scanner, std::string_view word) {
  double number = 0;
  if (word.empty()) fail(path, fmt::format("line {}: a coordinate is missing", scanner.line_number()));
  if (!parse_number(word, number))
    fail(path, fmt::format("line {}: '{}' is not a number", scanner.line_number(), word.substr(0, 40)));
  return number;
}

}  // namespace

void MeshBuilder::reserve(std::size_t vertices, std::size_t faces) {
  coordinates_.reserve(3 * vertices);
  triangles_.reserve(3 * faces);
  polygon_of_triangle_.reserve(faces);
}

void MeshBuilder::add_vertex(double x, double y, double z) {
  // Beyond 1e150 squared lengths overflow.
  const auto usable = [](double value) { return std::isfinite(value) && std::abs(value) < 1e150; };
  if (!usable(x) || !usable(y) || !usable(z))
    fail(path_, fmt::format("vertex {} has a coordinate that is not finite", vertex_count()));
  if (vertex_count() >= most_vertices) fail(path_, "more than 2147483647 vertices");
  coordinates_.insert(coordinates_.end(), {x, y, z});
}

void MeshBuilder::add_polygon(const std::vector<std::int64_t>& corners) {
  if (corners.size() < 3)
    fail(path_, fmt::format("face {} has {} corners; expected 3 or more", polygons_, corners.size()));
  for (std::int64_t corner : corners)
    if (corner < 0 || corner >= static_cast<std::int64_t>(most_vertices))
      fail(path_, fmt::format("face {} has the vertex index {}, which is out of range", polygons_, corner));
  for (std::size_t k = 2; k < corners.size(); ++k) {
    for (std::int64_t corner : {corners[0], corners[k - 1], corners[k]})
      triangles_.push_back(static_cast<std::int32_t>(corner));
    polygon_of_triangle_.push_back(polygons_);
  }
  ++polygons_;
}

TriangleMesh MeshBuilder::build() const {
  const auto vertices = static_cast<std::int64_t>(vertex_count());
  for (std::size_t c = 0; c < triangles_.size(); ++c)
    if (triangles_[c] >= vertices)
      fail(path_, fmt::format("face {} has the vertex index {}, which is out of range (there are {} vertices)",
                              polygon_of_triangle_[c / 3], triangles_[c], vertices));
  if (triangles_.size() / 3 > most_vertices) fail(path_, "more than 2147483647 triangles");
  TriangleMesh mesh;
  mesh.vertices = Eigen::Map<const VertexMatrix>(coordinates_.data(), vertices, 3);
  mesh.faces = Eigen::Map<const FaceMatrix>(triangles_.data(), static_cast<Eigen::Index>(triangles_.size() / 3), 3);
  return mesh;
}

bool TextScanner::next_line() {
  if (rest_.empty()) {
    line_ = {};
    return false;
  }
  const std::size_t end = rest_.find('\n');
  line_ = rest_.substr(0, end);
  rest_.remove_prefix(end == std::string_view::npos ? rest_.size() : end + 1);
  ++line_number_;
  return true;
}

bool TextScanner::next_content_line(char comment) {
  while (next_line()) {
    line_ = line_.substr(0, line_.find(comment));
    while (!line_.empty() && is_space(line_.front())) line_.remove_prefix(1);
    if (!line_.empty()) return true;
  }
  return false;
}

std::string_view TextScanner::next_word() {
  while (!line_.empty() && is_space(line_.front())) line_.remove_prefix(1);
  std::size_t length = 0;
  while (length < line_.size() && !is_space(line_[length])) ++length;
  const std::string_view word = line_.substr(0, length);
  line_.remove_prefix(length);
  return word;
}

std::string_view TextScanner::next_word_anywhere() {
  for (;;) {
    const std::string_view word = next_word();
    if (!word.empty() || !next_line()) return word;
  }
}

AttributedMesh parse_obj(const std::string& path, std::string_view bytes) {
  MeshBuilder builder(path);
  TextScanner scanner(bytes);
  std::vector<std::int64_t> corners;
  while (scanner.next_content_line('#')) {
    const std::string_view keyword = scanner.next_word();
    if (keyword == "v") {
      std::array<double, 3> point;
      for (double& x : point) x = parse_coordinate(path, scanner, scanner.next_word());
      builder.add_vertex(point[0], point[1], point[2]);
    } else if (keyword == "f") {
      corners.clear();
      for (std::string_view word = scanner.next_word(); !word.empty(); word = scanner.next_word()) {
        std::int64_t index = 0;
        // vertex, vertex/texture, vertex//normal or vertex/texture/normal.
        if (!parse_number(word.substr(0, word.find('/')), index) || index == 0)
          fail(path, fmt::format("line {}: '{}' is not a face corner", scanner.line_number(), word.substr(0, 40)));
        // Negative indices count backwards from the latest vertex.
        corners.push_back(index > 0 ? index - 1 : static_cast<std::int64_t>(builder.vertex_count()) + index);
        if (corners.back() < 0)
          fail(path, fmt::format("line {}: the vertex index {} is out of range", scanner.line_number(), index));
      }
      builder.add_polygon(corners);
    }
  }
  return {builder.build(), {}};
}

AttributedMesh parse_off(const std::string& path, std::string_view bytes) {
  TextScanner scanner(bytes);
  if (!scanner.next_content_line('#')) fail(path, "the file holds no OFF header");
  std::string_view word = scanner.next_word();
  const auto is_off = [](std::string_view header) {
    for (std::string_view prefix : {"ST", "C", "N"})
      if (header.substr(0, prefix.size()) == prefix) header.remove_prefix(prefix.size());
    return header == "OFF";
  };
  if (!is_off(word)) fail(path, "not an OFF file: it does not begin with OFF");
  word = scanner.next_word();
  if (word == "BINARY") fail(path, "binary OFF files are not supported; save it as text or as PLY");
  if (word.empty()) {
    if (!scanner.next_content_line('#')) fail(path, "truncated: the vertex and face counts are missing");
    word = scanner.next_word();
  }
  std::uint64_t vertices = 0, faces = 0;
  if (!parse_number(word, vertices) || !parse_number(scanner.next_word(), faces))
    fail(path, fmt::format("line {}: expected the vertex and face counts", scanner.line_number()));
  // The shortest vertex line is "0 0 0", the shortest face line "3 0 1 2".
  const std::uint64_t left = scanner.bytes_left() + 1;
  if (vertices > left / 6 || faces > left / 8)
    fail(path, fmt::format("the header promises {} vertices and {} faces, more than the file's {} bytes can hold",
                           vertices, faces, bytes.size()));
  MeshBuilder builder(path);
  builder.reserve(vertices, faces);
  for (std::uint64_t i = 0; i < vertices; ++i) {
    if (!scanner.next_content_line('#')) fail(path, fmt::format("truncated: {} of {} vertices found", i, vertices));
    std::array<double, 3> point;
    for (double& x : point) x = parse_coordinate(path, scanner, scanner.next_word());
    builder.add_vertex(point[0], point[1], point[2]);
  }
  std::vector<std::int64_t> corners;
  for (std::uint64_t i = 0; i < faces; ++i) {
    if (!scanner.next_content_line('#')) fail(path, fmt::format("truncated: {} of {} faces found", i, faces));
    std::uint64_t count = 0;
    if (!parse_number(scanner.next_word(), count) || count > left)
      fail(path, fmt::format("line {}: expected a face", scanner.line_number()));
    corners.clear();
    for (std::uint64_t k = 0; k < count; ++k) {
      std::int64_t index = 0;
      if (!parse_number(scanner.next_word(), index))
        fail(path, fmt::format("line {}: expected {} vertex indices", scanner.line_number(), count));
      corners.push_back(index);
    }
    builder.add_polygon(corners);
  }
  return {builder.build(), {}};
}

namespace {

// Gives corners at equal coordinates one vertex, in the order of first appearance.
class CornerMerger {
 public:
  explicit CornerMerger(MeshBuilder& builder) : builder_(builder) {}
  std::int64_t add(std::array<double, 3> point) {
    for (double& x : point) x += 0.0;  // −0 becomes 0
    const auto [entry, is_new] = index_.try_emplace(point, static_cast<std::int64_t>(builder_.vertex_count()));
    if (is_new) builder_.add_vertex(point[0], point[1], point[2]);
    return entry->second;
  }

 private:
  struct Hash {
    std::size_t operator()(const std::array<double, 3>& point) const {
      std::uint64_t hash = 0;
      for (double x : point) hash = (hash ^ std::bit_cast<std::uint64_t>(x)) * 0x9E3779B97F4A7C15u, hash ^= hash >> 29;
      return hash;
    }
  };
  MeshBuilder& builder_;
  std::unordered_map<std::array<double, 3>, std::int64_t, Hash> index_;
};

AttributedMesh parse_binary_stl(const std::string& path, std::string_view bytes, std::uint64_t triangles) {
  MeshBuilder builder(path);
  builder.reserve(triangles / 2 + 2, triangles);
  CornerMerger merger(builder);
  for (std::uint64_t t = 0; t < triangles; ++t) {
    std::array<float, 12> numbers;  // normal, three corners
    std::memcpy(numbers.data(), bytes.data() + 84 + 50 * t, sizeof numbers);
    std::vector<std::int64_t> corners;
    for (int k = 3; k < 12; k += 3) {
      for (int axis = 0; axis < 3; ++axis)
        if (!std::isfinite(numbers[k + axis]))
          fail(path, fmt::format("triangle {} has a coordinate that is not finite", t));
      corners.push_back(merger.add({numbers[k], numbers[k + 1], numbers[k + 2]}));
    }
    builder.add_polygon(corners);
  }
  return {builder.build(), {}};
}

AttributedMesh parse_ascii_stl(const std::string& path, std::string_view bytes) {
  MeshBuilder builder(path);
  CornerMerger merger(builder);
  TextScanner scanner(bytes);
  const auto expect = [&](std::string_view expected) {
    const std::string_view word = scanner.next_word_anywhere();
    if (word.empty()) fail(path, fmt::format("truncated: expected '{}' at the end", expected));
    if (word != expected)
      fail(path,
           fmt::format("line {}: expected '{}', found '{}'", scanner.line_number(), expected, word.substr(0, 40)));
  };
  scanner.next_line();
  scanner.skip_line();  // solid NAME
  for (;;) {
    const std::string_view word = scanner.next_word_anywhere();
    if (word == "endsolid") {
      scanner.skip_line();
      // A file may hold several solids.
      const std::string_view next = scanner.next_word_anywhere();
      if (next.empty()) break;
      if (next != "solid")
        fail(path, fmt::format("line {}: expected 'solid', found '{}'", scanner.line_number(), next.substr(0, 40)));
      scanner.skip_line();
      continue;
    }
    if (word.empty()) fail(path, "truncated: 'endsolid' is missing");
    if (word != "facet")
      fail(path, fmt::format("line {}: expected 'facet', found '{}'", scanner.line_number(), word.substr(0, 40)));
    expect("normal");
    for (int axis = 0; axis < 3; ++axis) scanner.next_word_anywhere();
    expect("outer"), expect("loop");
    std::vector<std::int64_t> corners;
    for (int k = 0; k < 3; ++k) {
      expect("vertex");
      std::array<double, 3> point;
      for (double& x : point) {
        x = parse_coordinate(path, scanner, scanner.next_word_anywhere());
        if (!std::isfinite(x)) fail(path, fmt::format("line {}: the coordinate is not finite", scanner.line_number()));
      }
      corners.push_back(merger.add(point));
    }
    expect("endloop"), expect("endfacet");
    builder.add_polygon(corners);
  }
  return {builder.build(), {}};
}

}  // namespace

AttributedMesh parse_stl(const std::string& path, std::string_view bytes) {
  std::uint32_t triangles = 0;
  if (bytes.size() >= 84) std::memcpy(&triangles, bytes.data() + 80, 4);
  const std::uint64_t expected = 84 + std::uint64_t{50} * triangles;
  const bool says_solid = bytes.substr(0, 5) == "solid";
  if (bytes.size() >= 84 && (bytes.size() == expected || (!says_solid && bytes.size() > expected)))
    return parse_binary_stl(path, bytes, triangles);
  if (says_solid) return parse_ascii_stl(path, bytes);
  if (bytes.size() < 84) fail(path, "truncated: shorter than the header of a binary STL file");
  fail(path, fmt::format("truncated: the header promises {} triangles, which are {} bytes; the file has {}", triangles,
                         expected, bytes.size()));
}

}  // namespace shellgrid
