// SPDX-License-Identifier: AGPL-3.0-or-later
// Tetrahedral meshes and polygrids as VTKHDF files. FORMATS.md lists their arrays.
#include <fmt/format.h>

#include <algorithm>

#include "meshing/core/error.h"
#include "meshing/formats/vtkhdf_file.h"

namespace shellgrid {
namespace {

constexpr std::uint8_t vtk_tetrahedron = 10, vtk_hexahedron = 12;

template <class T, class Derived>
DataArray array_of(const std::string& name, const Eigen::PlainObjectBase<Derived>& matrix) {
  return {name, static_cast<int>(Derived::ColsAtCompileTime),
          std::vector<T>(matrix.data(), matrix.data() + matrix.size())};
}

// The same, which leaves the matrix empty.
template <class T, class Derived>
DataArray take_array(const std::string& name, Eigen::PlainObjectBase<Derived>& matrix) {
  DataArray array = array_of<T>(name, matrix);
  matrix.resize(0, Derived::ColsAtCompileTime);
  return array;
}

template <class Matrix>
void append_cells(UnstructuredGrid& grid, const Matrix& cells, std::uint8_t type) {
  grid.connectivity.reserve(grid.connectivity.size() + static_cast<std::size_t>(cells.size()));
  grid.offsets.reserve(grid.offsets.size() + static_cast<std::size_t>(cells.rows()));
  grid.types.reserve(grid.types.size() + static_cast<std::size_t>(cells.rows()));
  for (Eigen::Index c = 0; c < cells.rows(); ++c) {
    for (Eigen::Index k = 0; k < cells.cols(); ++k) grid.connectivity.push_back(cells(c, k));
    grid.offsets.push_back(static_cast<std::int64_t>(grid.connectivity.size()));
    grid.types.push_back(type);
  }
}

// The cells [first, first + count) as rows of a matrix.
template <class Matrix>
Matrix cells_of(const std::string& path, const UnstructuredGrid& grid, std::size_t first, std::size_t count,
                std::uint8_t type) {
  Matrix cells(static_cast<Eigen::Index>(count), Matrix::ColsAtCompileTime);
  for (std::size_t c = 0; c < count; ++c) {
    if (grid.types[first + c] != type)
      throw InputError(
          fmt::format("{}: cell {} has the type {}; expected {}", path, first + c, grid.types[first + c], type));
    for (Eigen::Index k = 0; k < cells.cols(); ++k)
      cells(static_cast<Eigen::Index>(c), k) =
          static_cast<std::int32_t>(grid.connectivity[static_cast<std::size_t>(grid.offsets[first + c] + k)]);
  }
  return cells;
}

void check_point_count(const std::string& path, const UnstructuredGrid& grid) {
  if (grid.points.rows() > 2147483647) throw InputError(path + ": more than 2147483647 points");
}

// The values of an array that must be there with this type and shape.
template <class T>
const std::vector<T>& values_of(const std::string& path, const DataArray* array, const std::string& name, int columns,
                                std::size_t rows) {
  if (array == nullptr) throw InputError(fmt::format("{}: not a polygrid: the array {} is missing", path, name));
  const auto* values = std::get_if<std::vector<T>>(&array->values);
  if (values == nullptr) throw InputError(fmt::format("{}: the array {} has the wrong type", path, name));
  if (array->columns != columns || values->size() != rows * static_cast<std::size_t>(columns))
    throw InputError(fmt::format("{}: the array {} has {} values in {} columns; expected {}×{}", path, name,
                                 values->size(), array->columns, rows, columns));
  return *values;
}

template <class Matrix, class T>
Matrix matrix_of(const std::vector<T>& values) {
  return Eigen::Map<const Matrix>(values.data(), static_cast<Eigen::Index>(values.size()) / Matrix::ColsAtCompileTime,
                                  Matrix::ColsAtCompileTime);
}

void check_indices(const std::string& path, const std::string& name, const std::vector<std::int32_t>& indices,
                   std::int64_t least, std::int64_t end) {
  for (std::int32_t index : indices)
    if (index < least || index >= end)
      throw InputError(fmt::format("{}: the array {} holds {}, which is out of range", path, name, index));
}

// A graph's arrays. Of the finest level they stand among the fields, with `graph_` in front.
void move_graph(PolygridGraph graph, const std::string& prefix, std::vector<DataArray>& to) {
  to.push_back(take_array<double>(prefix + "interior", graph.interior));
  to.push_back(take_array<double>(prefix + "boundary", graph.boundary));
  to.push_back(take_array<double>(prefix + "boundary_normal", graph.boundary_normal));
  to.push_back({prefix + "boundary_owner", 1, std::move(graph.boundary_owner)});
  to.push_back({prefix + "boundary_distance", 1, std::move(graph.boundary_distance)});
  to.push_back(take_array<std::int32_t>(prefix + "links", graph.links));
  to.push_back(take_array<double>(prefix + "weights", graph.weights));
  to.push_back({prefix + "weight_condition", 1, std::move(graph.weight_condition)});
  to.push_back({prefix + "weight_method", 1, std::move(graph.weight_method)});
}

const DataArray* find_array(const std::vector<DataArray>& arrays, const std::string& name) {
  for (const DataArray& array : arrays)
    if (array.name == name) return &array;
  return nullptr;
}

std::size_t row_count(const DataArray* array, int columns) {
  if (array == nullptr) return 0;
  return std::visit([&](const auto& v) { return v.size() / static_cast<std::size_t>(columns); }, array->values);
}

PolygridGraph graph_of(const std::string& path, const std::vector<DataArray>& arrays, const std::string& prefix) {
  const auto field = [&]<class T>(T, const std::string& name, int columns, std::size_t rows) -> const std::vector<T>& {
    return values_of<T>(path, find_array(arrays, prefix + name), prefix + name, columns, rows);
  };
  PolygridGraph graph;
  const std::size_t interior = row_count(find_array(arrays, prefix + "interior"), 3);
  const std::size_t boundary = row_count(find_array(arrays, prefix + "boundary"), 3);
  graph.interior = matrix_of<VertexMatrix>(field(double{}, "interior", 3, interior));
  graph.boundary = matrix_of<VertexMatrix>(field(double{}, "boundary", 3, boundary));
  graph.boundary_normal = matrix_of<VertexMatrix>(field(double{}, "boundary_normal", 3, boundary));
  graph.boundary_owner = field(std::int32_t{}, "boundary_owner", 1, boundary);
  graph.boundary_distance = field(double{}, "boundary_distance", 1, boundary);
  const std::vector<std::int32_t>& links = field(std::int32_t{}, "links", 6, interior);
  graph.links = matrix_of<decltype(graph.links)>(links);
  graph.weights = matrix_of<decltype(graph.weights)>(field(double{}, "weights", 6, interior));
  graph.weight_condition = field(double{}, "weight_condition", 1, interior);
  graph.weight_method = field(std::uint8_t{}, "weight_method", 1, interior);
  check_indices(path, prefix + "boundary_owner", graph.boundary_owner, 0, static_cast<std::int64_t>(interior));
  check_indices(path, prefix + "links", links, -static_cast<std::int64_t>(boundary),
                static_cast<std::int64_t>(interior));
  return graph;
}

// The next coarser level of a graph with so many nodes; `finer`: of a graph that was read, for its boundary.
PolygridLevel level_of(const std::string& path, const std::vector<DataArray>& arrays, std::size_t finer_nodes,
                       const PolygridGraph* finer) {
  PolygridLevel level;
  if (finer) level.graph = graph_of(path, arrays, "");
  const std::size_t nodes = row_count(find_array(arrays, "lattice"), 3);
  const auto array = [&](const std::string& name, int columns, std::size_t rows) -> const std::vector<std::int32_t>& {
    return values_of<std::int32_t>(path, find_array(arrays, name), name, columns, rows);
  };
  level.lattice = matrix_of<decltype(level.lattice)>(array("lattice", 3, nodes));
  if (finer && static_cast<std::size_t>(level.graph.interior.rows()) != nodes)
    throw InputError(
        fmt::format("{}: the array lattice has {} rows; expected {}", path, nodes, level.graph.interior.rows()));
  level.parent = array("parent", 1, finer_nodes);
  check_indices(path, "parent", level.parent, 0, static_cast<std::int64_t>(nodes));
  if (!finer) return level;
  level.boundary_parent = array("boundary_parent", 1, finer->boundary_owner.size());
  check_indices(path, "boundary_parent", level.boundary_parent, -1,
                static_cast<std::int64_t>(level.graph.boundary_owner.size()));
  return level;
}

}  // namespace

void write_tetrahedra(const std::string& path, const TetrahedralMesh& mesh) {
  UnstructuredGrid grid;
  grid.points = mesh.points;
  grid.offsets = {0};
  append_cells(grid, mesh.tetrahedra, vtk_tetrahedron);
  write_vtkhdf(path, grid);
}

TetrahedralMesh read_tetrahedra(const std::string& path) {
  const UnstructuredGrid grid = read_vtkhdf(path);
  check_point_count(path, grid);
  if (grid.types.empty()) throw InputError(path + ": the file holds no tetrahedra");
  return {grid.points, cells_of<TetMatrix>(path, grid, 0, grid.types.size(), vtk_tetrahedron)};
}

void write_polygrid(const std::string& path, Polygrid polygrid) {
  UnstructuredGrid grid;
  grid.points = std::move(polygrid.points);
  grid.offsets = {0};
  append_cells(grid, polygrid.cells, vtk_hexahedron);
  polygrid.cells.resize(0, 8);
  grid.point_data.push_back(take_array<std::int32_t>("lattice", polygrid.point_lattice));
  grid.point_data.push_back({"outer_twin", 1, std::move(polygrid.outer_twin)});
  grid.point_data.push_back(take_array<double>("normal", polygrid.point_normal));
  grid.cell_data.push_back({"layer", 1, std::move(polygrid.cell_layer)});
  grid.cell_data.push_back(take_array<std::int32_t>("cell_lattice", polygrid.cell_lattice));
  grid.field_data.push_back(take_array<std::int32_t>("boundary_quads", polygrid.boundary_quads));
  move_graph(std::move(polygrid.graph), "graph_", grid.field_data);
  for (PolygridLevel& level : polygrid.hierarchy) {
    std::vector<DataArray>& arrays = grid.levels.emplace_back();
    move_graph(std::move(level.graph), "", arrays);
    arrays.push_back(take_array<std::int32_t>("lattice", level.lattice));
    arrays.push_back({"parent", 1, std::move(level.parent)});
    arrays.push_back({"boundary_parent", 1, std::move(level.boundary_parent)});
  }
  grid.attributes["spacing"] = polygrid.spacing;
  write_vtkhdf(path, grid);
}

Polygrid read_polygrid(const std::string& path, PolygridParts parts) {
  const bool whole = parts == PolygridParts::all;
  const UnstructuredGrid grid = read_vtkhdf(path, [&](const std::string& name, int level) {
    return whole ||
           (level > 0 ? name == "lattice" || name == "parent" : name != "normal" && !name.starts_with("graph_"));
  });
  check_point_count(path, grid);
  if (grid.types.empty()) throw InputError(path + ": the file holds no cells");
  const auto points = static_cast<std::size_t>(grid.points.rows());
  const std::size_t cells = grid.types.size();
  Polygrid polygrid;
  polygrid.points = grid.points;
  polygrid.cells = cells_of<HexMatrix>(path, grid, 0, cells, vtk_hexahedron);
  polygrid.cell_layer = values_of<std::uint8_t>(path, grid.find_cell("layer"), "layer", 1, cells);
  polygrid.cell_lattice = matrix_of<decltype(polygrid.cell_lattice)>(
      values_of<std::int32_t>(path, grid.find_cell("cell_lattice"), "cell_lattice", 3, cells));
  polygrid.point_lattice = matrix_of<decltype(polygrid.point_lattice)>(
      values_of<std::int32_t>(path, grid.find_point("lattice"), "lattice", 3, points));
  polygrid.outer_twin = values_of<std::int32_t>(path, grid.find_point("outer_twin"), "outer_twin", 1, points);
  if (whole)
    polygrid.point_normal =
        matrix_of<VertexMatrix>(values_of<double>(path, grid.find_point("normal"), "normal", 3, points));
  const DataArray* quads = grid.find_field("boundary_quads");
  const std::vector<std::int32_t>& quad_points =
      values_of<std::int32_t>(path, quads, "boundary_quads", 4, row_count(quads, 4));
  polygrid.boundary_quads = matrix_of<QuadMatrix>(quad_points);
  const auto spacing = grid.attributes.find("spacing");
  if (spacing == grid.attributes.end()) throw InputError(path + ": not a polygrid: the array spacing is missing");
  polygrid.spacing = spacing->second;

  if (whole) polygrid.graph = graph_of(path, grid.field_data, "graph_");
  auto nodes = static_cast<std::size_t>(std::count(polygrid.cell_layer.begin(), polygrid.cell_layer.end(), 0));
  if (whole) nodes = static_cast<std::size_t>(polygrid.graph.interior.rows());
  for (const std::vector<DataArray>& arrays : grid.levels) {
    const PolygridGraph* finer = polygrid.hierarchy.empty() ? &polygrid.graph : &polygrid.hierarchy.back().graph;
    polygrid.hierarchy.push_back(level_of(fmt::format("{}: hierarchy/{}", path, polygrid.hierarchy.size() + 1), arrays,
                                          nodes, whole ? finer : nullptr));
    nodes = static_cast<std::size_t>(polygrid.hierarchy.back().lattice.rows());
  }

  const auto signed_points = static_cast<std::int64_t>(points);
  check_indices(path, "outer_twin", polygrid.outer_twin, -1, signed_points);
  check_indices(path, "boundary_quads", quad_points, 0, signed_points);
  return polygrid;
}

}  // namespace shellgrid
