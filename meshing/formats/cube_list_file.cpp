// SPDX-License-Identifier: AGPL-3.0-or-later
#include "meshing/formats/cube_list_file.h"

#include <algorithm>
#include <charconv>
#include <cmath>
#include <filesystem>
#include <string_view>

#include <nlohmann/json.hpp>

#include "meshing/core/error.h"
#include "meshing/formats/mesh_file.h"
#include "meshing/formats/output_file.h"
#include "meshing/formats/polycube_file.h"
#include "meshing/formats/vdb_file.h"

namespace shellgrid {
namespace {

constexpr std::size_t most_cubes = 20000000;
constexpr int farthest = 1000000;  // lattice coordinate

std::string what_is_expected(const std::string& path) {
  return path + ": expected a list of cubes as [x, y, z], or an object with the key `cubes`";
}

int coordinate(const std::string& path, std::size_t cube, const nlohmann::json& value) {
  const double number = value.is_number_integer() ? value.get<double>() : NAN;
  if (!(std::abs(number) <= farthest))
    throw InputError(path + ": cube " + std::to_string(cube) + " has a coordinate that is no whole number from -" +
                     std::to_string(farthest) + " to " + std::to_string(farthest));
  return static_cast<int>(number);
}

double finite_number(const std::string& path, const std::string& key, const nlohmann::json& value) {
  if (!value.is_number() || !std::isfinite(value.get<double>()))
    throw InputError(path + ": `" + key + "` holds no number");
  return value.get<double>();
}

CubeList read_json_cubes(const std::string& path) {
  nlohmann::json document;
  try {
    document = nlohmann::json::parse(read_text(path), nullptr, true, true);
  } catch (const nlohmann::json::exception& error) {
    std::string reason = error.what();
    reason = reason.substr(0, reason.find('\n'));
    throw InputError(path + ": no JSON: " + reason);
  }
  CubeList list;
  const nlohmann::json* cubes = &document;
  if (document.is_object()) {
    for (const auto& [key, value] : document.items())
      if (key != "cubes" && key != "origin" && key != "edge")
        throw InputError(path + ": unknown key `" + key + "`; expected cubes, origin, edge");
    if (!document.contains("cubes")) throw InputError(what_is_expected(path));
    cubes = &document["cubes"];
    if (document.contains("origin") != document.contains("edge"))
      throw InputError(path + ": `origin` and `edge` must be given together");
    if (document.contains("edge")) {
      list.placed = true;
      list.edge = finite_number(path, "edge", document["edge"]);
      if (!(list.edge > 0)) throw InputError(path + ": `edge` must be above 0");
      const nlohmann::json& origin = document["origin"];
      if (!origin.is_array() || origin.size() != 3) throw InputError(path + ": `origin` must hold three numbers");
      for (int axis = 0; axis < 3; ++axis) list.origin[axis] = finite_number(path, "origin", origin[axis]);
    }
  }
  if (!cubes->is_array()) throw InputError(what_is_expected(path));
  for (std::size_t c = 0; c < cubes->size(); ++c) {
    const nlohmann::json& cube = (*cubes)[c];
    if (!cube.is_array() || cube.size() != 3)
      throw InputError(path + ": cube " + std::to_string(c) + " is no list of three whole numbers");
    list.cubes.push_back({coordinate(path, c, cube[0]), coordinate(path, c, cube[1]), coordinate(path, c, cube[2])});
  }
  return list;
}

CubeList read_text_cubes(const std::string& path) {
  const std::string text = read_text(path);
  CubeList list;
  std::size_t line_number = 0;
  for (std::size_t begin = 0; begin < text.size();) {
    const std::size_t end = std::min(text.find('\n', begin), text.size());
    std::string_view line(text.data() + begin, end - begin);
    begin = end + 1;
    ++line_number;
    line = line.substr(0, line.find('#'));
    std::vector<int> numbers;
    while (true) {
      const std::size_t first = line.find_first_not_of(" \t\r,;");
      if (first == std::string_view::npos) break;
      line.remove_prefix(first);
      int value = 0;
      const auto [stop, error] = std::from_chars(line.data(), line.data() + line.size(), value);
      const bool ends = stop == line.data() + line.size() || std::string_view(" \t\r,;").find(*stop) != line.npos;
      if (error != std::errc() || !ends || std::abs(static_cast<std::int64_t>(value)) > farthest || numbers.size() == 3)
        throw InputError(path + ": line " + std::to_string(line_number) + ": expected three whole numbers from -" +
                         std::to_string(farthest) + " to " + std::to_string(farthest));
      numbers.push_back(value);
      line.remove_prefix(static_cast<std::size_t>(stop - line.data()));
    }
    if (numbers.empty()) continue;
    if (numbers.size() != 3)
      throw InputError(path + ": line " + std::to_string(line_number) + ": " + std::to_string(numbers.size()) +
                       " numbers; expected three");
    list.cubes.push_back({numbers[0], numbers[1], numbers[2]});
  }
  return list;
}

CubeList read_volume_cubes(const std::string& path) {
  const VdbArchive archive = read_vdb(path);
  CubeList list;
  list.placed = true;
  list.edge = archive.frame.voxel;
  // Samples stand at the middles of their voxels.
  list.origin = archive.frame.origin - Vec3::Constant(0.5 * archive.frame.voxel);
  for (const VdbArchive::Entry& entry : archive.grids) {
    const auto take = [&](int i, int j, int k, auto value) {
      if (value > 0) list.cubes.push_back({i, j, k});
      if (list.cubes.size() > most_cubes)
        throw InputError(path + ": more than " + std::to_string(most_cubes) + " active voxels above 0");
    };
    if (const auto* values = std::get_if<TwoLevelGrid<float>>(&entry.grid))
      values->for_each_active(take);
    else if (const auto* labels = std::get_if<TwoLevelGrid<std::int32_t>>(&entry.grid))
      labels->for_each_active(take);
    else
      continue;
    return list;
  }
  throw InputError(path + ": no float or int32 grid; expected a mask of the cubes");
}

}  // namespace

CubeList read_cube_list(const std::string& path) {
  std::string extension = std::filesystem::path(path).extension().string();
  std::transform(extension.begin(), extension.end(), extension.begin(),
                 [](unsigned char c) { return std::tolower(c); });
  CubeList list;
  if (extension == ".json") {
    list = read_json_cubes(path);
  } else if (extension == ".txt") {
    list = read_text_cubes(path);
  } else if (extension == ".hdf") {
    const VoxelPolycube polycube = read_polycube(path);
    list = {polycube.blocks, true, polycube.origin, polycube.spacing * polycube.cells_per_block};
  } else if (extension == ".vdb") {
    list = read_volume_cubes(path);
  } else if (extension == ".ply" || extension == ".off" || extension == ".obj" || extension == ".stl") {
    const TriangleMesh mesh = read_mesh(path).mesh;
    list = naming(path, [&] { return cubes_of_mesh(mesh); });
  } else {
    throw InputError(path +
                     ": unknown kind of file; expected cubes as .json, .txt, .hdf, .ply, .off, .obj, .stl or .vdb");
  }
  if (list.cubes.empty()) throw InputError(path + ": the file holds no cubes");
  if (list.cubes.size() > most_cubes) throw InputError(path + ": more than " + std::to_string(most_cubes) + " cubes");
  return list;
}

}  // namespace shellgrid
