// SPDX-License-Identifier: AGPL-3.0-or-later
#include "synthesis/tangent_neighbours.h"

#include <Eigen/Geometry>
#include <cmath>

#include "meshing/surface/direction_field.h"
#include "meshing/surface/surface_walk.h"

namespace shellgrid {

TangentNeighbour find_tangent_neighbour(const TexturedSurface& surface, const VertexHierarchy::Level& level, int vertex,
                                        const Vec2& offset, double voxel, int symmetry) {
  const double texel = surface.texel_length(vertex, voxel);
  TangentNeighbour neighbour;
  const double length = offset.norm();
  const Vec3 normal = surface.normals.row(vertex).transpose();
  const Vec3 u = surface.directions.row(vertex).transpose();
  const Vec3 v = normal.cross(u);
  Vec3 position = surface.mesh.vertex(vertex), at_u = u, at_normal = normal;
  std::int32_t nearest = -1;
  if (length > 0) {
    const Vec2 heading = offset / length;
    const SurfaceWalkEnd end = walk_from_vertex(surface.mesh, surface.half_edges, vertex, normal,
                                                heading.x() * u + heading.y() * v, length * texel);
    if (end.face < 0) return neighbour;
    position = end.position;
    at_normal = end.normal;
    // The frame keeps its angle to the walk.
    at_u = heading.x() * end.direction - heading.y() * end.normal.cross(end.direction);
    double best = 1e300;
    for (int k = 0; k < 3; ++k) {
      const std::int32_t candidate = level.nearest[surface.mesh.faces(end.face, k)];
      const double distance = (surface.mesh.vertex(candidate) - position).squaredNorm();
      if (distance < best) best = distance, nearest = candidate;
    }
  } else {
    nearest = level.nearest[vertex];
  }
  const Vec3 at_v = at_normal.cross(at_u);
  // The rest of the way, flattened without shortening it.
  const Vec3 rest = surface.mesh.vertex(nearest) - position;
  Vec2 flat(rest.dot(at_u), rest.dot(at_v));
  if (flat.norm() > 1e-12) flat *= rest.norm() / flat.norm();
  const Vec3 n = surface.normals.row(nearest).transpose();
  const Vec3 carried = carry_tangent(at_u, at_normal, n);
  const Vec3 own_u = surface.directions.row(nearest).transpose();
  const Vec2 turn(carried.dot(own_u), carried.dot(n.cross(own_u)));
  neighbour.vertex = nearest;
  neighbour.offset = (offset + flat / texel).cast<float>();
  double angle = turn.norm() > 1e-9 ? std::atan2(turn.y(), turn.x()) : 0.0;
  if (symmetry > 1) {
    const double period = 2 * M_PI / symmetry;
    neighbour.turn = static_cast<int>(std::lround(angle / period));
    angle -= period * neighbour.turn;
  }
  const double ratio = texel / surface.texel_length(nearest, voxel);
  neighbour.cosine = static_cast<float>(ratio * std::cos(angle));
  neighbour.sine = static_cast<float>(ratio * std::sin(angle));
  return neighbour;
}

}  // namespace shellgrid
