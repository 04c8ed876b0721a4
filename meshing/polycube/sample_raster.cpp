// SPDX-License-Identifier: AGPL-3.0-or-later
#include "meshing/polycube/sample_raster.h"

#include <algorithm>
#include <cmath>

#include "meshing/core/parallel.h"

namespace shellgrid {
namespace {

// Sign of (b − a) × (p − a), the same with opposite sign for (b, a): neighbours agree on a shared edge.
double consistent_side(const Vec2& a, const Vec2& b, const Vec2& p) {
  const bool ordered = a.x() < b.x() || (a.x() == b.x() && a.y() < b.y());
  const Vec2& s = ordered ? a : b;
  const Vec2& e = ordered ? b : a;
  const double area = (e.x() - s.x()) * (p.y() - s.y()) - (e.y() - s.y()) * (p.x() - s.x());
  const double side = area >= 0 ? 1 : -1;
  return ordered ? side : -side;
}

// Where the surface crosses the columns of samples along `axis`, ascending. A column's index is i + counts[u]·j.
std::vector<std::vector<double>> crossings_along(int axis, const TriangleMesh& surface, const SampleRaster& raster) {
  const int u = (axis + 1) % 3, v = (axis + 2) % 3;
  const int columns_u = raster.size[u], columns_v = raster.size[v];
  const Vec2 lower(raster.lower[u], raster.lower[v]);
  std::vector<std::vector<double>> crossings(static_cast<std::size_t>(columns_u) * columns_v);
  for (int f = 0; f < surface.face_count(); ++f) {
    const Vec3 p[3] = {surface.corner(f, 0), surface.corner(f, 1), surface.corner(f, 2)};
    const Vec2 a(p[0][u], p[0][v]), b(p[1][u], p[1][v]), c(p[2][u], p[2][v]);
    const double area = (b.x() - a.x()) * (c.y() - a.y()) - (b.y() - a.y()) * (c.x() - a.x());
    const Vec2 low = (a.cwiseMin(b).cwiseMin(c) - lower) / raster.spacing;
    const Vec2 high = (a.cwiseMax(b).cwiseMax(c) - lower) / raster.spacing;
    const int i0 = std::max(0, static_cast<int>(std::floor(low.x() - 0.5)));
    const int i1 = std::min(columns_u - 1, static_cast<int>(std::ceil(high.x() - 0.5)));
    const int j0 = std::max(0, static_cast<int>(std::floor(low.y() - 0.5)));
    const int j1 = std::min(columns_v - 1, static_cast<int>(std::ceil(high.y() - 0.5)));
    for (int i = i0; i <= i1; ++i)
      for (int j = j0; j <= j1; ++j) {
        const Vec2 q = lower + raster.spacing * Vec2(i + 0.5, j + 0.5);
        const double ab = consistent_side(a, b, q), bc = consistent_side(b, c, q), ca = consistent_side(c, a, q);
        if (!(ab == bc && bc == ca)) continue;
        double height;
        if (std::abs(area) > 0) {
          const double wb = ((q.x() - a.x()) * (c.y() - a.y()) - (q.y() - a.y()) * (c.x() - a.x())) / area;
          const double wc = ((b.x() - a.x()) * (q.y() - a.y()) - (b.y() - a.y()) * (q.x() - a.x())) / area;
          height = p[0][axis] + std::clamp(wb, 0.0, 1.0) * (p[1][axis] - p[0][axis]) +
                   std::clamp(wc, 0.0, 1.0) * (p[2][axis] - p[0][axis]);
        } else {
          height = (p[0][axis] + p[1][axis] + p[2][axis]) / 3;
        }
        crossings[static_cast<std::size_t>(j) * columns_u + i].push_back(height);
      }
  }
  parallel_for(crossings.size(),
               [&](std::size_t column) { std::sort(crossings[column].begin(), crossings[column].end()); });
  return crossings;
}

}  // namespace

SampleRaster rasterize(const TriangleMesh& surface, const Vec3& lower, double spacing, const Vec3i& size) {
  SampleRaster raster{lower, spacing, size, {}};
  raster.flags.assign(static_cast<std::size_t>(size.x()) * size.y() * size.z(), 0);
  for (int axis = 0; axis < 3; ++axis) {
    const int u = (axis + 1) % 3, v = (axis + 2) % 3;
    const std::vector<std::vector<double>> crossings = crossings_along(axis, surface, raster);
    // Columns of different bytes.
    parallel_for(crossings.size(), [&](std::size_t column) {
      Vec3i place;
      place[u] = static_cast<int>(column % size[u]);
      place[v] = static_cast<int>(column / size[u]);
      const std::vector<double>& heights = crossings[column];
      // The first sample above a crossing.
      const auto above = [&](double height) {
        return static_cast<int>(std::ceil((height - lower[axis]) / spacing - 0.5));
      };
      for (double height : heights) {
        place[axis] = above(height) - 1;
        if (place[axis] >= 0 && place[axis] < size[axis]) raster.flags[raster.index(place)] |= 1 << axis;
      }
      if (axis != 2) return;
      for (std::size_t n = 0; n + 1 < heights.size(); n += 2)
        for (int k = std::max(0, above(heights[n])); k < std::min(size[axis], above(heights[n + 1])); ++k) {
          place[axis] = k;
          raster.flags[raster.index(place)] |= SampleRaster::inside_bit;
        }
    });
  }
  return raster;
}

}  // namespace shellgrid
