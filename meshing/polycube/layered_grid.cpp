// SPDX-License-Identifier: AGPL-3.0-or-later
#include "meshing/polycube/layered_grid.h"

#include "meshing/core/parallel.h"

namespace shellgrid {
namespace {

// Determinants in cells³ that count as positive.
constexpr double safely_positive = 1e-10;
}  // namespace

LayeredGrid with_flat_layer(LatticeGrid core) {
  LayeredGrid grid;
  std::vector<std::int32_t> outer_of(core.points.rows(), -1);
  for (const auto& quad : core.boundary_quads)
    for (std::int32_t p : quad.corners) outer_of[p] = 0;
  for (std::size_t p = 0; p < outer_of.size(); ++p)
    if (outer_of[p] == 0) {
      outer_of[p] = static_cast<std::int32_t>(core.points.rows() + static_cast<Eigen::Index>(grid.twin.size()));
      grid.twin.push_back(static_cast<std::int32_t>(p));
    }
  for (const auto& quad : core.boundary_quads) {
    const auto& q = quad.corners;
    grid.layer.push_back({q[0], q[1], q[3], q[2], outer_of[q[0]], outer_of[q[1]], outer_of[q[3]], outer_of[q[2]]});
  }
  grid.core = std::move(core);
  grid.points.resize(grid.core.points.rows() + static_cast<Eigen::Index>(grid.twin.size()), 3);
  grid.points.topRows(grid.core.points.rows()) = grid.core.points;
  for (std::size_t outer = 0; outer < grid.twin.size(); ++outer)
    grid.points.row(grid.core.points.rows() + static_cast<Eigen::Index>(outer)) =
        grid.core.points.row(grid.twin[outer]);
  return grid;
}

std::vector<LatticeHexahedron> all_cells(const LayeredGrid& grid) {
  std::vector<LatticeHexahedron> cells = grid.core.cells;
  cells.insert(cells.end(), grid.layer.begin(), grid.layer.end());
  return cells;
}

std::vector<std::int32_t> inverted_cells(const LayeredGrid& grid) {
  std::vector<std::uint8_t> inverted(grid.core.cells.size() + grid.layer.size());
  parallel_for(inverted.size(), [&](std::size_t c) {
    const std::size_t core = grid.core.cells.size();
    // With a margin for rounding where the points are put into millimetres.
    inverted[c] = !(least_jacobian(grid.points, c < core ? grid.core.cells[c] : grid.layer[c - core], safely_positive) >
                    safely_positive);
  });
  std::vector<std::int32_t> result;
  for (std::size_t c = 0; c < inverted.size(); ++c)
    if (inverted[c]) result.push_back(static_cast<std::int32_t>(c));
  return result;
}

}  // namespace shellgrid
