// SPDX-License-Identifier: AGPL-3.0-or-later
// The solver's part that knows of cells which stand for their children.
#include <algorithm>
#include <cmath>

#include "meshing/core/parallel.h"
#include "solvers/diffusion/diffusion_solver.h"

namespace shellgrid {
namespace {

constexpr std::size_t grain = 4096;

// Of the deep cells' estimated error, from balls and real objects with 2 to 1000 cells to the mean free path.
constexpr double deep_factor = 16;

}  // namespace

// The energy of what trilinear interpolation within leaves leaves out of the solution: an eighth of the second
// differences of the leaves' values, over the solution's size at the surface. The light that a change at the surface
// would send there is as smooth, so that the exitance misses about the square of it (Galerkin's orthogonality). And
// the power that leaves with uneven children conduct too well.
double DiffusionSolver::deep_error() const {
  Double4 error = {}, excess = {};
  double share = 1;
  for (const DeepPart& deep : hierarchy_.deep) {
    if (!deep.empty()) {
      const std::vector<std::int32_t>& run_of = deep.part.layout.run_of;
      const ChannelPlanes<float>& x = deep.part.x.inner;
      error += share / 64 *
               parallel_sum(
                   deep.unknown.size(), Double4{},
                   [&](std::size_t u) {
                     Double4 sum = {};
                     const auto add = [&](std::size_t before, std::size_t after) {
                       for (int c = 0; c < 3; ++c) {
                         const double difference = (x[c][before] + x[c][after]) - 2.0 * x[c][u];
                         sum[c] += difference * difference;
                       }
                     };
                     const std::array<std::int32_t, 4>& beside = deep.beside[u];
                     if (u > 0 && u + 1 < run_of.size() && run_of[u - 1] == run_of[u + 1]) add(u - 1, u + 1);
                     if (beside[0] >= 0 && beside[1] >= 0) add(beside[0], beside[1]);
                     if (beside[2] >= 0 && beside[3] >= 0) add(beside[2], beside[3]);
                     return sum;
                   },
                   grain);
    }
    excess += parallel_sum(
        deep.spread.size(), Double4{},
        [&](std::size_t leaf) {
          const std::int32_t* corner = deep.part.cells.corners.data() + 8 * leaf;
          Float4 sum = {};
          for (int c = 0; c < 3; ++c) {
            const float* x = deep.part.x.inner[c];
            for (int a = 0; a < 8; ++a)
              for (int axis = 0; axis < 3; ++axis) {
                if (a >> axis & 1) continue;
                const float difference = x[corner[a | 1 << axis]] - x[corner[a]];
                sum[c] += difference * difference;
              }
          }
          return to_double(deep.spread[leaf] * sum);
        },
        grain);
    share *= 4;  // of a layer's points each stands for four times the surface
  }
  const RunLevel& finest = levels_.front();
  const double reflected = inner_light_ ? 0 : boundary_factor_ * (1 - current_reflectance_);
  Double4 size = {}, weighed = {};
  for (std::size_t s = 0; s < finest.surface.size(); ++s) {
    const double area = terms_.area[s];
    if (!(area > 0)) continue;
    const Double4 exitance = to_double(finest.x.outer[s]) - (reflected / area) * to_double(lights_[0].outer[s]);
    size += exitance * exitance;
    weighed += area * exitance * exitance;
  }
  double worst = 0;
  for (int c = 0; c < 3; ++c)
    if (error[c] > 0)
      worst = std::max(
          worst, size[c] > 0 ? deep_factor * error[c] / size[c] + 2 * boundary_factor_ * excess[c] / weighed[c] : 1.0);
  return worst;
}

// What the leaves of a level leave of their light, to the level's right-hand side.
void DiffusionSolver::add_deep_residual(std::size_t index, bool inner_light) {
  DeepPart& deep = hierarchy_.deep[index];
  if (deep.empty()) return;
  apply_level(deep.part, deep.part.x, deep.part.before);
  for (int c = 0; c < 3; ++c) {
    float* to = levels_[index].right_side.inner[c];
    const float* light = deep.part.right_side.inner[c];
    const float* image = deep.part.before.inner[c];
    parallel_for(
        deep.unknown.size(), [&](std::size_t u) { to[deep.unknown[u]] += (inner_light ? light[u] : 0.0f) - image[u]; },
        grain);
  }
}

// The part of a level's solution, or of a correction, that leaves hold.
void DiffusionSolver::keep_deep_solution(std::size_t index, bool add) {
  DeepPart& deep = hierarchy_.deep[index];
  if (deep.empty()) return;
  for (int c = 0; c < 3; ++c) {
    float* to = deep.part.x.inner[c];
    const float* from = levels_[index].x.inner[c];
    parallel_for(
        deep.unknown.size(),
        [&](std::size_t u) { to[u] = add ? to[u] + from[deep.unknown[u]] : from[deep.unknown[u]]; }, grain);
  }
}

// Sums of what points hand on to those whose mean they take, at the leaves' points of each level.
std::vector<ChannelPlanes<float>> DiffusionSolver::gather_deep(const std::vector<Double4>& point_values) const {
  std::vector<ChannelPlanes<float>> result(levels_.size());
  if (hierarchy_.skipped == 0) return result;
  std::vector<Double4> values, finer;
  for (std::size_t l = 0; l < levels_.size(); ++l) {
    const DeepPart& deep = hierarchy_.deep[l];
    if (!deep.empty()) {
      result[l] = ChannelPlanes<float>(deep.unknown.size());
      for (std::size_t u = 0; u < deep.unknown.size(); ++u)
        for (int c = 0; c < 3; ++c) result[l][c][u] = static_cast<float>(values[deep.part.layout.point_of[u]][c]);
    }
    if (l + 1 == levels_.size()) break;
    const std::vector<Double4>& own = l == 0 ? point_values : values;
    std::vector<Double4> next(hierarchy_.points[l + 1], Double4{});
    const InterpolatedPoints& points = hierarchy_.interpolated[l];
    for (std::size_t k = 0; k < points.point.size(); ++k) {
      const double share = 1.0 / static_cast<double>(points.start[k + 1] - points.start[k]);
      for (std::int64_t e = points.start[k]; e < points.start[k + 1]; ++e)
        next[points.parent[e]] += share * own[points.point[k]];
    }
    values = std::move(next);
  }
  return result;
}

}  // namespace shellgrid
