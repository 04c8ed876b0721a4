// SPDX-License-Identifier: AGPL-3.0-or-later
#include "solvers/transport/clearance_grid.h"

#include <Eigen/Geometry>
#include <algorithm>
#include <cmath>
#include <limits>

#include "meshing/core/parallel.h"

namespace shellgrid {
namespace {

// Squared distances to the nearest seed along one line: the lower envelope of parabolas over its seeds.
// Source: [Felzenszwalb2012 §2].
void transform_line(const std::vector<float>& value, int n, std::vector<float>& result, std::vector<int>& place,
                    std::vector<float>& from) {
  constexpr float infinite = std::numeric_limits<float>::infinity();
  int last = -1;
  for (int q = 0; q < n; ++q) {
    if (value[q] == infinite) continue;
    float meets = -infinite;
    while (last >= 0) {
      const int p = place[last];
      meets = ((value[q] + static_cast<float>(q) * q) - (value[p] + static_cast<float>(p) * p)) / (2.0f * (q - p));
      if (meets > from[last]) break;
      --last;
      meets = -infinite;
    }
    ++last;
    place[last] = q;
    from[last] = last == 0 ? -infinite : meets;
  }
  if (last < 0) {
    std::fill(result.begin(), result.begin() + n, infinite);
    return;
  }
  for (int q = 0, k = 0; q < n; ++q) {
    while (k < last && from[k + 1] < static_cast<float>(q)) ++k;
    const auto away = static_cast<float>(q - place[k]);
    result[q] = away * away + value[place[k]];
  }
}

}  // namespace

ClearanceGrid::ClearanceGrid(const Vec3& lower, const Vec3& upper, int longest) {
  const double side = (upper - lower).maxCoeff();
  cell_ = side / longest;
  per_cell_ = 1 / cell_;
  quarter_ = 0.25 * cell_;
  lower_ = lower - Vec3::Constant(cell_);
  for (int axis = 0; axis < 3; ++axis)
    count_[axis] = static_cast<int>(std::ceil((upper[axis] - lower[axis]) * per_cell_)) + 2;
  upper_ = lower_ + cell_ * count_.cast<double>();
  steps_.assign(static_cast<std::size_t>(count_.x()) * count_.y() * count_.z(), 0);
}

void ClearanceGrid::mark(const Vec3& from, const Vec3& to, const std::function<bool(const Vec3& centre)>& touches) {
  // A thousandth of a cell covers all rounding.
  const Vec3 low = ((from - lower_) * per_cell_).array() - 1e-3, high = ((to - lower_) * per_cell_).array() + 1e-3;
  Vec3i first, last;
  for (int axis = 0; axis < 3; ++axis) {
    first[axis] = static_cast<int>(std::clamp(std::floor(low[axis]), 0.0, count_[axis] - 1.0));
    last[axis] = static_cast<int>(std::clamp(std::floor(high[axis]), 0.0, count_[axis] - 1.0));
  }
  for (int i = first.x(); i <= last.x(); ++i)
    for (int j = first.y(); j <= last.y(); ++j)
      for (int k = first.z(); k <= last.z(); ++k)
        if (touches(lower_ + cell_ * Vec3(i + 0.5, j + 0.5, k + 0.5))) steps_[index(i, j, k)] = 1;
}

void ClearanceGrid::add(const TriangleMesh& mesh) {
  for (int f = 0; f < mesh.face_count(); ++f) {
    const Vec3 a = mesh.corner(f, 0), b = mesh.corner(f, 1), c = mesh.corner(f, 2);
    const Vec3 normal = (b - a).cross(c - a);
    // A cell that the plane misses is not touched.
    const double reach = 0.5 * cell_ * normal.cwiseAbs().sum() * (1 + 1e-3) + 1e-3 * cell_ * normal.norm();
    mark(a.cwiseMin(b).cwiseMin(c), a.cwiseMax(b).cwiseMax(c),
         [&](const Vec3& centre) { return std::abs(normal.dot(centre - a)) <= reach; });
  }
}

void ClearanceGrid::add_box(const Vec3& lower, const Vec3& upper) {
  mark(lower, upper, [](const Vec3&) { return true; });
}

void ClearanceGrid::finish() {
  constexpr float infinite = std::numeric_limits<float>::infinity();
  std::vector<float> square(steps_.size());
  for (std::size_t k = 0; k < steps_.size(); ++k) square[k] = steps_[k] ? 0.0f : infinite;
  const std::size_t stride[3] = {static_cast<std::size_t>(count_.y()) * count_.z(),
                                 static_cast<std::size_t>(count_.z()), 1};
  for (int axis = 0; axis < 3; ++axis) {
    const int n = count_[axis], other = axis == 0 ? 1 : 0, third = axis == 2 ? 1 : 2;
    parallel_for(
        static_cast<std::size_t>(count_[other]),
        [&](std::size_t row) {
          std::vector<float> value(n), result(n), from(n);
          std::vector<int> place(n);
          for (int column = 0; column < count_[third]; ++column) {
            float* const line = square.data() + row * stride[other] + column * stride[third];
            for (int q = 0; q < n; ++q) value[q] = line[q * stride[axis]];
            transform_line(value, n, result, place, from);
            for (int q = 0; q < n; ++q) line[q * stride[axis]] = result[q];
          }
        },
        4);
  }
  // Between centres; points of two cells may be nearer by their diagonals' halves.
  const float diagonal = std::sqrt(3.0f) * (1 + 1e-5f);
  parallel_for(
      steps_.size(),
      [&](std::size_t k) {
        const float steps = 4 * (std::sqrt(square[k]) - diagonal);
        steps_[k] = static_cast<std::uint8_t>(std::clamp(steps, 0.0f, 255.0f));
      },
      1 << 14);
}

}  // namespace shellgrid
