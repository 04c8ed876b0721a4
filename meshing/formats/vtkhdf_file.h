// SPDX-License-Identifier: AGPL-3.0-or-later
#pragma once
#include <cstdint>
#include <functional>
#include <map>
#include <string>
#include <variant>
#include <vector>

#include "meshing/core/tetrahedral_mesh.h"
#include "meshing/core/vec.h"
#include "meshing/polycube/polygrid.h"

namespace shellgrid {

// A named array of rows × columns.
struct DataArray {
  std::string name;
  int columns = 1;
  std::variant<std::vector<float>, std::vector<double>, std::vector<std::int32_t>, std::vector<std::int64_t>,
               std::vector<std::uint8_t>>
      values;
};

// What one VTKHDF file holds (static UnstructuredGrid, Version [1, 0]): ParaView, VTK and h5py open it.
// Source: VTKHDF file format, https://docs.vtk.org.
struct UnstructuredGrid {
  VertexMatrix points;                     // n×3, mm
  std::vector<std::int64_t> connectivity;  // point indices, cell after cell
  std::vector<std::int64_t> offsets;       // m + 1
  std::vector<std::uint8_t> types;         // m: 10 tetrahedron, 12 hexahedron, 9 quadrilateral
  std::vector<DataArray> point_data, cell_data, field_data;
  std::map<std::string, double> attributes;  // scalars in the file's FieldData group, as arrays of one
  // Arrays of the groups `hierarchy/1`, `hierarchy/2`, … beside VTKHDF, where VTK does not look.
  std::vector<std::vector<DataArray>> levels;

  const DataArray* find_point(const std::string& name) const;
  const DataArray* find_cell(const std::string& name) const;
  const DataArray* find_field(const std::string& name) const;
};

// `wanted`: whether to read an array of points, cells or fields, or one of a hierarchy's level (`level` > 0); none:
// all. Throws: InputError for a missing, truncated or foreign file, lengths that disagree, an index out of range.
using ArrayFilter = std::function<bool(const std::string& name, int level)>;
UnstructuredGrid read_vtkhdf(const std::string& path, const ArrayFilter& wanted = {});
// Same grid, same bytes (object times are off). Written atomically.
void write_vtkhdf(const std::string& path, const UnstructuredGrid& grid);

// The tetrahedral mesh of `tets.hdf`.
TetrahedralMesh read_tetrahedra(const std::string& path);
void write_tetrahedra(const std::string& path, const TetrahedralMesh& mesh);

// `cells`: all but the graphs and the surface's normals, which stay empty: less than half of the memory.
enum class PolygridParts { all, cells };
Polygrid read_polygrid(const std::string& path, PolygridParts parts = PolygridParts::all);
// Moved in, it is written from the memory that it has.
void write_polygrid(const std::string& path, Polygrid polygrid);

}  // namespace shellgrid
