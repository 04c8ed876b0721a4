// SPDX-License-Identifier: AGPL-3.0-or-later
#include "meshing/polycube/boundary_layer.h"

#include <Eigen/Geometry>
#include <algorithm>
#include <cmath>

#include "meshing/core/parallel.h"

namespace shellgrid {
namespace {

// Relative to the target volume of a cell: what counts as inverted while there is a choice.
constexpr double jacobian_margin = 1e-3;
// Cells below this are improved.
constexpr double poor_scaled_jacobian = 0.1;
// Outer points farther from the surface than this, in cells, are drawn back to it.
constexpr double surface_tolerance = 2e-3;

std::size_t cell_count(const LayeredGrid& grid) { return grid.core.cells.size() + grid.layer.size(); }

const LatticeHexahedron& cell_at(const LayeredGrid& grid, std::size_t c) {
  return c < grid.core.cells.size() ? grid.core.cells[c] : grid.layer[c - grid.core.cells.size()];
}

Vec3i lattice_at(const LayeredGrid& grid, std::size_t c) {
  return grid.core
      .cell_lattice[c < grid.core.cells.size() ? c : grid.core.boundary_quads[c - grid.core.cells.size()].cell];
}

// Cells that hold each point.
struct Incidence {
  std::vector<std::int32_t> first, cells;
  explicit Incidence(const LayeredGrid& grid) : first(grid.points.rows() + 1, 0) {
    for (std::size_t c = 0; c < cell_count(grid); ++c)
      for (std::int32_t p : cell_at(grid, c)) ++first[p + 1];
    for (std::size_t p = 0; p + 1 < first.size(); ++p) first[p + 1] += first[p];
    cells.resize(first.back());
    std::vector<std::int32_t> next(first.begin(), first.end() - 1);
    for (std::size_t c = 0; c < cell_count(grid); ++c)
      for (std::int32_t p : cell_at(grid, c)) cells[next[p]++] = static_cast<std::int32_t>(c);
  }
};

double relative_jacobian(const LayeredGrid& grid, std::size_t c, double thickness) {
  return least_jacobian(grid.points, cell_at(grid, c)) / (c < grid.core.cells.size() ? 1.0 : thickness);
}

std::vector<std::int32_t> cells_below(const LayeredGrid& grid, double thickness, double margin) {
  std::vector<std::uint8_t> low(cell_count(grid));
  parallel_for(low.size(), [&](std::size_t c) { low[c] = !(relative_jacobian(grid, c, thickness) > margin); });
  std::vector<std::int32_t> result;
  for (std::size_t c = 0; c < low.size(); ++c)
    if (low[c]) result.push_back(static_cast<std::int32_t>(c));
  return result;
}

Vec3 outer_normal(const LayeredGrid& grid, const VertexMatrix& normals, std::size_t outer) {
  return normals.row(grid.twin[outer]).transpose().stableNormalized();
}

class LayerRepair {
 public:
  LayerRepair(LayeredGrid& grid, const TargetSurface& surface, double scale, double thickness)
      : grid_(grid),
        surface_(surface),
        scale_(scale),
        thickness_(thickness),
        incidence_(grid),
        weight_(cell_count(grid), 1.0) {}

  // One round on the given cells and `rings` around them: untangle, then improve without inverting.
  void mend(const std::vector<std::int32_t>& bad, int rings, double surface_weight) {
    for (std::int32_t c : bad)
      if (scaled_jacobian(grid_.points, cell_at(grid_, c)) < poor_scaled_jacobian)
        weight_[c] = std::min(64.0, weight_[c] * 2);
    std::vector<std::uint8_t> chosen(cell_count(grid_), 0);
    std::vector<std::int32_t> region = bad, front = bad;
    for (std::int32_t c : bad) chosen[c] = 1;
    for (int ring = 0; ring < rings; ++ring) {
      std::vector<std::int32_t> next;
      for (std::int32_t c : front)
        for (std::int32_t p : cell_at(grid_, c))
          for (std::int32_t n = incidence_.first[p]; n < incidence_.first[p + 1]; ++n)
            if (!chosen[incidence_.cells[n]]) chosen[incidence_.cells[n]] = 1, next.push_back(incidence_.cells[n]);
      region.insert(region.end(), next.begin(), next.end());
      front.swap(next);
    }
    std::sort(region.begin(), region.end());

    // The region as a mesh of its own; points that other cells hold as well are locked.
    std::vector<std::int32_t> local(grid_.points.rows(), -1), global;
    std::vector<LatticeHexahedron> cells;
    std::vector<Vec3i> lattice;
    std::vector<double> heights, weights;
    for (std::int32_t c : region) {
      LatticeHexahedron cell = cell_at(grid_, c);
      for (std::int32_t& p : cell) {
        if (local[p] < 0) local[p] = static_cast<std::int32_t>(global.size()), global.push_back(p);
        p = local[p];
      }
      cells.push_back(cell);
      lattice.push_back(lattice_at(grid_, c));
      const bool core = static_cast<std::size_t>(c) < grid_.core.cells.size();
      heights.push_back(core ? 1.0 : thickness_);
      weights.push_back(weight_[c]);
    }
    HexahedraOptimization optimization(std::move(cells), lattice, std::move(heights));
    optimization.cell_weight = std::move(weights);
    optimization.locked.assign(global.size(), 0);
    VertexMatrix points(global.size(), 3);
    for (std::size_t p = 0; p < global.size(); ++p) {
      points.row(p) = grid_.points.row(global[p]);
      for (std::int32_t n = incidence_.first[global[p]]; n < incidence_.first[global[p] + 1]; ++n)
        if (!chosen[incidence_.cells[n]]) optimization.locked[p] = 1;
    }
    const VertexMatrix normals = boundary_normals(grid_.core);
    const auto attract = [&](double weight) {
      optimization.plane_attractions.clear();
      for (std::size_t p = 0; p < global.size(); ++p) {
        const std::int64_t outer = global[p] - grid_.core.points.rows();
        if (outer < 0 || optimization.locked[p]) continue;
        const TargetSurface::Nearest nearest = surface_.nearest_facing(
            points.row(p).transpose() / scale_, outer_normal(grid_, normals, static_cast<std::size_t>(outer)));
        optimization.plane_attractions.push_back(
            {static_cast<std::int32_t>(p), nearest.point * scale_, nearest.normal, weight, 0.02});
      }
    };
    for (int step = 0; step < 12; ++step) {
      attract(surface_weight);
      const double lowest = optimization.least_corner_jacobian(points);
      if (lowest > jacobian_margin) {
        optimization.minimize(points, 40, 0);
        if (step >= 2) break;
        continue;
      }
      const double reach = 0.5 * (std::sqrt(1e-12 + lowest * lowest) + lowest) + 0.02;
      optimization.minimize(points, 40, 2 * std::sqrt(reach * (reach - std::min(lowest, 0.0))));
    }
    for (std::size_t p = 0; p < global.size(); ++p) grid_.points.row(global[p]) = points.row(p);
    grid_.core.points = grid_.points.topRows(grid_.core.points.rows());
  }

  // Cells of poor shape, and those at outer points that are off the surface.
  std::vector<std::int32_t> cells_to_improve() const {
    std::vector<std::uint8_t> poor(cell_count(grid_));
    parallel_for(poor.size(), [&](std::size_t c) {
      poor[c] = scaled_jacobian(grid_.points, cell_at(grid_, c)) < poor_scaled_jacobian;
    });
    std::vector<std::uint8_t> off(grid_.twin.size());
    parallel_for(off.size(), [&](std::size_t outer) {
      const Vec3 place = grid_.points.row(grid_.core.points.rows() + static_cast<Eigen::Index>(outer)).transpose();
      off[outer] = surface_.nearest(place / scale_).distance * scale_ > surface_tolerance;
    });
    for (std::size_t outer = 0; outer < off.size(); ++outer) {
      const std::size_t p = static_cast<std::size_t>(grid_.core.points.rows()) + outer;
      for (std::int32_t n = incidence_.first[p]; off[outer] && n < incidence_.first[p + 1]; ++n)
        poor[incidence_.cells[n]] = 1;
    }
    std::vector<std::int32_t> result;
    for (std::size_t c = 0; c < poor.size(); ++c)
      if (poor[c]) result.push_back(static_cast<std::int32_t>(c));
    return result;
  }

  // Moves outer points onto the surface, each only as far as its cells stay valid.
  void snap() {
    const VertexMatrix normals = boundary_normals(grid_.core);
    for (std::size_t outer = 0; outer < grid_.twin.size(); ++outer) {
      const Eigen::Index p = grid_.core.points.rows() + static_cast<Eigen::Index>(outer);
      const Vec3 place = grid_.points.row(p).transpose();
      // Along the link's own normal first, else to the nearest point as it is.
      const TargetSurface::Nearest choices[3] = {
          surface_.nearest_facing(grid_.points.row(grid_.twin[outer]).transpose() / scale_,
                                  outer_normal(grid_, normals, outer)),
          surface_.nearest_facing(place / scale_, outer_normal(grid_, normals, outer)),
          surface_.nearest(place / scale_)};
      const double off = choices[2].distance * scale_;
      if (off < 1e-9) continue;
      bool done = false;
      for (double part : {1.0, 0.5, 0.25}) {
        for (const TargetSurface::Nearest& choice : choices) {
          grid_.points.row(p) = (place + part * (choice.point * scale_ - place)).transpose();
          if (part < 1 && &choice != &choices[2]) continue;
          done = true;
          for (std::int32_t n = incidence_.first[p]; n < incidence_.first[p + 1] && done; ++n)
            done = relative_jacobian(grid_, incidence_.cells[n], thickness_) > jacobian_margin;
          if (done) break;
        }
        if (done) break;
      }
      if (!done) grid_.points.row(p) = place.transpose();
    }
  }

 private:
  LayeredGrid& grid_;
  const TargetSurface& surface_;
  double scale_, thickness_;
  Incidence incidence_;
  std::vector<double> weight_;
};

}  // namespace

std::vector<std::int32_t> inverted_cells(const LayeredGrid& grid) { return cells_below(grid, 1.0, 0.0); }

namespace {

// Core and layer with the outer points still at their twins.
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

}  // namespace

LayeredGrid layer_on_lattice(const std::vector<Vec3i>& blocks, int refinement, const TargetSurface& surface,
                             double scale, double thickness) {
  LayeredGrid grid = with_flat_layer(refine_blocks(blocks, refinement));
  const VertexMatrix normals = boundary_normals(grid.core);
  for (std::size_t outer = 0; outer < grid.twin.size(); ++outer) {
    // One step along each axis that a boundary face looks to: seen by all of them unless two look at each other.
    const Vec3 step = normals.row(grid.twin[outer]).transpose().array().sign().matrix();
    grid.points.row(grid.core.points.rows() + static_cast<Eigen::Index>(outer)) += thickness * step.transpose();
  }
  LayerRepair repair(grid, surface, scale, thickness);
  for (int round = 0; round < 12; ++round) {
    const std::vector<std::int32_t> bad = cells_below(grid, thickness, jacobian_margin);
    if (bad.empty()) break;
    repair.mend(bad, 2, 0);
  }
  return grid;
}

LayeredGrid add_boundary_layer(LatticeGrid core, const TargetSurface& surface, double scale, double thickness,
                               Progress& progress) {
  LayeredGrid grid = with_flat_layer(std::move(core));
  const VertexMatrix normals = boundary_normals(grid.core);
  parallel_for(grid.twin.size(), [&](std::size_t outer) {
    const Vec3 place = grid.core.points.row(grid.twin[outer]).transpose();
    const Vec3 facing = outer_normal(grid, normals, outer);
    const TargetSurface::Nearest nearest = surface.nearest_facing(place / scale, facing);
    grid.points.row(grid.core.points.rows() + static_cast<Eigen::Index>(outer)) = (nearest.point * scale).transpose();
  });

  LayerRepair repair(grid, surface, scale, thickness);
  progress.begin("boundary layer", 0);
  double weight = 256;
  for (int round = 0; round < 20; ++round) {
    const std::vector<std::int32_t> bad = cells_below(grid, thickness, jacobian_margin);
    if (bad.empty()) break;
    repair.mend(bad, 2 + round / 3, weight);
    if (round >= 2) weight = std::max(0.01, weight / 2.5);
  }
  repair.snap();
  // What mending left off the surface or badly shaped, at a growing pull of the surface; valid cells stay valid.
  if (cells_below(grid, thickness, jacobian_margin).empty())
    for (int round = 0; round < 4; ++round) {
      const std::vector<std::int32_t> poor = repair.cells_to_improve();
      if (poor.empty()) break;
      const VertexMatrix before = grid.points;
      repair.mend(poor, 3, 256 * std::pow(2.5, round));
      if (!cells_below(grid, thickness, jacobian_margin).empty()) {
        grid.points = before;
        grid.core.points = before.topRows(grid.core.points.rows());
        break;
      }
      repair.snap();
    }
  progress.end();
  return grid;
}

}  // namespace shellgrid
