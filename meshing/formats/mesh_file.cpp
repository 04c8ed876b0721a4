// SPDX-License-Identifier: AGPL-3.0-or-later
#include "meshing/formats/mesh_file.h"

#include <fmt/format.h>

#include <algorithm>
#include <bit>
#include <cctype>
#include <cmath>
#include <cstring>
#include <filesystem>
#include <fstream>
#include <sstream>
#include <string_view>

#include "meshing/core/error.h"
#include "meshing/formats/mesh_readers.h"
#include "meshing/formats/output_file.h"
#include "meshing/formats/output_set.h"

namespace shellgrid {
namespace {

static_assert(std::endian::native == std::endian::little, "files are written as the machine stores numbers");

bool is_colour(const std::string& name) {
  return name == "red" || name == "green" || name == "blue" || name == "alpha";
}

constexpr const char* note_mark = "comment shellgrid ";

std::string ply_header(std::size_t vertices, const std::vector<VertexProperty>& properties, std::size_t faces,
                       bool has_faces, const std::map<std::string, std::string>& notes = {}) {
  std::string header = "ply\nformat binary_little_endian 1.0\ncomment shellgrid; lengths in millimetres\n";
  for (const auto& [word, text] : notes)
    if (!text.empty()) header += note_mark + word + " " + text + "\n";
  header += fmt::format("element vertex {}\nproperty double x\nproperty double y\nproperty double z\n", vertices);
  for (const VertexProperty& property : properties) {
    if (property.name.empty() || property.values.size() != vertices ||
        std::any_of(property.name.begin(), property.name.end(), [](unsigned char c) { return !std::isgraph(c); }))
      throw InternalError(fmt::format("PLY property '{}' has {} values for {} vertices", property.name,
                                      property.values.size(), vertices));
    header += fmt::format("property {} {}\n", is_colour(property.name) ? "uchar" : "float", property.name);
  }
  if (has_faces) header += fmt::format("element face {}\nproperty list uchar int vertex_indices\n", faces);
  return header + "end_header\n";
}

template <class T>
void put(char*& to, const T& value) {
  std::memcpy(to, &value, sizeof value);
  to += sizeof value;
}

void append_vertices(std::string& bytes, const VertexMatrix& points, const std::vector<VertexProperty>& properties) {
  std::size_t stride = 3 * sizeof(double);
  for (const VertexProperty& property : properties) stride += is_colour(property.name) ? 1 : sizeof(float);
  const std::size_t start = bytes.size();
  bytes.resize(start + stride * static_cast<std::size_t>(points.rows()));
  char* to = bytes.data() + start;
  for (Eigen::Index i = 0; i < points.rows(); ++i) {
    for (int axis = 0; axis < 3; ++axis) put(to, points(i, axis));
    for (const VertexProperty& property : properties) {
      const float value = property.values[static_cast<std::size_t>(i)];
      if (is_colour(property.name))
        // The comparison's form sends NaN to 0.
        put(to, static_cast<std::uint8_t>(value > 0 ? std::lround(std::min(value, 255.0f)) : 0));
      else
        put(to, value);
    }
  }
}

AttributedMesh read_any(const std::string& path) {
  std::string extension = std::filesystem::path(path).extension().string();
  std::transform(extension.begin(), extension.end(), extension.begin(),
                 [](unsigned char c) { return std::tolower(c); });
  const std::string bytes = read_text(path);
  if (bytes.empty()) throw InputError(path + ": the file is empty");
  if (extension == ".ply") return parse_ply(path, bytes);
  if (extension == ".obj") return parse_obj(path, bytes);
  if (extension == ".off") return parse_off(path, bytes);
  if (extension == ".stl") return parse_stl(path, bytes);
  throw InputError(fmt::format("{}: unknown mesh format '{}'; expected .ply, .obj, .off or .stl", path, extension));
}

}  // namespace

AttributedMesh read_mesh(const std::string& path) {
  AttributedMesh mesh = read_any(path);
  if (mesh.mesh.vertex_count() == 0) throw InputError(path + ": the mesh has no vertices");
  if (mesh.mesh.face_count() == 0) throw InputError(path + ": the mesh has no faces");
  return mesh;
}

AttributedMesh read_points(const std::string& path) {
  AttributedMesh mesh = read_any(path);
  if (mesh.mesh.vertex_count() == 0) throw InputError(path + ": the file holds no points");
  return mesh;
}

void write_ply(const std::string& path, const AttributedMesh& mesh, const std::map<std::string, std::string>& notes) {
  const auto vertices = static_cast<std::size_t>(mesh.mesh.vertex_count());
  const auto faces = static_cast<std::size_t>(mesh.mesh.face_count());
  std::string bytes = ply_header(vertices, mesh.properties, faces, true, notes);
  append_vertices(bytes, mesh.mesh.vertices, mesh.properties);
  const std::size_t start = bytes.size();
  bytes.resize(start + faces * (1 + 3 * sizeof(std::int32_t)));
  char* to = bytes.data() + start;
  for (int f = 0; f < mesh.mesh.face_count(); ++f) {
    put(to, std::uint8_t{3});
    for (int k = 0; k < 3; ++k) put(to, mesh.mesh.faces(f, k));
  }
  write_text_atomically(path, bytes);
}

std::map<std::string, std::string> read_notes(const std::string& path) {
  std::ifstream file(OutputSet::present_path(path), std::ios::binary);
  if (!file) throw InputError(path + ": cannot be read");
  std::map<std::string, std::string> notes;
  constexpr std::size_t longest = 4096;
  std::string head(longest, '\0');
  file.read(head.data(), longest);
  head.resize(static_cast<std::size_t>(file.gcount()));
  if (!head.starts_with("ply")) return notes;
  std::istringstream lines(head);
  for (std::string line; std::getline(lines, line) && !line.starts_with("end_header");) {
    if (!line.starts_with(note_mark)) continue;
    std::istringstream words(line.substr(std::string_view(note_mark).size()));
    std::string word, text;
    words >> word >> std::ws;
    std::getline(words, text);
    notes[word] = text;
  }
  return notes;
}

void write_point_ply(const std::string& path, const VertexMatrix& points,
                     const std::vector<VertexProperty>& properties) {
  std::string bytes = ply_header(static_cast<std::size_t>(points.rows()), properties, 0, false);
  append_vertices(bytes, points, properties);
  write_text_atomically(path, bytes);
}

}  // namespace shellgrid
