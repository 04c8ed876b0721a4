// SPDX-License-Identifier: AGPL-3.0-or-later
// A polygrid on the lattice itself, without optimisation: for tests of what only asks who is whose neighbour.
#pragma once
#include <algorithm>
#include <vector>

#include "meshing/core/error.h"
#include "meshing/polycube/polycube_map.h"
#include "meshing/polycube/polygrid.h"

namespace shellgrid::test {

inline std::vector<Vec3i> sorted_blocks(std::vector<Vec3i> blocks) {
  std::sort(blocks.begin(), blocks.end(), [](const Vec3i& a, const Vec3i& b) {
    return a.z() != b.z() ? a.z() < b.z() : a.y() != b.y() ? a.y() < b.y() : a.x() < b.x();
  });
  return blocks;
}

// Unit cells, n³ a block, and a thin layer of the given thickness above each boundary quad: every boundary point must
// see all its faces. The graph has its nodes and links, no weights.
inline Polygrid lattice_polygrid(const std::vector<Vec3i>& blocks, int n, double layer = 0.1) {
  constexpr int vtk_corner[8] = {0, 1, 3, 2, 4, 5, 7, 6};
  const LatticeGrid core = refine_blocks(sorted_blocks(blocks), n);
  const VertexMatrix normals = boundary_normals(core);
  Polygrid grid;
  grid.spacing = 1;
  const auto points = static_cast<Eigen::Index>(core.point_lattice.size());
  std::vector<std::int32_t> outer_of(points, -1);
  std::vector<std::int32_t> twins;
  for (const auto& quad : core.boundary_quads)
    for (std::int32_t p : quad.corners)
      if (outer_of[p] < 0) {
        outer_of[p] = static_cast<std::int32_t>(points + static_cast<Eigen::Index>(twins.size()));
        twins.push_back(p);
      }
  const auto outer = static_cast<Eigen::Index>(twins.size());
  grid.points.resize(points + outer, 3);
  grid.points.topRows(points) = core.points;
  grid.point_lattice.resize(points + outer, 3);
  grid.outer_twin.assign(points + outer, -1);
  for (Eigen::Index p = 0; p < points; ++p) grid.point_lattice.row(p) = core.point_lattice[p].transpose();
  for (Eigen::Index o = 0; o < outer; ++o) {
    grid.points.row(points + o) = core.points.row(twins[o]);
    for (int axis = 0; axis < 3; ++axis)
      if (normals(twins[o], axis) != 0) grid.points(points + o, axis) += normals(twins[o], axis) > 0 ? layer : -layer;
    grid.point_lattice.row(points + o) = core.point_lattice[twins[o]].transpose();
    grid.outer_twin[points + o] = twins[o];
  }
  grid.point_normal = VertexMatrix::Zero(points + outer, 3);
  const auto cells = static_cast<Eigen::Index>(core.cells.size());
  const auto quads = static_cast<Eigen::Index>(core.boundary_quads.size());
  grid.cells.resize(cells + quads, 8);
  grid.cell_lattice.resize(cells + quads, 3);
  grid.cell_layer.assign(cells + quads, 0);
  PolygridGraph& graph = grid.graph;
  graph.interior.resize(cells, 3);
  graph.links.setConstant(cells, 6, 0);
  for (Eigen::Index c = 0; c < cells; ++c) {
    for (int k = 0; k < 8; ++k) grid.cells(c, k) = core.cells[c][vtk_corner[k]];
    grid.cell_lattice.row(c) = core.cell_lattice[c].transpose();
    graph.interior.row(c) = (core.cell_lattice[c].cast<double>() + Vec3::Constant(0.5)).transpose();
    for (Eigen::Index d = 0; d < cells; ++d)
      for (int side = 0; side < 6; ++side)
        if (core.cell_lattice[d] == core.cell_lattice[c] + (side & 1 ? 1 : -1) * Vec3i::Unit(side / 2))
          graph.links(c, side) = static_cast<std::int32_t>(d);
  }
  grid.boundary_quads.resize(quads, 4);
  graph.boundary.resize(quads, 3);
  graph.boundary_normal.setZero(quads, 3);
  for (Eigen::Index q = 0; q < quads; ++q) {
    const LatticeGrid::BoundaryQuad& quad = core.boundary_quads[q];
    for (int k = 0; k < 4; ++k) {
      grid.boundary_quads(q, k) = outer_of[quad.corners[k]];
      grid.cells(cells + q, k) = quad.corners[k];
      grid.cells(cells + q, 4 + k) = outer_of[quad.corners[k]];
    }
    grid.cell_lattice.row(cells + q) = core.cell_lattice[quad.cell].transpose();
    grid.cell_layer[cells + q] = 1;
    const Vec3 direction = (quad.side & 1 ? 1 : -1) * Vec3::Unit(quad.side / 2);
    graph.boundary.row(q) = graph.interior.row(quad.cell) + (0.5 + layer) * direction.transpose();
    graph.boundary_normal.row(q) = direction.transpose();
    graph.boundary_owner.push_back(quad.cell);
    graph.boundary_distance.push_back(0.5 + layer);
    graph.links(quad.cell, quad.side) = static_cast<std::int32_t>(-1 - q);
  }
  graph.weights.setZero(cells, 6);
  graph.weight_condition.assign(cells, 1);
  graph.weight_method.assign(cells, 0);
  return grid;
}

// A comb: plates of `thick` blocks a gap of one block apart, joined at one end by a base.
inline std::vector<Vec3i> comb(int plates, int thick, int height, int width) {
  std::vector<Vec3i> blocks;
  const int length = plates * (thick + 1) - 1;
  for (int k = 0; k < height; ++k)
    for (int j = 0; j < width; ++j)
      for (int i = 0; i < length; ++i)
        if (k < thick || i % (thick + 1) != thick) blocks.push_back({i, j, k});
  return blocks;
}

}  // namespace shellgrid::test
