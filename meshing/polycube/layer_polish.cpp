// SPDX-License-Identifier: AGPL-3.0-or-later
#include "meshing/polycube/layer_polish.h"

#include <Eigen/Geometry>
#include <algorithm>
#include <cmath>
#include <numbers>

#include "meshing/core/parallel.h"
#include "meshing/polycube/hexahedra_region.h"

namespace shellgrid {
namespace {

// Of the target volume: what the determinants of a moved point's cells keep.
constexpr double least_relative_jacobian = 1e-3;
// Links off the normal by more than 25° weigh in, and outer points off the surface, in cells.
constexpr double wanted_link_cosine = 0.906;
// Scaled Jacobians count as short of what is wanted times this: so that no cell pays for another and ends just above.
constexpr double good_share = 1.5;
constexpr double steep_link_cosine = 0.866;
constexpr double surface_tolerance = 2e-3;
// Cells below this are not made worse for anything.
constexpr double least_scaled_jacobian = 0.12;
constexpr double link_weight = 0.2, length_weight = 1e-3, surface_weight = 0.2;
// How far, in cells, a face that looks the same way as the grid is preferred to a nearer one.
constexpr double same_side_reach = 2;
constexpr double first_step = 0.16, last_step = 0.01;  // in cells
// Outer points go no farther along the surface, in cells: they cover what they covered.
constexpr double farthest_move = 0.3;
constexpr int sweeps = 6;

double squared_shortfall(double value, double wanted) {
  const double short_of = std::max(0.0, wanted - value);
  return short_of * short_of;
}

class LayerPolish {
 public:
  LayerPolish(LayeredGrid& grid, const TargetSurface& surface, double scale, double thickness, double wanted)
      : grid_(grid),
        surface_(surface),
        scale_(scale),
        thickness_(thickness),
        wanted_(wanted),
        start_(grid.points),
        cells_(all_cells(grid)),
        around_(cells_, static_cast<std::size_t>(grid.points.rows())),
        outer_of_(static_cast<std::size_t>(grid.core.points.rows()), -1) {
    for (std::size_t o = 0; o < grid.twin.size(); ++o)
      outer_of_[grid.twin[o]] = static_cast<std::int32_t>(core_points() + static_cast<Eigen::Index>(o));
  }

  void run(std::size_t most_cells) {
    std::vector<double> shape(cells_.size());
    parallel_for(shape.size(), [&](std::size_t c) { shape[c] = scaled_jacobian(grid_.points, cells_[c]); });
    std::vector<std::uint8_t> amiss(grid_.twin.size());
    parallel_for(amiss.size(), [&](std::size_t o) { amiss[o] = is_amiss(o); });
    for (std::size_t o = 0; o < amiss.size(); ++o) {
      const std::int32_t p = static_cast<std::int32_t>(core_points() + static_cast<Eigen::Index>(o));
      if (amiss[o])
        for (const std::int32_t* c = around_.begin(p); c != around_.end(p); ++c) shape[*c] = std::min(shape[*c], 0.0);
    }
    std::vector<std::int32_t> worst;
    for (std::size_t c = 0; c < shape.size(); ++c)
      if (shape[c] < wanted_) worst.push_back(static_cast<std::int32_t>(c));
    std::sort(worst.begin(), worst.end(),
              [&](std::int32_t a, std::int32_t b) { return shape[a] < shape[b] || (shape[a] == shape[b] && a < b); });
    if (worst.size() > most_cells) worst.resize(most_cells);
    for (int sweep = 0; sweep < sweeps && !worst.empty(); ++sweep) {
      std::vector<std::int32_t> left;
      for (std::int32_t c : worst) {
        bool moved = false;
        for (std::int32_t p : cells_[c]) moved |= search(p);
        if (moved) left.push_back(c);
      }
      worst = std::move(left);
    }
    grid_.core.points = grid_.points.topRows(core_points());
  }

 private:
  Eigen::Index core_points() const { return grid_.core.points.rows(); }
  Vec3 place(std::int32_t p) const { return grid_.points.row(p).transpose(); }
  bool is_layer(std::int32_t c) const { return static_cast<std::size_t>(c) >= grid_.core.cells.size(); }
  std::int32_t twin(std::int32_t p) const {
    return p < core_points() ? outer_of_[p] : grid_.twin[static_cast<std::size_t>(p - core_points())];
  }

  // The shortfalls around one point, or around it and its twin.
  double shortfall(std::int32_t p, bool with_twin) const {
    double sum = 0;
    for (const std::int32_t* c = around_.begin(p); c != around_.end(p); ++c)
      sum += squared_shortfall(scaled_jacobian(grid_.points, cells_[*c]), good_share * wanted_);
    const std::int32_t other = twin(p);
    if (other < 0) return sum;
    if (with_twin)
      for (const std::int32_t* c = around_.begin(other); c != around_.end(other); ++c)
        if (std::find(around_.begin(p), around_.end(p), *c) == around_.end(p))
          sum += squared_shortfall(scaled_jacobian(grid_.points, cells_[*c]), good_share * wanted_);
    const Vec3 outer = place(std::max(p, other)), link = outer - place(std::min(p, other));
    const TargetSurface::Nearest nearest = surface_.nearest(outer / scale_);
    const double length = std::max(1e-9, link.norm());
    sum += link_weight * squared_shortfall(link.dot(surface_.link_normal(nearest, link)) / length, wanted_link_cosine);
    const double stretch = std::log(length / thickness_);
    sum += length_weight * stretch * stretch;
    if (nearest.distance * scale_ > surface_tolerance)
      sum += surface_weight * (0.02 + std::min(1.0, nearest.distance * scale_));
    return sum;
  }

  // Whether an outer point is off the surface, or its link far off the normal.
  bool is_amiss(std::size_t o) const {
    const Vec3 outer = grid_.points.row(core_points() + static_cast<Eigen::Index>(o)).transpose();
    const Vec3 link = outer - place(grid_.twin[o]);
    const TargetSurface::Nearest nearest = surface_.nearest(outer / scale_);
    return nearest.distance * scale_ > surface_tolerance ||
           link.dot(surface_.link_normal(nearest, link)) < steep_link_cosine * link.norm();
  }

  double least_around(std::int32_t p, bool with_twin) const {
    double least = least_scaled_jacobian;
    for (std::int32_t q : {p, with_twin ? twin(p) : p})
      for (const std::int32_t* c = around_.begin(q); c != around_.end(q); ++c)
        least = std::min(least, scaled_jacobian(grid_.points, cells_[*c]));
    return least;
  }

  bool is_valid_around(std::int32_t p) const {
    return std::all_of(around_.begin(p), around_.end(p), [&](std::int32_t c) {
      const double least = least_relative_jacobian * (is_layer(c) ? thickness_ : 1.0);
      return least_jacobian(grid_.points, cells_[c], least) > least;
    });
  }

  void put(std::int32_t p, const Vec3& x) { grid_.points.row(p) = x.transpose(); }

  // Moves point `p` or, where it has a twin, both, in ever smaller steps; returns whether anything became better.
  bool search(std::int32_t p) {
    const std::int32_t other = twin(p);
    bool any = other < 0 ? descend(p, false) : false;
    if (other >= 0) {
      any |= descend(std::max(p, other), true);
      any |= descend(std::max(p, other), false);
      any |= descend(std::min(p, other), false);
    }
    return any;
  }

  bool descend(std::int32_t p, bool with_twin) {
    const bool outer = p >= core_points();
    const std::int32_t other = twin(p);
    double best = shortfall(p, with_twin);
    if (best <= 1e-12) return false;
    double least = least_around(p, with_twin);
    bool any = false;
    for (double step = first_step; step >= last_step; step *= 0.5) {
      for (int repeat = 0; repeat < 3; ++repeat) {
        const Vec3 here = place(p), other_here = other >= 0 ? place(other) : here;
        Vec3 found = here, other_found = other_here;
        const double before = best;
        const auto judge = [&](const Vec3& x, const Vec3& other_x) {
          put(p, x);
          if (with_twin) put(other, other_x);
          const double value = shortfall(p, with_twin);
          if (!(value < best * (1 - 3e-3)) || least_around(p, with_twin) < least) return;
          if (is_valid_around(p) && (!with_twin || is_valid_around(other)))
            best = value, found = x, other_found = other_x;
        };
        if (outer)
          along_surface(p, other, step, with_twin, judge);
        else
          for (int k = 0; k < 27; ++k) {
            if (k == 13) continue;
            const Vec3 direction(k % 3 - 1, k / 3 % 3 - 1, k / 9 - 1);
            judge(here + step * direction.normalized(), other_here);
          }
        put(p, found);
        if (with_twin) put(other, other_found);
        if (!(best < before)) break;
        least = least_around(p, with_twin);
        any = true;
      }
    }
    return any;
  }

  // Hands `judge` the places on the surface a step around an outer point, with its twin's below it.
  template <class Judge>
  void along_surface(std::int32_t p, std::int32_t inner, double step, bool with_twin, const Judge& judge) const {
    const Vec3 here = place(p), inner_here = place(inner);
    const TargetSurface::Nearest at = surface_.nearest(here / scale_);
    const Vec3 facing = at.normal;
    const Vec3 u = facing.unitOrthogonal(), v = facing.cross(u);
    const double length = (here - inner_here).norm();
    for (int k = 0; k <= 8; ++k) {
      const double turn = k * std::numbers::pi / 4;
      const Vec3 x = k == 8 ? here : Vec3(here + step * (std::cos(turn) * u + std::sin(turn) * v));
      const TargetSurface::Nearest nearest = surface_.nearest_same_side(x / scale_, facing, same_side_reach / scale_);
      const Vec3 target = nearest.point * scale_;
      if ((target - here).norm() > 2 * step + surface_tolerance && k < 8) continue;
      if ((target - start_.row(p).transpose()).norm() > farthest_move) continue;
      // A point off the surface comes nearer by parts where it cannot at once.
      if (k == 8 && at.distance * scale_ > surface_tolerance)
        for (double part : {0.1, 0.3, 0.6})
          judge(Vec3(here + part * (target - here)), Vec3(inner_here + (with_twin ? part : 0) * (target - here)));
      if (!with_twin) {
        judge(target, inner_here);
        continue;
      }
      judge(target, Vec3(inner_here + target - here));
      judge(target, Vec3(target - length * nearest.normal));
      judge(target, Vec3(target - thickness_ * nearest.normal));
    }
  }

  LayeredGrid& grid_;
  const TargetSurface& surface_;
  double scale_, thickness_, wanted_;
  const VertexMatrix start_;
  std::vector<LatticeHexahedron> cells_;  // core, then layer
  CellsOfPoints around_;
  std::vector<std::int32_t> outer_of_;  // of each core point, or −1
};

}  // namespace

void polish_worst_cells(LayeredGrid& grid, const TargetSurface& surface, double scale, double thickness, double wanted,
                        std::size_t most_cells) {
  LayerPolish(grid, surface, scale, thickness, wanted).run(most_cells);
}

}  // namespace shellgrid
