// SPDX-License-Identifier: AGPL-3.0-or-later
#include "meshing/surface/half_edges.h"

#include <Eigen/Geometry>
#include <algorithm>
#include <array>
#include <cmath>
#include <tuple>

#include "meshing/core/error.h"
#include "meshing/core/parallel.h"

namespace shellgrid {

HalfEdges build_half_edges(const TriangleMesh& mesh) {
  struct Key {
    std::int32_t low, high, half_edge;
  };
  const int count = 3 * mesh.face_count();
  std::vector<Key> keys(count);
  for (std::int32_t h = 0; h < count; ++h) {
    const std::int32_t a = HalfEdges::from(mesh, h), b = HalfEdges::to(mesh, h);
    if (a < 0 || b < 0 || a >= mesh.vertex_count() || b >= mesh.vertex_count())
      throw InputError("face " + std::to_string(h / 3) + " refers to a vertex that does not exist");
    keys[h] = {std::min(a, b), std::max(a, b), h};
  }
  std::sort(keys.begin(), keys.end(), [](const Key& a, const Key& b) {
    return std::tie(a.low, a.high, a.half_edge) < std::tie(b.low, b.high, b.half_edge);
  });
  HalfEdges result;
  result.twin.assign(count, -1);
  for (int i = 0; i < count;) {
    int end = i + 1;
    while (end < count && keys[end].low == keys[i].low && keys[end].high == keys[i].high) ++end;
    const std::int32_t h = keys[i].half_edge;
    const bool paired = end - i == 2;
    if (end - i > 2 || keys[i].low == keys[i].high ||
        (paired && HalfEdges::from(mesh, h) == HalfEdges::from(mesh, keys[i + 1].half_edge)))
      throw InputError("edge between vertices " + std::to_string(keys[i].low) + " and " + std::to_string(keys[i].high) +
                       " is not manifold or not consistently oriented; try sg-prepare");
    if (paired) result.twin[h] = keys[i + 1].half_edge, result.twin[keys[i + 1].half_edge] = h;
    i = end;
  }
  result.outgoing.assign(mesh.vertex_count(), -1);
  for (std::int32_t h = 0; h < count; ++h) {
    std::int32_t& entry = result.outgoing[HalfEdges::from(mesh, h)];
    // At a boundary the first half-edge counter-clockwise has no twin.
    if (entry < 0 || result.twin[h] < 0) entry = h;
  }
  return result;
}

VertexMatrix vertex_normals(const TriangleMesh& mesh) {
  // Angles by threads; summed up face by face.
  const auto cross = [&](int f) -> Vec3 {
    return (mesh.corner(f, 1) - mesh.corner(f, 0)).cross(mesh.corner(f, 2) - mesh.corner(f, 0));
  };
  std::vector<std::array<double, 3>> weights(static_cast<std::size_t>(mesh.face_count()));
  parallel_for(weights.size(), [&](std::size_t face) {
    const int f = static_cast<int>(face);
    const Vec3 corners[3] = {mesh.corner(f, 0), mesh.corner(f, 1), mesh.corner(f, 2)};
    const double length = cross(f).norm();
    for (int k = 0; k < 3; ++k) {
      const Vec3 a = corners[(k + 1) % 3] - corners[k], b = corners[(k + 2) % 3] - corners[k];
      weights[face][k] = length > 0 ? std::atan2(length, a.dot(b)) / length : 0;
    }
  });
  VertexMatrix normals = VertexMatrix::Zero(mesh.vertex_count(), 3);
  for (int f = 0; f < mesh.face_count(); ++f) {
    const Vec3 normal = cross(f);
    if (!(normal.norm() > 0)) continue;
    for (int k = 0; k < 3; ++k) normals.row(mesh.faces(f, k)) += weights[f][k] * normal.transpose();
  }
  parallel_for(mesh.vertex_count(), [&](std::size_t v) {
    const double length = normals.row(v).norm();
    if (length > 0)
      normals.row(v) /= length;
    else
      normals.row(v) = Eigen::RowVector3d(0, 0, 1);
  });
  return normals;
}

double mean_edge_length(const TriangleMesh& mesh) {
  const std::size_t count = 3 * static_cast<std::size_t>(mesh.face_count());
  if (count == 0) return 0;
  return parallel_sum(count, 0.0,
                      [&](std::size_t h) {
                        return (mesh.vertex(HalfEdges::from(mesh, static_cast<std::int32_t>(h))) -
                                mesh.vertex(HalfEdges::to(mesh, static_cast<std::int32_t>(h))))
                            .norm();
                      }) /
         static_cast<double>(count);
}

}  // namespace shellgrid
