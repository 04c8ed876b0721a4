// SPDX-License-Identifier: AGPL-3.0-or-later
// Surfaces that unroll onto the plane, so that tiling the sample over them is exact.
#pragma once
#include <cmath>

#include "meshing/core/random.h"
#include "meshing/distance/distance_field.h"
#include "meshing/surface/half_edges.h"
#include "synthesis/textured_surface.h"
#include "tests/synthesis/synthesis_shapes.h"

namespace shellgrid::testing {

// A strip of a cylinder about the y axis, or, at an infinite radius, of the plane z = 0, facing +z: `count` vertices
// each way about `step` apart and moved at random, each with the coordinate that unrolling gives it.
struct UnrolledStrip {
  double radius, step, voxel;  // mm
  int count;
  TexturedMesh mesh;

  UnrolledStrip(double radius_, double step_, double voxel_, int count_)
      : radius(radius_), step(step_), voxel(voxel_), count(count_) {
    mesh.mesh = patch(count, step);
    const int n = mesh.mesh.vertex_count();
    mesh.normals.resize(n, 3);
    mesh.directions.resize(n, 3);
    mesh.coordinate.resize(n);
    for (int v = 0; v < n; ++v) {
      const Vec2 flat(mesh.mesh.vertices(v, 0) + 0.3 * step * (2 * to_unit(hash64(v, 1)) - 1),
                      mesh.mesh.vertices(v, 1) + 0.3 * step * (2 * to_unit(hash64(v, 2)) - 1));
      mesh.mesh.vertices.row(v) = rolled(flat).transpose();
      mesh.normals.row(v) = normal(flat).transpose();
      mesh.directions.row(v) = direction(flat).transpose();
      mesh.coordinate[v] = (flat / voxel).cast<float>();
    }
  }
  double middle() const { return count * step / 2; }
  double angle(double along) const { return (along - middle()) / radius; }
  bool plane() const { return !std::isfinite(radius); }
  Vec3 rolled(const Vec2& flat) const {
    if (plane()) return {flat.x(), flat.y(), 0};
    return {radius * std::sin(angle(flat.x())), flat.y(), radius * (std::cos(angle(flat.x())) - 1)};
  }
  Vec3 normal(const Vec2& flat) const {
    return plane() ? Vec3(0, 0, 1) : Vec3(std::sin(angle(flat.x())), 0, std::cos(angle(flat.x())));
  }
  Vec3 direction(const Vec2& flat) const {
    return plane() ? Vec3(1, 0, 0) : Vec3(std::cos(angle(flat.x())), 0, -std::sin(angle(flat.x())));
  }
  // The coordinate of the place below which a point lies, texels.
  Vec2 exact(const Vec3& point) const {
    const double along = plane() ? point.x() : middle() + radius * std::atan2(point.x(), point.z() + radius);
    return Vec2(along, point.y()) / voxel;
  }
  int nearest_vertex(const Vec3& point) const {
    const Vec2 flat = voxel * exact(point);
    const int column = static_cast<int>(std::lround(flat.x() / step)),
              row = static_cast<int>(std::lround(flat.y() / step));
    int best = -1;
    double least = 1e300;
    for (int j = std::max(0, row - 2); j <= std::min(count, row + 2); ++j)
      for (int i = std::max(0, column - 2); i <= std::min(count, column + 2); ++i) {
        const double d = (mesh.mesh.vertex(j * (count + 1) + i) - point).squaredNorm();
        if (d < least) least = d, best = j * (count + 1) + i;
      }
    return best;
  }
  // Of the grid points below the strip's middle, to `depth`; nearest points lie on the smooth surface.
  DistanceField field(double depth) const {
    DistanceField f;
    f.frame = {Vec3(0.31, 0.17, 0.11) * voxel, voxel};
    f.inside_band = depth;
    f.outside_band = voxel;
    const Vec3 low(plane() ? 0 : -middle(), 0, -1.5 * middle() - depth), high(2 * middle(), 2 * middle(), voxel);
    const Vec3i lower = (low / (8 * voxel)).array().floor().matrix().cast<int>();
    const Vec3i counts = (high / (8 * voxel)).array().ceil().matrix().cast<int>() - lower + Vec3i::Ones();
    f.distance = TwoLevelGrid<float>(lower, counts, static_cast<float>(voxel));
    f.nearest_vertex = TwoLevelGrid<std::int32_t>(lower, counts, -1);
    f.nearest_point = TwoLevelGrid<Vec3f>(lower, counts, Vec3f::Zero());
    const Vec3i from = 8 * lower, to = 8 * (lower + counts);
    for (int i = from.x(); i < to.x(); ++i)
      for (int k = from.z(); k < to.z(); ++k) {
        const Vec3 across = f.frame.to_world(Vec3i(i, 0, k));
        const double d = plane() ? across.z() : std::hypot(across.x(), across.z() + radius) - radius;
        if (d > 0 || d < -depth) continue;
        const double along = exact(across).x() * voxel;
        if (along < 3 * step || along > 2 * middle() - 3 * step) continue;
        for (int j = from.y(); j < to.y(); ++j) {
          const Vec3 p = f.frame.to_world(Vec3i(i, j, k));
          if (p.y() < 3 * step || p.y() > 2 * middle() - 3 * step) continue;
          const Vec3 at = rolled({along, p.y()});
          f.distance.set(i, j, k, static_cast<float>(d));
          f.nearest_vertex.set(i, j, k, nearest_vertex(at));
          f.nearest_point.set(i, j, k, at.cast<float>());
        }
      }
    return f;
  }
};

}  // namespace shellgrid::testing
