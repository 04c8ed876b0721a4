// SPDX-License-Identifier: AGPL-3.0-or-later
#include "solvers/diffusion/core_extension.h"

#include <Eigen/LU>
#include <algorithm>
#include <array>
#include <cmath>
#include <limits>
#include <numeric>
#include <string>

#include "meshing/core/error.h"
#include "meshing/core/parallel.h"
#include "solvers/diffusion/channel_lanes.h"
#include "solvers/diffusion/trilinear_cell.h"

namespace shellgrid {
namespace {

// σ_a and σ_t', three channels each.
struct Fields {
  Double4 absorption = {}, reduced_extinction = {};
};
Fields operator+(const Fields& a, const Fields& b) {
  return {a.absorption + b.absorption, a.reduced_extinction + b.reduced_extinction};
}
Fields operator-(const Fields& a, const Fields& b) {
  return {a.absorption - b.absorption, a.reduced_extinction - b.reduced_extinction};
}
Fields operator*(const Fields& a, const Fields& b) {
  return {a.absorption * b.absorption, a.reduced_extinction * b.reduced_extinction};
}
Fields operator*(double s, const Fields& a) { return {s * a.absorption, s * a.reduced_extinction}; }
Fields quotient(const Fields& a, const Fields& b) {
  return {safe_quotient(a.absorption, b.absorption), safe_quotient(a.reduced_extinction, b.reduced_extinction)};
}
template <class Function>
Fields combine(const Fields& a, const Fields& b, const Function& function) {
  Fields result;
  for (int c = 0; c < 4; ++c) {
    result.absorption[c] = function(a.absorption[c], b.absorption[c]);
    result.reduced_extinction[c] = function(a.reduced_extinction[c], b.reduced_extinction[c]);
  }
  return result;
}

Fields fields_of(const Material& material) {
  return {to_double(to_lanes(material.absorption().max(0.0f))), to_double(to_lanes(material.reduced_extinction()))};
}

// Means of the deepest voxels about a point.
class BottomLayer {
 public:
  explicit BottomLayer(const ShellVolume& shell) : shell_(shell) {
    const double voxels = shell.thickness / shell.frame.voxel;
    layer_ = TwoLevelGrid<std::int32_t>(shell.extinction.lower_leaf(), shell.extinction.leaf_counts(), 0);
    lower_ = Vec3i::Constant(std::numeric_limits<int>::max());
    upper_ = Vec3i::Constant(std::numeric_limits<int>::min());
    shell.texture_coordinate.for_each_active([&](int i, int j, int k, const Vec3f& t) {
      if (!(t.z() > voxels - 1) || shell.kind.value(i, j, k) == 0 || !shell.extinction.is_active(i, j, k)) return;
      layer_.set(i, j, k, static_cast<std::int32_t>(values_.size()));
      Material material;
      material.extinction = shell.extinction.value(i, j, k).array();
      material.albedo = shell.albedo.value(i, j, k).array();
      material.anisotropy = shell.anisotropy.value(i, j, k).array();
      values_.push_back(fields_of(material));
      const Fields& f = values_.back();
      for (int c = 0; c < 3; ++c)
        if (!(f.absorption[c] >= 0) || !(f.reduced_extinction[c] >= 0) || !std::isfinite(f.reduced_extinction[c]))
          throw InputError("shell: its bottom layer holds a coefficient that is negative or not finite");
      lower_ = lower_.cwiseMin(Vec3i(i, j, k));
      upper_ = upper_.cwiseMax(Vec3i(i, j, k));
    });
  }

  bool empty() const { return values_.empty(); }

  Fields mean_about(const Vec3& point, double radius) const {
    const Vec3 at = shell_.frame.to_index(point);
    for (double r = std::max(1.0, radius / shell_.frame.voxel);; r *= 2) {
      const Vec3i from = (at.array() - r).ceil().matrix().cast<int>().cwiseMax(lower_);
      const Vec3i to = (at.array() + r).floor().matrix().cast<int>().cwiseMin(upper_);
      Fields sum;
      double total = 0;
      for (int i = from.x(); i <= to.x(); ++i)
        for (int j = from.y(); j <= to.y(); ++j)
          for (int k = from.z(); k <= to.z(); ++k) {
            const double weight = 1 - (Vec3(i, j, k) - at).norm() / r;
            if (!(weight > 0) || !layer_.is_active(i, j, k)) continue;
            sum = sum + weight * values_[layer_.value(i, j, k)];
            total += weight;
          }
      if (total > 0) return (1 / total) * sum;
    }
  }

 private:
  const ShellVolume& shell_;
  TwoLevelGrid<std::int32_t> layer_;
  std::vector<Fields> values_;
  Vec3i lower_, upper_;
};

// The free points' links: row r couples to free point `column` or, where that is negative, to point −1 − column.
struct Links {
  std::vector<std::int64_t> start;
  std::vector<std::int32_t> column;
  std::vector<double> weight;
  std::vector<double> diagonal;
};

constexpr int edge_ends[12][2] = {{0, 1}, {1, 2}, {2, 3}, {3, 0}, {4, 5}, {5, 6},
                                  {6, 7}, {7, 4}, {0, 4}, {1, 5}, {2, 6}, {3, 7}};

double cell_volume(const CellCorners& x) {
  double volume = 0;
  for (const TrilinearShape& shape : TrilinearQuadrature::instance().gauss)
    volume += jacobian(x, shape).determinant() / 8;
  return volume;
}

Links link_free_points(const Polygrid& polygrid, const std::vector<std::int32_t>& free_number, std::size_t free_count) {
  struct Link {
    std::int32_t row, column;
    double weight;
  };
  std::vector<Link> links;
  for (int cell = 0; cell < polygrid.cells.rows(); ++cell) {
    bool any = false;
    for (int a = 0; a < 8; ++a) any = any || free_number[polygrid.cells(cell, a)] >= 0;
    if (!any) continue;
    const CellCorners x = cell_corners(polygrid, cell);
    const double volume = cell_volume(x);
    for (const auto& ends : edge_ends) {
      const std::int32_t p = polygrid.cells(cell, ends[0]), q = polygrid.cells(cell, ends[1]);
      const double squared = (x.row(ends[0]) - x.row(ends[1])).squaredNorm();
      if (!(volume > 0) || !(squared > 0)) throw InputError("polygrid: a cell is inverted or flat");
      const double weight = volume / (4 * squared);
      const std::int32_t column_p = free_number[p] >= 0 ? free_number[p] : -1 - p;
      const std::int32_t column_q = free_number[q] >= 0 ? free_number[q] : -1 - q;
      if (column_p >= 0) links.push_back({column_p, column_q, weight});
      if (column_q >= 0) links.push_back({column_q, column_p, weight});
    }
  }
  std::stable_sort(links.begin(), links.end(),
                   [](const Link& a, const Link& b) { return a.row != b.row ? a.row < b.row : a.column < b.column; });
  Links result;
  result.start.assign(free_count + 1, 0);
  result.diagonal.assign(free_count, 0.0);
  for (std::size_t k = 0; k < links.size(); ++k) {
    result.diagonal[links[k].row] += links[k].weight;
    if (k > 0 && links[k].row == links[k - 1].row && links[k].column == links[k - 1].column) {
      result.weight.back() += links[k].weight;
      continue;
    }
    ++result.start[links[k].row + 1];
    result.column.push_back(links[k].column);
    result.weight.push_back(links[k].weight);
  }
  std::partial_sum(result.start.begin(), result.start.end(), result.start.begin());
  return result;
}

double largest_component(const Fields& a) {
  double largest = 0;
  for (int c = 0; c < 3; ++c) largest = std::max({largest, a.absorption[c], a.reduced_extinction[c]});
  return largest;
}

// Conjugate gradients preconditioned by the diagonal. `boundary` holds the values of points that are not free.
void solve_laplace(const Links& links, const std::vector<Fields>& boundary, std::vector<Fields>& x,
                   CoreExtension& report) {
  const std::size_t n = x.size();
  auto apply = [&](const std::vector<Fields>& from, std::vector<Fields>& to) {
    parallel_for(
        n,
        [&](std::size_t r) {
          Fields sum = links.diagonal[r] * from[r];
          for (std::int64_t k = links.start[r]; k < links.start[r + 1]; ++k)
            if (links.column[k] >= 0) sum = sum - links.weight[k] * from[links.column[k]];
          to[r] = sum;
        },
        1024);
  };
  auto dot = [&](const std::vector<Fields>& a, const std::vector<Fields>& b) {
    return parallel_sum(n, Fields{}, [&](std::size_t r) { return a[r] * b[r]; });
  };
  std::vector<Fields> source(n), residual(n), z(n), direction(n), image(n);
  for (std::size_t r = 0; r < n; ++r)
    for (std::int64_t k = links.start[r]; k < links.start[r + 1]; ++k)
      if (links.column[k] < 0) source[r] = source[r] + links.weight[k] * boundary[-1 - links.column[k]];
  const Fields size = dot(source, source);
  apply(x, image);
  for (std::size_t r = 0; r < n; ++r) residual[r] = source[r] - image[r];
  Fields last_energy;
  constexpr int most_iterations = 5000;
  for (;; ++report.iterations) {
    report.residual = std::sqrt(largest_component(quotient(dot(residual, residual), size)));
    if (!std::isfinite(report.residual)) throw NumericalError("core: a number that is not finite appeared");
    if (report.residual <= report.tolerance) return;
    if (report.iterations >= most_iterations)
      throw NumericalError("core: no convergence after " + std::to_string(most_iterations) +
                           " iterations; relative residual " + std::to_string(report.residual));
    for (std::size_t r = 0; r < n; ++r) z[r] = (1 / links.diagonal[r]) * residual[r];
    const Fields energy = dot(residual, z);
    const Fields factor = report.iterations == 0 ? Fields{} : quotient(energy, last_energy);
    for (std::size_t r = 0; r < n; ++r) direction[r] = z[r] + factor * direction[r];
    apply(direction, image);
    const Fields length = quotient(energy, dot(direction, image));
    for (std::size_t r = 0; r < n; ++r) {
      x[r] = x[r] + length * direction[r];
      residual[r] = residual[r] - length * image[r];
    }
    last_energy = energy;
  }
}

}  // namespace

CoreExtension extend_core(const Polygrid& polygrid, const ShellVolume& shell, const std::vector<char>& in_shell,
                          const std::vector<char>& reaches_core, double tolerance) {
  const auto points = static_cast<std::size_t>(polygrid.points.rows());
  if (in_shell.size() != points || reaches_core.size() != static_cast<std::size_t>(polygrid.cells.rows()))
    throw InternalError("one mark a point and a cell expected");
  if (!(tolerance > 0)) throw InputError("core: its tolerance must be above 0");
  CoreExtension result;
  result.tolerance = tolerance;
  const BottomLayer layer(shell);
  const Fields mean = fields_of(shell.core);
  std::vector<Fields> values(points);

  std::vector<std::int32_t> free_number(points, -1), free_points, boundary_points;
  std::vector<char> wanted(points, 0);
  for (Eigen::Index cell = 0; cell < polygrid.cells.rows(); ++cell)
    for (int a = 0; reaches_core[cell] && a < 8; ++a) wanted[polygrid.cells(cell, a)] = 1;
  for (std::size_t p = 0; p < points; ++p) {
    if (!wanted[p]) continue;
    if (in_shell[p]) {
      boundary_points.push_back(static_cast<std::int32_t>(p));
    } else {
      free_number[p] = static_cast<std::int32_t>(free_points.size());
      free_points.push_back(static_cast<std::int32_t>(p));
    }
  }
  result.free_points = free_points.size();
  result.boundary_points = boundary_points.size();

  if (layer.empty() || boundary_points.empty()) {
    for (std::size_t p = 0; p < points; ++p)
      if (wanted[p]) values[p] = mean;
  } else {
    parallel_for(
        boundary_points.size(),
        [&](std::size_t k) {
          const std::int32_t p = boundary_points[k];
          values[p] = layer.mean_about(polygrid.points.row(p).transpose(), polygrid.spacing);
        },
        16);
    Fields least = values[boundary_points[0]], most = least;
    for (const std::int32_t p : boundary_points) {
      least = combine(least, values[p], [](double a, double b) { return std::min(a, b); });
      most = combine(most, values[p], [](double a, double b) { return std::max(a, b); });
    }
    auto within = [&](const Fields& f) {
      const Fields raised = combine(f, least, [](double a, double b) { return std::max(a, b); });
      return combine(raised, most, [](double a, double b) { return std::min(a, b); });
    };
    std::vector<Fields> x(free_points.size(), within(mean));
    solve_laplace(link_free_points(polygrid, free_number, free_points.size()), values, x, result);
    // The iteration's last error may stand out of the boundary's range; the solution does not.
    for (std::size_t r = 0; r < x.size(); ++r) values[free_points[r]] = within(x[r]);
  }
  result.absorption.reserve(points);
  result.reduced_extinction.reserve(points);
  for (const Fields& f : values) {
    result.absorption.push_back(to_rgb(f.absorption));
    result.reduced_extinction.push_back(to_rgb(f.reduced_extinction));
  }
  return result;
}

}  // namespace shellgrid
