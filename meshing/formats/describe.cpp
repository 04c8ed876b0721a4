// SPDX-License-Identifier: AGPL-3.0-or-later
#include "meshing/formats/describe.h"

#include <fmt/format.h>

#include <algorithm>
#include <cctype>
#include <cmath>
#include <filesystem>
#include <limits>
#include <nlohmann/json.hpp>

#include "meshing/core/error.h"
#include "meshing/formats/image_file.h"
#include "meshing/formats/mesh_file.h"
#include "meshing/formats/number_archive.h"
#include "meshing/formats/output_file.h"
#include "meshing/formats/vdb_file.h"
#include "meshing/formats/vtkhdf_file.h"
#include "meshing/surface/mesh_topology.h"

namespace shellgrid {
namespace {

using Json = nlohmann::ordered_json;

// The range and mean of many numbers.
class Range {
 public:
  void add(double value) {
    if (!std::isfinite(value)) {
      ++not_finite_;
      return;
    }
    least_ = std::min(least_, value);
    greatest_ = std::max(greatest_, value);
    sum_ += value;
    ++count_;
  }
  Json json() const {
    Json result;
    if (count_ > 0) result = {{"least", least_}, {"greatest", greatest_}, {"mean", sum_ / static_cast<double>(count_)}};
    if (not_finite_ > 0) result["not_finite"] = not_finite_;
    return result;
  }

 private:
  double least_ = std::numeric_limits<double>::infinity(), greatest_ = -least_, sum_ = 0;
  std::size_t count_ = 0, not_finite_ = 0;
};

Json vector_json(const Vec3& v) { return {v.x(), v.y(), v.z()}; }

Json bounds_json(const VertexMatrix& points) {
  if (points.rows() == 0) return nullptr;
  const Vec3 lower = points.colwise().minCoeff().transpose(), upper = points.colwise().maxCoeff().transpose();
  return {{"lower", vector_json(lower)}, {"upper", vector_json(upper)}, {"size", vector_json(upper - lower)}};
}

Json describe_mesh(const std::string& path) {
  const AttributedMesh mesh = read_points(path);
  Json result;
  const bool has_faces = mesh.mesh.face_count() > 0;
  result["kind"] = has_faces ? "triangle mesh" : "points";
  result["vertices"] = mesh.mesh.vertex_count();
  result["faces"] = mesh.mesh.face_count();
  result["bounds_mm"] = bounds_json(mesh.mesh.vertices);
  if (has_faces) {
    const MeshTopology topology = measure_topology(mesh.mesh);
    result["edges"] = topology.edges;
    result["closed"] = topology.is_closed();
    result["oriented"] = topology.is_oriented();
    result["components"] = topology.components;
    result["euler_characteristic"] = topology.euler_characteristic;
    if (topology.is_closed() && topology.is_oriented()) {
      result["genus"] = topology.genus();
      result["volume_mm3"] = topology.volume;
    }
    result["area_mm2"] = topology.area;
    result["boundary_edges"] = topology.boundary_edges;
    result["non_manifold_edges"] = topology.non_manifold_edges;
    result["misoriented_edges"] = topology.misoriented_edges;
    result["degenerate_faces"] = topology.degenerate_faces;
    result["isolated_vertices"] = topology.isolated_vertices;
    Range edges;
    for (int f = 0; f < mesh.mesh.face_count(); ++f)
      for (int k = 0; k < 3; ++k) edges.add((mesh.mesh.corner(f, k) - mesh.mesh.corner(f, (k + 1) % 3)).norm());
    result["edge_length_mm"] = edges.json();
  }
  for (const auto& [word, text] : read_notes(path)) result["notes"][word] = text;
  for (const VertexProperty& property : mesh.properties) {
    Range range;
    for (float value : property.values) range.add(value);
    result["properties"][property.name] = range.json();
  }
  return result;
}

template <class T>
Json describe_grid(const TwoLevelGrid<T>& grid) {
  Json result;
  constexpr int components = std::is_same_v<T, Vec3f> ? 3 : 1;
  result["type"] = std::is_same_v<T, Vec3f> ? "vec3s" : std::is_same_v<T, float> ? "float" : "int32";
  result["leaves"] = grid.leaf_count();
  result["active_samples"] = grid.active_count();
  std::array<Range, 3> ranges;
  Vec3i lower = Vec3i::Constant(std::numeric_limits<int>::max()), upper = -lower;
  grid.for_each_active([&](int i, int j, int k, const T& value) {
    lower = lower.cwiseMin(Vec3i(i, j, k)), upper = upper.cwiseMax(Vec3i(i, j, k));
    if constexpr (components == 3)
      for (int c = 0; c < 3; ++c) ranges[static_cast<std::size_t>(c)].add(value[c]);
    else
      ranges[0].add(value);
  });
  if (grid.active_count() > 0)
    result["index_bounds"] = {{"lower", {lower.x(), lower.y(), lower.z()}},
                              {"upper", {upper.x(), upper.y(), upper.z()}}};
  if constexpr (components == 3) {
    for (int c = 0; c < 3; ++c) result["values"][std::string(1, "xyz"[c])] = ranges[static_cast<std::size_t>(c)].json();
    result["background"] = {grid.background().x(), grid.background().y(), grid.background().z()};
  } else {
    result["values"] = ranges[0].json();
    result["background"] = grid.background();
  }
  return result;
}

Json describe_volume(const std::string& path) {
  const VdbArchive archive = read_vdb(path);
  Json result;
  const auto kind = archive.metadata.find("kind");
  result["kind"] = kind == archive.metadata.end() ? "volume" : "volume: " + kind->second;
  result["voxel_mm"] = archive.frame.voxel;
  result["origin_mm"] = vector_json(archive.frame.origin);
  for (const auto& [key, text] : archive.metadata)
    if (key != "kind") result["metadata"][key] = text.size() > 200 ? text.substr(0, 200) + " …" : text;
  for (const VdbArchive::Entry& entry : archive.grids)
    result["grids"][entry.name] = std::visit([](const auto& grid) { return describe_grid(grid); }, entry.grid);
  return result;
}

Json describe_arrays(const std::vector<DataArray>& arrays) {
  Json result = Json::object();
  for (const DataArray& array : arrays) {
    Range range;
    std::size_t values = 0;
    std::visit(
        [&](const auto& list) {
          values = list.size();
          for (auto value : list) range.add(static_cast<double>(value));
        },
        array.values);
    Json entry = range.json();
    entry["rows"] = values / static_cast<std::size_t>(array.columns);
    entry["columns"] = array.columns;
    result[array.name] = entry;
  }
  return result;
}

Json describe_unstructured_grid(const std::string& path) {
  const UnstructuredGrid grid = read_vtkhdf(path);
  Json result;
  std::array<std::size_t, 256> by_type{};
  for (std::uint8_t type : grid.types) ++by_type[type];
  result["kind"] = grid.find_field("graph_links") != nullptr ? "polygrid"
                   : by_type[10] == grid.types.size()        ? "tetrahedral mesh"
                                                             : "unstructured grid";
  result["points"] = grid.points.rows();
  result["bounds_mm"] = bounds_json(grid.points);
  for (std::size_t type = 0; type < by_type.size(); ++type) {
    if (by_type[type] == 0) continue;
    const char* name = type == 10 ? "tetrahedra" : type == 12 ? "hexahedra" : type == 9 ? "quadrilaterals" : nullptr;
    result["cells"][name != nullptr ? std::string(name) : fmt::format("VTK type {}", type)] = by_type[type];
  }
  for (const auto& [name, value] : grid.attributes) result["attributes"][name] = value;
  if (!grid.point_data.empty()) result["point_data"] = describe_arrays(grid.point_data);
  if (!grid.cell_data.empty()) result["cell_data"] = describe_arrays(grid.cell_data);
  if (!grid.field_data.empty()) result["field_data"] = describe_arrays(grid.field_data);
  for (std::size_t l = 0; l < grid.levels.size(); ++l) {
    Json& level = result["hierarchy"][fmt::format("level {}", l + 1)];
    for (const DataArray& array : grid.levels[l]) {
      const auto rows = std::visit([](const auto& v) { return v.size(); }, array.values) / array.columns;
      if (array.name == "interior") level["nodes"] = rows;
      if (array.name == "boundary") level["boundary_nodes"] = rows;
      if (array.name == "parent") level["children"] = rows;
    }
  }
  return result;
}

Json describe_image(const Image& image) {
  Json result;
  result["kind"] = "image";
  result["width"] = image.width;
  result["height"] = image.height;
  for (const Image::Channel& channel : image.channels) {
    Range range;
    for (float value : channel.values) range.add(value);
    result["channels"][channel.name] = range.json();
  }
  return result;
}

// Compressed functions: their lists by length, and bytes.
Json describe_numbers(const std::string& path) {
  const NumberArchive archive = read_number_archive(path);
  Json result = {{"kind", archive.kind}};
  for (const auto& [name, values] : archive.numbers) result["numbers"][name] = values.size();
  for (const auto& [name, values] : archive.counts) result["lists"][name] = 8 * values.size();
  return result;
}

Json describe_json(const std::string& path) {
  const Json document = Json::parse(read_text(path), nullptr, false, true);
  if (document.is_discarded()) throw InputError(path + ": not a JSON file");
  Json result;
  if (document.is_object() && document.contains("stage") && document.contains("inputs")) {
    result["kind"] = "record of a stage";
    for (const char* key : {"stage", "version", "command", "seconds", "peak_memory_mib", "results", "warnings"})
      if (document.contains(key)) result[key] = document[key];
  } else {
    result["kind"] =
        document.is_object() && document.contains("object") && document.contains("camera") ? "scene" : "JSON document";
    if (document.is_object())
      for (const auto& [key, value] : document.items()) result["keys"][key] = value.type_name();
  }
  return result;
}

// One line for a value that is no nested object, else indented lines.
void append_lines(std::string& text, const std::string& key, const nlohmann::json& value, int depth) {
  const std::string indent(static_cast<std::size_t>(2 * depth), ' ');
  const auto number = [](const nlohmann::json& v) {
    return v.is_number_float() ? fmt::format("{:.6g}", v.get<double>())
           : v.is_string()     ? v.get<std::string>()
                               : v.dump();
  };
  std::string shown = key;
  std::replace(shown.begin(), shown.end(), '\n', ' ');
  if (value.is_object() && value.contains("least") && value.contains("greatest")) {
    text += fmt::format("{}{}: {} … {}, mean {}", indent, shown, number(value["least"]), number(value["greatest"]),
                        number(value["mean"]));
    if (value.contains("rows")) text += fmt::format(", {} × {}", number(value["rows"]), number(value["columns"]));
    if (value.contains("not_finite")) text += fmt::format(", {} not finite", number(value["not_finite"]));
    text += '\n';
  } else if (value.is_object()) {
    text += fmt::format("{}{}:\n", indent, shown);
    for (const auto& [name, inner] : value.items()) append_lines(text, name, inner, depth + 1);
  } else if (value.is_array()) {
    std::string line;
    for (const nlohmann::json& item : value) line += (line.empty() ? "" : " ") + number(item);
    text += fmt::format("{}{}: {}\n", indent, shown, line);
  } else {
    text += fmt::format("{}{}: {}\n", indent, shown,
                        value.is_boolean() ? (value.get<bool>() ? "yes" : "no") : number(value));
  }
}

}  // namespace

nlohmann::json describe_artefact(const std::string& path) {
  std::string extension = std::filesystem::path(path).extension().string();
  std::transform(extension.begin(), extension.end(), extension.begin(),
                 [](unsigned char c) { return std::tolower(c); });
  Json result;
  const std::uint64_t bytes = file_size(path);
  if (extension == ".ply" || extension == ".obj" || extension == ".off" || extension == ".stl")
    result = describe_mesh(path);
  else if (extension == ".vdb")
    result = describe_volume(path);
  else if (extension == ".hdf" || extension == ".h5" || extension == ".vtkhdf")
    result = describe_unstructured_grid(path);
  else if (extension == ".exr")
    result = describe_image(read_exr(path));
  else if (extension == ".png")
    result = describe_image(read_png(path));
  else if (extension == ".stf")
    result = describe_numbers(path);
  else if (extension == ".json")
    result = describe_json(path);
  else
    throw InputError(fmt::format(
        "{}: unknown extension '{}'; expected .ply .obj .off .stl .vdb .stf .hdf .exr .png or .json", path, extension));
  result["path"] = path;
  result["bytes"] = bytes;
  result["xxh64"] = hash_file(path);
  return result;
}

std::string description_text(const nlohmann::json& description) {
  std::string text = fmt::format("{}: {}, {} bytes\n", description.value("path", ""), description.value("kind", ""),
                                 description.value("bytes", std::uint64_t{0}));
  for (const auto& [key, value] : description.items())
    if (key != "path" && key != "kind" && key != "bytes" && key != "xxh64") append_lines(text, key, value, 1);
  if (!text.empty()) text.pop_back();
  return text;
}

}  // namespace shellgrid
