// SPDX-License-Identifier: AGPL-3.0-or-later
// The bilinear quads of a polygrid's boundary.
#pragma once
#include <Eigen/Geometry>
#include <algorithm>
#include <array>

#include "meshing/polycube/polygrid.h"

namespace shellgrid {

struct QuadPoint {
  Vec3 position, normal;
  double area = 0;  // mm² a unit of s·t
};

// The place (s, t) of the unit square in a boundary quad, whose corners follow (0, 0), (1, 0), (1, 1), (0, 1).
inline QuadPoint quad_point(const Polygrid& polygrid, std::int32_t quad, double s, double t) {
  Vec3 x[4];
  for (int a = 0; a < 4; ++a) x[a] = polygrid.points.row(polygrid.boundary_quads(quad, a)).transpose();
  const Vec3 along_s = (1 - t) * (x[1] - x[0]) + t * (x[2] - x[3]);
  const Vec3 along_t = (1 - s) * (x[3] - x[0]) + s * (x[2] - x[1]);
  QuadPoint point;
  point.position = (1 - s) * (1 - t) * x[0] + s * (1 - t) * x[1] + s * t * x[2] + (1 - s) * t * x[3];
  point.normal = along_s.cross(along_t);
  point.area = point.normal.norm();
  if (point.area > 0) point.normal /= point.area;
  return point;
}

// The corners' hat functions there.
inline std::array<double, 4> quad_hats(double s, double t) {
  return {(1 - s) * (1 - t), s * (1 - t), s * t, (1 - s) * t};
}

// About the edge of a quad that is a rhombus or a rectangle, mm.
inline double quad_width(const Polygrid& polygrid, std::int32_t quad) {
  Vec3 x[4];
  for (int a = 0; a < 4; ++a) x[a] = polygrid.points.row(polygrid.boundary_quads(quad, a)).transpose();
  return 0.70710678118654752440 * std::max((x[2] - x[0]).norm(), (x[3] - x[1]).norm());
}

}  // namespace shellgrid
