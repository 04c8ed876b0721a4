// SPDX-License-Identifier: AGPL-3.0-or-later
#include "meshing/polycube/boundary_layer.h"

#include <Eigen/Geometry>
#include <algorithm>
#include <cmath>
#include <limits>
#include <map>
#include <numeric>
#include <set>

#include "meshing/core/parallel.h"
#include "meshing/polycube/hexahedra_region.h"
#include "meshing/polycube/layer_polish.h"

namespace shellgrid {
namespace {

// Relative to the target volume of a cell: what a cell keeps, and what a projected one must have from the start.
constexpr double least_relative_jacobian = 1e-6;
constexpr double projected_relative_jacobian = 0.02;
// Cells below this are improved.
constexpr double poor_scaled_jacobian = 0.14;
// Outer points farther from the surface than this, in cells, are drawn back to it.
constexpr double surface_tolerance = 2e-3;
// Links farther off the normal are improved: the cosine of 15°.
constexpr double poor_link_cosine = 0.966;
// Cells below this, and links farther off the normal than 45°, get rounds of their own.
constexpr double worst_scaled_jacobian = 0.11;
constexpr double worst_link_cosine = 0.7;
// Cells below this, and links farther off the normal than 70°, tell of folds; other links of creases as well.
constexpr double folded_scaled_jacobian = 0.05;
constexpr double folded_link_cosine = 0.34;
// In the end single points are moved where cells are below this; no more cells than these.
constexpr double polished_scaled_jacobian = 0.16;
constexpr std::size_t most_polished_cells = 1000;
// Larger regions are not laid anew.
constexpr std::size_t most_restarted_cells = 5000;
// The inner points' pull to the layer's depth, relative to the outer points' pull to the surface.
constexpr double inner_pull = 0.02;
// How far, in cells, a face that looks the same way as the grid is preferred to a nearer one.
constexpr double same_side_reach = 2;
// Links longer than this many layers are looked at for whether they leave the object.
constexpr double sure_reach = 3;

// Makes and improves the layer; a grid that is valid stays so at every step.
class LayerBuilder {
 public:
  LayerBuilder(LayeredGrid& grid, const TargetSurface& surface, double scale, double thickness)
      : grid_(grid),
        surface_(surface),
        scale_(scale),
        thickness_(thickness),
        cells_(all_cells(grid)),
        around_(cells_, static_cast<std::size_t>(grid.points.rows())) {
    samples_ = surface.samples(static_cast<int>(1.5 * static_cast<double>(grid.twin.size())));
    outer_of_.assign(grid.core.points.rows(), -1);
    for (std::size_t outer = 0; outer < grid.twin.size(); ++outer)
      outer_of_[grid.twin[outer]] = static_cast<std::int32_t>(outer);
    weight_.assign(cells_.size(), 1.0);
    inside_.assign(cells_.size(), 0);
    state_.assign(grid.twin.size(), OuterState::moved);
  }

  // Outer points at `thickness` or less from their twins towards what sees every boundary face there: valid where
  // there is such a direction.
  void set_by_visible_normals() {
    const std::vector<Vec3> direction = visible_normals(grid_.core, grid_.twin);
    std::vector<double> height(grid_.twin.size(), thickness_);
    const auto place = [&](std::size_t outer) {
      outer_row(outer) = grid_.points.row(grid_.twin[outer]) + height[outer] * direction[outer].transpose();
    };
    for (std::size_t outer = 0; outer < height.size(); ++outer) place(outer);
    std::vector<std::int32_t> suspects(grid_.layer.size());
    std::iota(suspects.begin(), suspects.end(), static_cast<std::int32_t>(grid_.core.cells.size()));
    for (int round = 0; round < 24 && !suspects.empty(); ++round) {
      std::set<std::int32_t> next;
      for (std::int32_t c : cells_below(least_relative_jacobian, suspects))
        for (std::int32_t p : cells_[c]) {
          if (p < core_points()) continue;
          const std::size_t outer = static_cast<std::size_t>(p - core_points());
          if (!(height[outer] > thickness_ * std::pow(0.5, round + 0.5))) continue;
          height[outer] *= 0.5;
          place(outer);
          next.insert(around_.begin(p), around_.end(p));
        }
      suspects.assign(next.begin(), next.end());
    }
  }

  // Moves outer points to the surface points nearest to their twins, but for those around cells that this spoils.
  void project() {
    const VertexMatrix safe = grid_.points.bottomRows(static_cast<Eigen::Index>(grid_.twin.size()));
    const VertexMatrix normals = boundary_normals(grid_.core);
    parallel_for(grid_.twin.size(),
                 [&](std::size_t outer) { outer_row(outer) = (target_of(normals, outer).point * scale_).transpose(); });
    std::vector<std::uint8_t> projected(grid_.twin.size(), 1);
    for (bool changed = true; changed;) {
      changed = false;
      for (std::int32_t c : cells_below(projected_relative_jacobian))
        for (std::int32_t p : cells_[c])
          if (p >= core_points() && projected[p - core_points()]) {
            const std::int32_t outer = static_cast<std::int32_t>(p - core_points());
            projected[outer] = 0, changed = true;
            outer_row(outer) = safe.row(outer);
          }
    }
  }

  // Lifts cells that are inverted by an energy that is finite there, without the surface's pull.
  void untangle() {
    for (int round = 0; round < 12; ++round) {
      const std::vector<std::int32_t> bad = cells_below(least_relative_jacobian);
      if (bad.empty()) return;
      for (std::int32_t c : bad) weight_[c] = std::min(64.0, weight_[c] * 2), inside_[c] = 1;
      // Regions share no point.
      const std::vector<HexahedraRegion> regions = regions_around(cells_, around_, bad, 2 + round / 3);
      parallel_for(
          regions.size(),
          [&](std::size_t r) {
            HexahedraOptimization optimization = optimization_of(regions[r]);
            VertexMatrix points = points_of(regions[r]);
            for (int step = 0; step < 6; ++step) minimize_folded(optimization, points, 40);
            put(regions[r], points);
          },
          1);
    }
  }

  // Optimises core and layer together while the outer points are drawn to the surface.
  void optimize_all(int steps, int iterations, double first_weight, double last_weight) {
    HexahedraRegion all;
    all.cells.resize(cells_.size());
    std::iota(all.cells.begin(), all.cells.end(), 0);
    all.local = cells_;
    all.points.resize(grid_.points.rows());
    std::iota(all.points.begin(), all.points.end(), 0);
    all.locked.assign(all.points.size(), 0);
    HexahedraOptimization optimization = optimization_of(all);
    optimization.single_precision = true;
    optimization.folded_shares = angular_shares;
    for (int step = 0; step < steps; ++step) {
      const double part = steps > 1 ? static_cast<double>(step) / (steps - 1) : 1.0;
      attract(all, first_weight * std::pow(last_weight / first_weight, part), optimization);
      optimization.quad_attractions = pulls(std::min(64.0, first_weight));
      VertexMatrix points = grid_.points;
      const double lowest = optimization.least_corner_jacobian(points);
      // From a valid start with ε = 0 cells that are nearly inverted would hold the others back.
      const bool safe = !inside_.empty() && inside_.front();
      const double epsilon = safe || (step + 1 == steps && lowest > 1e-3) ? 0 : 0.1 * std::pow(0.3, step);
      // Where nothing is folded any more the angles gain most.
      optimization.minimize(points, epsilon == 0 && step > 0 ? 2 * iterations : iterations, epsilon);
      put(all, points);
    }
  }

  // From a valid grid: draws it to the surface while every cell stays valid, judged inside as well.
  void approach() {
    std::fill(inside_.begin(), inside_.end(), 1);
    const VertexMatrix valid = grid_.points;
    for (double weight : {0.25, 1.0, 4.0, 16.0, 64.0}) {
      const VertexMatrix before = grid_.points;
      optimize_all(2, 30, weight, weight);
      if (is_valid()) continue;
      put_all(before);
      break;
    }
    snap(false);
    snap(true);
    if (!is_valid()) put_all(valid);
  }

  // Draws the outer points around the given cells to the surface; where they are to stay, their twins below them along
  // its normal.
  void improve(const std::vector<std::int32_t>& poor, int rings, int steps, double pull, bool keep_outer) {
    for (std::int32_t c : poor)
      if (scaled_jacobian(grid_.points, cells_[c]) < poor_scaled_jacobian) weight_[c] = std::min(64.0, weight_[c] * 2);
    // Regions share no point.
    const std::vector<HexahedraRegion> regions = regions_around(cells_, around_, poor, rings);
    std::vector<std::vector<QuadAttraction>> pulled(regions.size());
    if (!keep_outer) pulled = pulls_of(regions);
    parallel_for(
        regions.size(),
        [&](std::size_t r) {
          const HexahedraRegion& region = regions[r];
          HexahedraOptimization optimization = optimization_of(region);
          optimization.quad_attractions = std::move(pulled[r]);
          VertexMatrix points = points_of(region);
          for (int step = 0; step < steps; ++step) {
            if (keep_outer)
              hold(region, optimization);
            else
              attract(region, pull, optimization);
            optimization.minimize(points, 30, 0);
            const VertexMatrix before = points_of(region);
            put(region, points);
            // The energy sees the corners only, but for cells that were caught.
            bool caught = false;
            for (std::int32_t c : region.cells)
              if (!is_above(c, least_relative_jacobian)) caught = true, inside_[c] = 1;
            if (!caught) continue;
            put(region, before);
            points = before;
            optimization.inside = inside_of(region);
          }
        },
        1);
  }

  // Lays neighbourhoods of the given cells anew: what is caught in a fold has valid neighbours that no descent leads
  // away from. Smoothed between the points around, then drawn to the surface as the whole grid was at first; kept where
  // that is valid and better.
  void restart(const std::vector<std::int32_t>& poor, int rings) {
    std::vector<HexahedraRegion> regions = regions_around(cells_, around_, poor, rings);
    // Along creases neighbourhoods run into each other, and no whole of them is better.
    std::erase_if(regions, [](const HexahedraRegion& region) { return region.cells.size() > most_restarted_cells; });
    std::vector<VertexMatrix> before(regions.size());
    std::vector<double> cost(regions.size());
    constexpr int steps = 12, soft_steps = 6, last_steps = 3;
    const auto draw = [&](const HexahedraRegion& region, HexahedraOptimization& optimization, int step) {
      attract(region, std::pow(2.0, step), optimization);
      VertexMatrix points = points_of(region);
      const bool safe = step >= soft_steps && optimization.least_corner_jacobian(points) > 1e-3;
      optimization.minimize(points, 30, safe ? 0 : std::max(0.3 * std::pow(0.6, step), 1e-3));
      put(region, points);
    };
    parallel_for(
        regions.size(),
        [&](std::size_t r) {
          before[r] = points_of(regions[r]);
          cost[r] = cost_of(regions[r]);
          put(regions[r], smoothed(regions[r]));
          HexahedraOptimization optimization = optimization_of(regions[r]);
          for (int step = 0; step < soft_steps; ++step) draw(regions[r], optimization, step);
        },
        1);
    std::vector<std::vector<QuadAttraction>> pulled = pulls_of(regions);
    parallel_for(
        regions.size(),
        [&](std::size_t r) {
          const HexahedraRegion& region = regions[r];
          HexahedraOptimization optimization = optimization_of(region);
          optimization.quad_attractions = std::move(pulled[r]);
          for (int step = soft_steps; step < steps; ++step) {
            if (step + last_steps == steps) optimization.quad_attractions.clear();
            draw(region, optimization, step);
          }
          VertexMatrix points = points_of(region);
          const auto is_bad = [&](std::int32_t c) { return !is_above(c, least_relative_jacobian); };
          for (int round = 0; round < 4 && std::any_of(region.cells.begin(), region.cells.end(), is_bad); ++round) {
            for (std::size_t n = 0; n < region.cells.size(); ++n)
              if (is_bad(region.cells[n])) inside_[region.cells[n]] = 1, optimization.cell_weight[n] *= 4;
            optimization.inside = inside_of(region);
            attract(region, 64, optimization);
            minimize_folded(optimization, points, 40);
            put(region, points);
          }
          if (std::any_of(region.cells.begin(), region.cells.end(), is_bad) || cost_of(region) > cost[r])
            put(region, before[r]);
        },
        1);
  }

  void polish() {
    if (!is_valid()) return;
    polish_worst_cells(grid_, surface_, scale_, thickness_, polished_scaled_jacobian, most_polished_cells);
    std::fill(state_.begin(), state_.end(), OuterState::moved);
  }

  // Cells of poor shape, and those at outer points that are off the surface or whose links are off its normal.
  std::vector<std::int32_t> cells_to_improve(double scaled = poor_scaled_jacobian,
                                             double link_cosine = poor_link_cosine) const {
    std::vector<std::uint8_t> poor(cells_.size());
    parallel_for(poor.size(), [&](std::size_t c) { poor[c] = scaled_jacobian(grid_.points, cells_[c]) < scaled; });
    std::vector<std::uint8_t> off(grid_.twin.size());
    parallel_for(off.size(), [&](std::size_t outer) {
      if (state_[outer] == OuterState::settled) return;
      const Vec3 place = outer_place(outer);
      const TargetSurface::Nearest nearest = surface_.nearest(place / scale_);
      const Vec3 link = place - grid_.points.row(grid_.twin[outer]).transpose();
      off[outer] =
          nearest.distance * scale_ > surface_tolerance || link.dot(nearest.normal) < link_cosine * link.norm();
    });
    for (std::size_t outer = 0; outer < off.size(); ++outer) {
      if (!off[outer]) continue;
      const std::int32_t p = static_cast<std::int32_t>(core_points() + static_cast<Eigen::Index>(outer));
      for (const std::int32_t* n = around_.begin(p); n != around_.end(p); ++n) poor[*n] = 1;
    }
    std::vector<std::int32_t> result;
    for (std::size_t c = 0; c < poor.size(); ++c)
      if (poor[c]) result.push_back(static_cast<std::int32_t>(c));
    return result;
  }

  // Moves outer points onto the surface, each only as far as its cells stay valid and as well shaped as they may be:
  // to the point nearest to its twin where the link then is along the normal, else to the nearest one.
  void snap(bool at_any_shape) {
    const VertexMatrix normals = boundary_normals(grid_.core);
    std::vector<std::array<TargetSurface::Nearest, 3>> all_choices(grid_.twin.size());
    parallel_for(grid_.twin.size(), [&](std::size_t outer) {
      if (state_[outer] == OuterState::settled) return;
      const Vec3 place = outer_place(outer);
      const Vec3 facing = normals.row(grid_.twin[outer]).transpose().stableNormalized();
      all_choices[outer] = {target_of(normals, outer),
                            surface_.nearest_same_side(place / scale_, facing, same_side_reach / scale_),
                            surface_.nearest(place / scale_)};
    });
    for (std::size_t outer = 0; outer < grid_.twin.size(); ++outer) {
      if (state_[outer] == OuterState::settled) continue;
      const auto& choices = all_choices[outer];
      const Vec3 place = outer_place(outer);
      const Vec3 twin = grid_.points.row(grid_.twin[outer]).transpose();
      const auto off_normal = [&](const Vec3& point, const Vec3& normal) {
        const Vec3 link = point - twin;
        return 1 - link.dot(normal) / std::max(1e-300, link.norm());
      };
      const bool on_surface = choices[2].distance * scale_ < 1e-7;
      const double shape = least_scaled_jacobian_around(outer);
      // By the link's direction; cells below the shape wanted only where there is no other way onto the surface.
      Vec3 kept = place;
      double best = on_surface ? off_normal(place, choices[2].normal) : std::numeric_limits<double>::infinity();
      for (double wanted : {poor_scaled_jacobian, 0.5 * poor_scaled_jacobian, -1.0}) {
        if (wanted < 0 && !at_any_shape) break;
        for (const TargetSurface::Nearest& choice : choices) {
          const double cost = off_normal(choice.point * scale_, choice.normal);
          if (!(cost < best - 1e-9)) continue;
          if ((choice.point * scale_ - twin).norm() > sure_reach * thickness_ &&
              !surface_.is_way_inside(twin / scale_, choice.point))
            continue;
          outer_row(outer) = (choice.point * scale_).transpose();
          if (is_valid_around(outer) && least_scaled_jacobian_around(outer) > std::min(wanted, shape))
            best = cost, kept = outer_place(outer);
          outer_row(outer) = kept.transpose();
        }
        if (std::isfinite(best)) break;
      }
      // On the surface and linked along the normal: nothing to seek until it moves.
      if (best < 1 - poor_link_cosine) state_[outer] = OuterState::settled;
      if (std::isfinite(best) || !at_any_shape) continue;
      for (double part : {0.75, 0.5, 0.25, 0.125}) {
        outer_row(outer) = (place + part * (choices[2].point * scale_ - place)).transpose();
        if (is_valid_around(outer)) break;
        outer_row(outer) = place.transpose();
      }
    }
  }

  std::vector<std::int32_t> cells_below(double margin) const {
    std::vector<std::int32_t> all(cells_.size());
    std::iota(all.begin(), all.end(), 0);
    return cells_below(margin, all);
  }

  bool is_valid() const { return cells_below(least_relative_jacobian).empty(); }

  // Of the given cells.
  std::vector<std::int32_t> cells_below(double margin, const std::vector<std::int32_t>& cells) const {
    std::vector<std::uint8_t> low(cells.size());
    parallel_for(low.size(), [&](std::size_t i) { low[i] = !is_above(cells[i], margin); });
    std::vector<std::int32_t> result;
    for (std::size_t i = 0; i < low.size(); ++i)
      if (low[i]) result.push_back(cells[i]);
    return result;
  }

 private:
  Eigen::Index core_points() const { return grid_.core.points.rows(); }
  VertexMatrix::RowXpr outer_row(std::size_t outer) {
    return grid_.points.row(core_points() + static_cast<Eigen::Index>(outer));
  }
  Vec3 outer_place(std::size_t outer) const {
    return grid_.points.row(core_points() + static_cast<Eigen::Index>(outer)).transpose();
  }
  bool is_layer(std::int32_t c) const { return static_cast<std::size_t>(c) >= grid_.core.cells.size(); }

  // Whether the Jacobian is above `margin` of the target volume at the corners and Gauss points.
  bool is_above(std::int32_t c, double margin) const {
    return least_jacobian(grid_.points, cells_[c], margin * (is_layer(c) ? thickness_ : 1.0)) >
           margin * (is_layer(c) ? thickness_ : 1.0);
  }

  bool is_valid_around(std::size_t outer) const {
    const std::int32_t p = static_cast<std::int32_t>(core_points() + static_cast<Eigen::Index>(outer));
    return std::all_of(around_.begin(p), around_.end(p), [&](std::int32_t c) { return is_above(c, 1e-3); });
  }

  double least_scaled_jacobian_around(std::size_t outer) const {
    const std::int32_t p = static_cast<std::int32_t>(core_points() + static_cast<Eigen::Index>(outer));
    double least = 1;
    for (const std::int32_t* c = around_.begin(p); c != around_.end(p); ++c)
      least = std::min(least, scaled_jacobian(grid_.points, cells_[*c]));
    return least;
  }

  // The surface point nearest to an outer point's twin: from there the link is along the normal.
  TargetSurface::Nearest target_of(const VertexMatrix& normals, std::size_t outer) const {
    const std::int32_t twin = grid_.twin[outer];
    return target_of(twin, normals.row(twin).transpose());
  }

  TargetSurface::Nearest target_of(std::int32_t twin, const Vec3& normal) const {
    return surface_.nearest_from_inside(grid_.points.row(twin).transpose() / scale_, normal.stableNormalized(),
                                        same_side_reach / scale_, sure_reach * thickness_ / scale_);
  }

  // With ε for the least determinant there is: [Garanzha2021] eq. 9.
  static void minimize_folded(const HexahedraOptimization& optimization, VertexMatrix& points, int iterations) {
    const double lowest = optimization.least_corner_jacobian(points);
    const double reach = 0.5 * (std::sqrt(1e-12 + lowest * lowest) + lowest) + 0.01;
    optimization.minimize(points, iterations,
                          lowest > 1e-3 ? 0 : 2 * std::sqrt(reach * (reach - std::min(lowest, 0.0))));
  }

  // The pulls of uncovered parts on quadrilaterals within each region.
  std::vector<std::vector<QuadAttraction>> pulls_of(const std::vector<HexahedraRegion>& regions) const {
    std::vector<std::vector<QuadAttraction>> result(regions.size());
    std::vector<std::int32_t> region_of(static_cast<std::size_t>(grid_.points.rows()), -1), local(region_of);
    for (std::size_t r = 0; r < regions.size(); ++r)
      for (std::size_t p = 0; p < regions[r].points.size(); ++p) {
        region_of[regions[r].points[p]] = static_cast<std::int32_t>(r);
        local[regions[r].points[p]] = static_cast<std::int32_t>(p);
      }
    for (QuadAttraction pull : pulls(48)) {
      const std::int32_t r = region_of[pull.corners[0]];
      if (r < 0) continue;
      bool here = true;
      for (std::int32_t& corner : pull.corners) here = here && region_of[corner] == r, corner = local[corner];
      if (here) result[r].push_back(pull);
    }
    return result;
  }

  // How far a region is from what is wanted: links off the normal, points off the surface, cells of poor shape.
  double cost_of(const HexahedraRegion& region) const {
    double cost = 0;
    for (std::int32_t c : region.cells)
      cost += std::max(0.0, 1 - scaled_jacobian(grid_.points, cells_[c]) / poor_scaled_jacobian);
    for (std::int32_t p : region.points) {
      if (p < core_points()) continue;
      const std::size_t outer = static_cast<std::size_t>(p - core_points());
      const Vec3 place = outer_place(outer);
      const TargetSurface::Nearest nearest = surface_.nearest(place / scale_);
      const Vec3 link = place - grid_.points.row(grid_.twin[outer]).transpose();
      cost += 1 - link.dot(nearest.normal) / std::max(1e-300, link.norm());
      cost += 4 * std::max(0.0, nearest.distance * scale_ / thickness_ - 0.1);
    }
    return cost;
  }

  // A region's points where the polycube has them, displaced as smoothly as the points around allow; outer points above
  // their twins.
  VertexMatrix smoothed(const HexahedraRegion& region) const {
    VertexMatrix points = points_of(region);
    std::vector<std::set<std::int32_t>> around(region.points.size());
    for (std::size_t n = 0; n < region.cells.size(); ++n)
      for (int k = 0; k < 8; ++k)
        for (int axis = 0; axis < 3; ++axis)
          if (!is_layer(region.cells[n])) around[region.local[n][k]].insert(region.local[n][k ^ 1 << axis]);
    const auto lattice = [&](std::size_t p) {
      return grid_.core.point_lattice[region.points[p]].cast<double>().transpose();
    };
    for (std::size_t p = 0; p < region.points.size(); ++p)
      if (region.points[p] < core_points()) points.row(p) -= lattice(p);
    for (int sweep = 0; sweep < 200; ++sweep)
      for (std::size_t p = 0; p < region.points.size(); ++p) {
        if (region.locked[p] || around[p].empty()) continue;
        Vec3 mean = Vec3::Zero();
        for (std::int32_t n : around[p]) mean += points.row(n).transpose();
        points.row(p) = mean.transpose() / static_cast<double>(around[p].size());
      }
    for (std::size_t p = 0; p < region.points.size(); ++p)
      if (region.points[p] < core_points()) points.row(p) += lattice(p);
    std::vector<Vec3> normals(region.points.size(), Vec3::Zero());
    for (std::size_t n = 0; n < region.cells.size(); ++n) {
      if (!is_layer(region.cells[n])) continue;
      const LatticeHexahedron& q = region.local[n];
      const Vec3 u = (points.row(q[3]) - points.row(q[0])).transpose();
      const Vec3 v = (points.row(q[2]) - points.row(q[1])).transpose();
      for (int k = 0; k < 4; ++k) normals[q[k + 4]] += u.cross(v);
    }
    for (std::size_t n = 0; n < region.cells.size(); ++n)
      if (is_layer(region.cells[n]))
        for (int k = 0; k < 4; ++k) {
          const std::int32_t outer = region.local[n][k + 4];
          if (!region.locked[outer])
            points.row(outer) =
                points.row(region.local[n][k]) + thickness_ * normals[outer].stableNormalized().transpose();
        }
    return points;
  }

  HexahedraOptimization optimization_of(const HexahedraRegion& region) const {
    std::vector<Vec3i> lattice;
    std::vector<double> heights, weights;
    for (std::int32_t c : region.cells) {
      const std::size_t layer = static_cast<std::size_t>(c) - grid_.core.cells.size();
      lattice.push_back(grid_.core.cell_lattice[is_layer(c) ? grid_.core.boundary_quads[layer].cell : c]);
      heights.push_back(is_layer(c) ? thickness_ : 1.0);
      weights.push_back(weight_[c]);
    }
    HexahedraOptimization optimization(region.local, lattice, std::move(heights));
    optimization.cell_weight = std::move(weights);
    optimization.inside = inside_of(region);
    optimization.locked = region.locked;
    optimization.link_length = thickness_;
    optimization.twin.assign(region.points.size(), -1);
    std::map<std::int32_t, std::int32_t> inner;
    for (std::size_t p = 0; p < region.points.size(); ++p)
      if (region.points[p] < core_points() && outer_of_[region.points[p]] >= 0)
        inner[region.points[p]] = static_cast<std::int32_t>(p);
    for (std::size_t p = 0; p < region.points.size(); ++p) {
      if (region.points[p] < core_points()) continue;
      const auto found = inner.find(grid_.twin[static_cast<std::size_t>(region.points[p] - core_points())]);
      if (found != inner.end()) optimization.twin[p] = found->second;
    }
    return optimization;
  }

  std::vector<std::uint8_t> inside_of(const HexahedraRegion& region) const {
    std::vector<std::uint8_t> inside;
    for (std::int32_t c : region.cells) inside.push_back(inside_[c]);
    return inside;
  }

  VertexMatrix points_of(const HexahedraRegion& region) const {
    VertexMatrix points(region.points.size(), 3);
    for (std::size_t p = 0; p < region.points.size(); ++p) points.row(p) = grid_.points.row(region.points[p]);
    return points;
  }

  void put(const HexahedraRegion& region, const VertexMatrix& points) {
    for (std::size_t p = 0; p < region.points.size(); ++p) {
      const std::int32_t point = region.points[p];
      grid_.points.row(point) = points.row(p);
      if (point >= core_points()) state_[static_cast<std::size_t>(point - core_points())] = OuterState::moved;
      if (point < core_points()) grid_.core.points.row(point) = points.row(p);
    }
  }

  // Parts of the object that no outer quadrilateral is near draw the nearest one to themselves.
  std::vector<QuadAttraction> pulls(double weight) const {
    TriangleMesh outer;
    outer.vertices = grid_.points;
    outer.faces.resize(2 * static_cast<Eigen::Index>(grid_.layer.size()), 3);
    for (std::size_t q = 0; q < grid_.layer.size(); ++q) {
      const LatticeHexahedron& c = grid_.layer[q];
      outer.faces.row(2 * q) << c[4], c[5], c[7];
      outer.faces.row(2 * q + 1) << c[4], c[7], c[6];
    }
    return pulls_to_uncovered(outer, samples_, scale_, 0, weight);
  }

  // Locks the outer points and draws their twins below them.
  void hold(const HexahedraRegion& region, HexahedraOptimization& optimization) const {
    optimization.plane_attractions.clear();
    for (std::size_t p = 0; p < region.points.size(); ++p) {
      if (region.points[p] < core_points()) continue;
      optimization.locked[p] = 1;
      const std::int32_t inner = optimization.twin[p];
      if (inner < 0 || optimization.locked[inner]) continue;
      const Vec3 place = grid_.points.row(region.points[p]).transpose();
      const TargetSurface::Nearest nearest = surface_.nearest(place / scale_);
      if (nearest.distance * scale_ > surface_tolerance) continue;
      optimization.plane_attractions.push_back({inner, place - thickness_ * nearest.normal, nearest.normal, 4, 1});
    }
  }

  void put_all(const VertexMatrix& points) {
    grid_.points = points;
    grid_.core.points = points.topRows(core_points());
    std::fill(state_.begin(), state_.end(), OuterState::moved);
  }

  void attract(const HexahedraRegion& region, double pull, HexahedraOptimization& optimization) const {
    // Normals of the boundary at the region's points.
    std::map<std::int32_t, std::int32_t> local;
    for (std::size_t p = 0; p < region.points.size(); ++p)
      if (region.points[p] < core_points() && outer_of_[region.points[p]] >= 0)
        local[region.points[p]] = static_cast<std::int32_t>(p);
    std::map<std::int32_t, Vec3> normals;
    for (std::int32_t c : region.cells) {
      if (!is_layer(c)) continue;
      const LatticeHexahedron& q = cells_[c];
      const Vec3 u = (grid_.points.row(q[3]) - grid_.points.row(q[0])).transpose();
      const Vec3 v = (grid_.points.row(q[2]) - grid_.points.row(q[1])).transpose();
      for (int k = 0; k < 4; ++k) normals.try_emplace(q[k], Vec3::Zero()).first->second += u.cross(v);
    }
    std::map<std::int32_t, std::int32_t> outer_local;
    for (std::size_t p = 0; p < region.points.size(); ++p)
      if (region.points[p] >= core_points()) outer_local[region.points[p]] = static_cast<std::int32_t>(p);
    optimization.plane_attractions.clear();
    for (const auto& [twin, normal] : normals) {
      const std::int32_t outer = outer_of_[twin];
      const TargetSurface::Nearest nearest = target_of(twin, normal);
      const std::int32_t inner_point = local.at(twin);
      const std::int32_t outer_point = outer_local.at(static_cast<std::int32_t>(core_points() + outer));
      const Vec3 target = nearest.point * scale_;
      if (!optimization.locked[outer_point])
        optimization.plane_attractions.push_back({outer_point, target, nearest.normal, pull, 0.1});
      if (!optimization.locked[inner_point])
        optimization.plane_attractions.push_back(
            {inner_point, target - thickness_ * nearest.normal, nearest.normal, inner_pull * pull, 0.1});
    }
  }

  LayeredGrid& grid_;
  const TargetSurface& surface_;
  double scale_, thickness_;
  std::vector<LatticeHexahedron> cells_;  // core, then layer
  CellsOfPoints around_;
  std::vector<std::int32_t> outer_of_;  // of each core point, or −1
  std::vector<double> weight_;          // of each cell
  std::vector<TargetSurface::Sample> samples_;
  std::vector<std::uint8_t> inside_;  // cells whose inside the energy judges
  enum class OuterState : std::uint8_t { moved, settled };
  std::vector<OuterState> state_;  // of outer points since they were last looked at
};

}  // namespace

LayeredGrid layer_on_lattice(const std::vector<Vec3i>& blocks, int refinement, const TargetSurface& surface,
                             double scale, double thickness) {
  LayeredGrid grid = with_flat_layer(refine_blocks(blocks, refinement));
  LayerBuilder builder(grid, surface, scale, thickness);
  builder.set_by_visible_normals();
  builder.untangle();
  if (builder.is_valid()) builder.approach();
  return grid;
}

LayeredGrid add_boundary_layer(LatticeGrid core, const TargetSurface& surface, double scale, double thickness,
                               Progress& progress) {
  LayeredGrid grid = with_flat_layer(std::move(core));
  progress.begin("boundary layer", 0);
  LayerBuilder builder(grid, surface, scale, thickness);
  builder.set_by_visible_normals();
  builder.project();
  builder.untangle();
  builder.optimize_all(3, 13, 16, 64);
  builder.untangle();
  constexpr int rounds = 3, last_rounds = 4;
  for (int round = 0; round < rounds && builder.is_valid(); ++round) {
    const std::vector<std::int32_t> poor = builder.cells_to_improve();
    if (poor.empty()) break;
    builder.snap(false);
    builder.improve(builder.cells_to_improve(), 3, 2, 64 * std::pow(3.0, round), false);
    builder.snap(false);
    builder.improve(builder.cells_to_improve(), 3, 2, 0, true);
  }
  builder.snap(false);
  builder.polish();
  // What is still off the surface, nearly inverted or linked askew, in wider neighbourhoods.
  std::size_t left = std::numeric_limits<std::size_t>::max();
  for (int round = 0; round < last_rounds && builder.is_valid(); ++round) {
    const std::vector<std::int32_t> worst = builder.cells_to_improve(worst_scaled_jacobian, worst_link_cosine);
    if (worst.empty() || 5 * worst.size() > 4 * left) break;
    left = worst.size();
    for (double link_cosine : {worst_link_cosine, folded_link_cosine})
      builder.restart(builder.cells_to_improve(folded_scaled_jacobian, link_cosine), 4 + round);
    builder.improve(worst, 4, 3, 256 * std::pow(2.0, round), false);
    builder.snap(true);
    builder.improve(builder.cells_to_improve(), 3, 2, 0, true);
  }
  const bool was_improved = left != std::numeric_limits<std::size_t>::max();
  if (was_improved) builder.snap(false);
  if (was_improved) builder.polish();
  progress.end();
  return grid;
}

}  // namespace shellgrid
