// SPDX-License-Identifier: AGPL-3.0-or-later
#include "meshing/formats/polycube_file.h"

#include <algorithm>
#include <cmath>

#include "meshing/core/error.h"
#include "meshing/formats/vtkhdf_file.h"
#include "meshing/polycube/polycube_map.h"

namespace shellgrid {

void write_polycube(const std::string& path, const VoxelPolycube& polycube) {
  constexpr int vtk_corner[8] = {0, 1, 3, 2, 4, 5, 7, 6};
  const LatticeGrid blocks = refine_blocks(polycube.blocks, 1);
  UnstructuredGrid grid;
  grid.points = blocks.points * (polycube.spacing * polycube.cells_per_block);
  grid.points.rowwise() += polycube.origin.transpose();
  grid.offsets.push_back(0);
  std::vector<std::int32_t> lattice;
  for (std::size_t b = 0; b < blocks.cells.size(); ++b) {
    for (int k = 0; k < 8; ++k) grid.connectivity.push_back(blocks.cells[b][vtk_corner[k]]);
    grid.offsets.push_back(static_cast<std::int64_t>(grid.connectivity.size()));
    grid.types.push_back(12);
    for (int axis = 0; axis < 3; ++axis) lattice.push_back(blocks.cell_lattice[b][axis]);
  }
  grid.cell_data.push_back({"lattice", 3, std::move(lattice)});
  grid.attributes = {{"spacing", polycube.spacing},
                     {"cells_per_block", static_cast<double>(polycube.cells_per_block)},
                     {"origin_x", polycube.origin.x()},
                     {"origin_y", polycube.origin.y()},
                     {"origin_z", polycube.origin.z()},
                     {"object_genus", static_cast<double>(polycube.object_genus)},
                     {"genus", static_cast<double>(polycube.genus)},
                     {"singular_edges", static_cast<double>(polycube.singular_edges)},
                     {"singular_corners", static_cast<double>(polycube.singular_corners)},
                     {"coverage_p99", polycube.coverage_p99},
                     {"coverage_max", polycube.coverage_max}};
  write_vtkhdf(path, grid);
}

VoxelPolycube read_polycube(const std::string& path) {
  const UnstructuredGrid grid = read_vtkhdf(path);
  const DataArray* lattice = grid.find_cell("lattice");
  const std::vector<std::int32_t>* values =
      lattice ? std::get_if<std::vector<std::int32_t>>(&lattice->values) : nullptr;
  const auto attribute = [&](const std::string& name) {
    const auto found = grid.attributes.find(name);
    if (found == grid.attributes.end() || !std::isfinite(found->second))
      throw InputError(path + ": no attribute `" + name + "`; expected a polycube of sg-polycube");
    return found->second;
  };
  if (!values || lattice->columns != 3 || values->size() != 3 * grid.types.size() || values->empty())
    throw InputError(path + ": no cell array `lattice` of three integers; expected a polycube of sg-polycube");
  VoxelPolycube polycube;
  polycube.spacing = attribute("spacing");
  const double per_block = attribute("cells_per_block");
  if (!(polycube.spacing > 0) || !(per_block >= 1 && per_block <= 1024) || per_block != std::floor(per_block))
    throw InputError(path + ": spacing or cells_per_block out of range");
  polycube.cells_per_block = static_cast<int>(per_block);
  polycube.origin = {attribute("origin_x"), attribute("origin_y"), attribute("origin_z")};
  const auto whole = [&](const std::string& name) { return static_cast<int>(std::clamp(attribute(name), -1e6, 1e9)); };
  polycube.object_genus = whole("object_genus");
  polycube.genus = whole("genus");
  polycube.singular_edges = whole("singular_edges");
  polycube.singular_corners = whole("singular_corners");
  polycube.coverage_p99 = attribute("coverage_p99");
  polycube.coverage_max = attribute("coverage_max");
  polycube.blocks.resize(grid.types.size());
  for (std::size_t b = 0; b < polycube.blocks.size(); ++b)
    for (int axis = 0; axis < 3; ++axis) {
      const std::int32_t place = (*values)[3 * b + axis];
      if (place < 0 || place >= 1024)
        throw InputError(path + ": block " + std::to_string(b) + " has the lattice coordinate " +
                         std::to_string(place) + "; expected 0 to 1023");
      polycube.blocks[b][axis] = place;
    }
  const auto before = [](const Vec3i& a, const Vec3i& b) {
    return a.z() != b.z() ? a.z() < b.z() : a.y() != b.y() ? a.y() < b.y() : a.x() < b.x();
  };
  std::sort(polycube.blocks.begin(), polycube.blocks.end(), before);
  if (std::adjacent_find(polycube.blocks.begin(), polycube.blocks.end()) != polycube.blocks.end())
    throw InputError(path + ": two blocks have the same lattice coordinates");
  return polycube;
}

}  // namespace shellgrid
