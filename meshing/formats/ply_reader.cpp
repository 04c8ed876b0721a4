// SPDX-License-Identifier: AGPL-3.0-or-later
// The Stanford polygon format. Source: [Turk1994].
#include <fmt/format.h>

#include <algorithm>
#include <array>
#include <bit>
#include <cstring>
#include <optional>

#include "meshing/core/error.h"
#include "meshing/formats/mesh_readers.h"

namespace shellgrid {
namespace {

enum class Scalar { i8, u8, i16, u16, i32, u32, f32, f64 };
enum class Encoding { ascii, little, big };

struct Property {
  std::string name;
  Scalar type = Scalar::f32;
  std::optional<Scalar> list_count;  // the count's type where it is a list
};

struct Element {
  std::string name;
  std::uint64_t count = 0;
  std::vector<Property> properties;
};

[[noreturn]] void fail(const std::string& path, const std::string& what) { throw InputError(path + ": " + what); }

std::optional<Scalar> scalar_of(std::string_view name) {
  static constexpr std::array<std::array<std::string_view, 2>, 8> names{{{"char", "int8"},
                                                                         {"uchar", "uint8"},
                                                                         {"short", "int16"},
                                                                         {"ushort", "uint16"},
                                                                         {"int", "int32"},
                                                                         {"uint", "uint32"},
                                                                         {"float", "float32"},
                                                                         {"double", "float64"}}};
  for (std::size_t i = 0; i < names.size(); ++i)
    if (name == names[i][0] || name == names[i][1]) return static_cast<Scalar>(i);
  return std::nullopt;
}

std::size_t size_of(Scalar type) {
  static constexpr std::array<std::size_t, 8> sizes{1, 1, 2, 2, 4, 4, 4, 8};
  return sizes[static_cast<std::size_t>(type)];
}

// The values after the header, one after the other.
class ValueReader {
 public:
  ValueReader(const std::string& path, std::string_view body, Encoding encoding)
      : path_(path), body_(body), text_(body), encoding_(encoding) {}

  std::size_t bytes_left() const { return encoding_ == Encoding::ascii ? text_.bytes_left() : body_.size(); }

  // Throws: InputError naming the element where the file ends or a word is no number.
  double next(Scalar type, const Element& element, std::uint64_t index) {
    if (encoding_ == Encoding::ascii) {
      const std::string_view word = text_.next_word_anywhere();
      if (word.empty()) truncated(element, index);
      double number = 0;
      if (!parse_number(word, number))
        fail(path_, fmt::format("{} {}: '{}' is not a number", element.name, index, word.substr(0, 40)));
      return number;
    }
    switch (type) {
      case Scalar::i8:
        return take<std::int8_t>(element, index);
      case Scalar::u8:
        return take<std::uint8_t>(element, index);
      case Scalar::i16:
        return take<std::int16_t>(element, index);
      case Scalar::u16:
        return take<std::uint16_t>(element, index);
      case Scalar::i32:
        return take<std::int32_t>(element, index);
      case Scalar::u32:
        return take<std::uint32_t>(element, index);
      case Scalar::f32:
        return take<float>(element, index);
      case Scalar::f64:
        return take<double>(element, index);
    }
    throw InternalError("unknown PLY scalar");
  }

  // The length of a list whose items are of `type`.
  std::uint64_t next_count(const Property& property, const Element& element, std::uint64_t index) {
    const double count = next(*property.list_count, element, index);
    if (!(count >= 0) || count != std::floor(count))
      fail(path_,
           fmt::format("{} {}: the length {} of its list {} is no count", element.name, index, count, property.name));
    const double least_bytes = encoding_ == Encoding::ascii ? 1.0 : static_cast<double>(size_of(property.type));
    if (count * least_bytes > static_cast<double>(bytes_left())) truncated(element, index);
    return static_cast<std::uint64_t>(count);
  }

 private:
  template <class T>
  double take(const Element& element, std::uint64_t index) {
    if (body_.size() < sizeof(T)) truncated(element, index);
    std::array<char, sizeof(T)> bytes;
    std::memcpy(bytes.data(), body_.data(), sizeof(T));
    if ((encoding_ == Encoding::big) == (std::endian::native == std::endian::little))
      std::reverse(bytes.begin(), bytes.end());
    body_.remove_prefix(sizeof(T));
    return static_cast<double>(std::bit_cast<T>(bytes));
  }

  [[noreturn]] void truncated(const Element& element, std::uint64_t index) const {
    fail(path_, fmt::format("truncated: the file ends in {} {} of {}", element.name, index, element.count));
  }

  const std::string& path_;
  std::string_view body_;
  TextScanner text_;
  Encoding encoding_;
};

struct Header {
  Encoding encoding = Encoding::ascii;
  std::vector<Element> elements;
  std::size_t bytes = 0;
};

Property parse_property(const std::string& path, TextScanner& scanner) {
  Property property;
  std::string_view type = scanner.next_word();
  if (type == "list") {
    property.list_count = scalar_of(scanner.next_word());
    if (!property.list_count || *property.list_count == Scalar::f32 || *property.list_count == Scalar::f64)
      fail(path, fmt::format("header line {}: unknown type of a list's length", scanner.line_number()));
    type = scanner.next_word();
  }
  const std::optional<Scalar> scalar = scalar_of(type);
  if (!scalar) fail(path, fmt::format("header line {}: unknown type '{}'", scanner.line_number(), type.substr(0, 40)));
  property.type = *scalar;
  property.name = scanner.next_word();
  if (property.name.empty()) fail(path, fmt::format("header line {}: a name is missing", scanner.line_number()));
  return property;
}

Header parse_header(const std::string& path, std::string_view bytes) {
  Header header;
  TextScanner scanner(bytes);
  scanner.next_line();
  if (scanner.next_word() != "ply") fail(path, "not a PLY file: it does not begin with ply");
  bool has_format = false;
  while (scanner.next_line()) {
    const std::string_view keyword = scanner.next_word();
    if (keyword == "format") {
      const std::string_view name = scanner.next_word();
      has_format = true;
      if (name == "ascii")
        header.encoding = Encoding::ascii;
      else if (name == "binary_little_endian")
        header.encoding = Encoding::little;
      else if (name == "binary_big_endian")
        header.encoding = Encoding::big;
      else
        fail(path, fmt::format("unknown PLY format '{}'", name.substr(0, 40)));
    } else if (keyword == "element") {
      Element element;
      element.name = scanner.next_word().substr(0, 40);
      if (!parse_number(scanner.next_word(), element.count))
        fail(path, fmt::format("header line {}: expected a count", scanner.line_number()));
      header.elements.push_back(element);
    } else if (keyword == "property") {
      if (header.elements.empty())
        fail(path, fmt::format("header line {}: a property before any element", scanner.line_number()));
      header.elements.back().properties.push_back(parse_property(path, scanner));
    } else if (keyword == "end_header") {
      if (!has_format) fail(path, "the header names no format");
      // The line's rest must be blank: binary data begins right after it.
      while (!scanner.next_word().empty()) {
      }
      header.bytes = bytes.size() - scanner.bytes_left();
      return header;
    } else if (keyword != "comment" && keyword != "obj_info" && !keyword.empty()) {
      fail(path, fmt::format("header line {}: unknown keyword '{}'", scanner.line_number(), keyword.substr(0, 40)));
    }
  }
  fail(path, "truncated: the header has no end");
}

// Refuses counts that the file cannot hold, before anything is allocated.
void check_counts(const std::string& path, const Header& header, std::size_t file_bytes) {
  const std::size_t left = file_bytes - header.bytes;
  for (const Element& element : header.elements) {
    std::size_t least = 0;
    for (const Property& property : element.properties)
      least += header.encoding == Encoding::ascii ? 2 : size_of(property.list_count.value_or(property.type));
    if (least == 0 && element.count > 0) fail(path, "the element " + element.name + " has no properties");
    if (element.count > 0 && element.count > (left + 1) / least)
      fail(path, fmt::format("truncated or malformed: the header promises {} of {}, at least {} bytes each; the file "
                             "has {} bytes",
                             element.count, element.name, least, file_bytes));
  }
}

void read_vertices(const std::string& path, const Element& element, ValueReader& values, MeshBuilder& builder,
                   std::vector<VertexProperty>& properties) {
  std::array<int, 3> axis_at{-1, -1, -1};
  std::vector<int> property_of(element.properties.size(), -1);
  for (std::size_t p = 0; p < element.properties.size(); ++p) {
    const Property& property = element.properties[p];
    if (property.list_count) continue;
    const std::size_t axis = std::string_view("xyz").find(property.name);
    if (property.name.size() == 1 && axis != std::string_view::npos) {
      axis_at[axis] = static_cast<int>(p);
      continue;
    }
    property_of[p] = static_cast<int>(properties.size());
    properties.push_back({property.name, {}});
    properties.back().values.reserve(element.count);
  }
  if (std::min({axis_at[0], axis_at[1], axis_at[2]}) < 0) fail(path, "the vertices have no x, y and z");
  std::vector<double> row(element.properties.size());
  for (std::uint64_t i = 0; i < element.count; ++i) {
    for (std::size_t p = 0; p < row.size(); ++p) {
      const Property& property = element.properties[p];
      if (property.list_count) {
        for (std::uint64_t n = values.next_count(property, element, i); n > 0; --n)
          values.next(property.type, element, i);
        continue;
      }
      row[p] = values.next(property.type, element, i);
      if (property_of[p] >= 0) properties[property_of[p]].values.push_back(static_cast<float>(row[p]));
    }
    builder.add_vertex(row[axis_at[0]], row[axis_at[1]], row[axis_at[2]]);
  }
}

void read_faces(const std::string& path, const Element& element, ValueReader& values, MeshBuilder& builder) {
  std::vector<std::int64_t> corners;
  bool has_corners = false;
  for (const Property& property : element.properties)
    has_corners |= property.list_count && (property.name == "vertex_indices" || property.name == "vertex_index");
  if (!has_corners && element.count > 0) fail(path, "the faces have no list vertex_indices");
  for (std::uint64_t i = 0; i < element.count; ++i)
    for (const Property& property : element.properties) {
      if (!property.list_count) {
        values.next(property.type, element, i);
        continue;
      }
      const bool are_corners = property.name == "vertex_indices" || property.name == "vertex_index";
      const std::uint64_t count = values.next_count(property, element, i);
      corners.clear();
      for (std::uint64_t k = 0; k < count; ++k) {
        const double value = values.next(property.type, element, i);
        if (!are_corners) continue;
        if (!(std::abs(value) < 1e15) || value != std::floor(value))
          fail(path, fmt::format("face {} has the vertex index {}, which is no index", i, value));
        corners.push_back(static_cast<std::int64_t>(value));
      }
      if (are_corners) builder.add_polygon(corners);
    }
}

void skip(const Element& element, ValueReader& values) {
  for (std::uint64_t i = 0; i < element.count; ++i)
    for (const Property& property : element.properties) {
      const std::uint64_t count = property.list_count ? values.next_count(property, element, i) : 1;
      for (std::uint64_t k = 0; k < count; ++k) values.next(property.type, element, i);
    }
}

}  // namespace

AttributedMesh parse_ply(const std::string& path, std::string_view bytes) {
  const Header header = parse_header(path, bytes);
  check_counts(path, header, bytes.size());
  ValueReader values(path, bytes.substr(header.bytes), header.encoding);
  MeshBuilder builder(path);
  AttributedMesh result;
  std::array<int, 2> seen{0, 0};
  for (const Element& element : header.elements) {
    if (element.name == "vertex" && seen[0]++ == 0)
      read_vertices(path, element, values, builder, result.properties);
    else if (element.name == "face" && seen[1]++ == 0)
      read_faces(path, element, values, builder);
    else
      skip(element, values);
  }
  if (seen[0] == 0) fail(path, "the header names no vertices");
  result.mesh = builder.build();
  return result;
}

}  // namespace shellgrid
