// SPDX-License-Identifier: AGPL-3.0-or-later
#include "synthesis/shell_coordinates.h"

#include <Eigen/Geometry>
#include <algorithm>
#include <cmath>

namespace shellgrid {
namespace {

// Barycentric weights of the triangle's point nearest to p. Source: [Ericson2005 §5.1.5].
Vec3 nearest_in_triangle(const Vec3& p, const Vec3& a, const Vec3& b, const Vec3& c) {
  const Vec3 ab = b - a, ac = c - a, ap = p - a, bp = p - b, cp = p - c;
  const double d1 = ab.dot(ap), d2 = ac.dot(ap), d3 = ab.dot(bp), d4 = ac.dot(bp), d5 = ab.dot(cp), d6 = ac.dot(cp);
  if (d1 <= 0 && d2 <= 0) return {1, 0, 0};
  if (d3 >= 0 && d4 <= d3) return {0, 1, 0};
  const double vc = d1 * d4 - d3 * d2;
  if (vc <= 0 && d1 >= 0 && d3 <= 0) return {1 - d1 / (d1 - d3), d1 / (d1 - d3), 0};
  if (d6 >= 0 && d5 <= d6) return {0, 0, 1};
  const double vb = d5 * d2 - d1 * d6;
  if (vb <= 0 && d2 >= 0 && d6 <= 0) return {1 - d2 / (d2 - d6), 0, d2 / (d2 - d6)};
  const double va = d3 * d6 - d5 * d4;
  if (va <= 0 && d4 - d3 >= 0 && d5 - d6 >= 0) {
    const double w = (d4 - d3) / ((d4 - d3) + (d5 - d6));
    return {0, 1 - w, w};
  }
  const double sum = va + vb + vc;
  if (!(sum > 0)) return {1, 0, 0};
  return {va / sum, vb / sum, vc / sum};
}

}  // namespace

SurfacePlaces::SurfacePlaces(const TexturedMesh& mesh, const std::vector<Eigen::Vector2i>& sizes, double voxel)
    : mesh_(mesh), voxel_(voxel), start_(mesh.mesh.vertex_count() + 1, 0) {
  for (const Eigen::Vector2i& size : sizes) sizes_.push_back(size.cast<float>());
  const TriangleMesh& m = mesh.mesh;
  for (int f = 0; f < m.face_count(); ++f)
    for (int k = 0; k < 3; ++k) ++start_[m.faces(f, k) + 1];
  for (std::size_t v = 0; v + 1 < start_.size(); ++v) start_[v + 1] += start_[v];
  faces_.resize(start_.back());
  std::vector<std::int32_t> fill(start_.begin(), start_.end() - 1);
  for (int f = 0; f < m.face_count(); ++f)
    for (int k = 0; k < 3; ++k) faces_[fill[m.faces(f, k)]++] = f;
}

SurfacePlace SurfacePlaces::nearest(int vertex) const {
  SurfacePlace place;
  place.sample = mesh_.sample_of(vertex);
  place.coordinate = mesh_.coordinate[vertex];
  place.normal = mesh_.normals.row(vertex).transpose();
  place.u = mesh_.directions.row(vertex).transpose();
  place.v = place.normal.cross(place.u);
  return place;
}

Vec2f SurfacePlaces::continued(int vertex, const Vec3& point) const {
  const Vec3 way = (point - mesh_.mesh.vertex(vertex)) / (voxel_ * mesh_.scale_of(vertex));
  const Vec3 normal = mesh_.normals.row(vertex).transpose(), u = mesh_.directions.row(vertex).transpose();
  return mesh_.coordinate[vertex] + Vec2(way.dot(u), way.dot(normal.cross(u))).cast<float>();
}

SurfacePlace SurfacePlaces::interpolated(int vertex, const Vec3& point) const {
  SurfacePlace place = nearest(vertex);
  int face = -1;
  Vec3 weights = Vec3::Zero();
  double best = 1e300;
  const auto look_about = [&](int v) {
    for (int at = start_[v]; at < start_[v + 1]; ++at) {
      const int f = faces_[at];
      const Vec3 a = mesh_.mesh.vertex(mesh_.mesh.faces(f, 0)), b = mesh_.mesh.vertex(mesh_.mesh.faces(f, 1)),
                 c = mesh_.mesh.vertex(mesh_.mesh.faces(f, 2));
      const Vec3 w = nearest_in_triangle(point, a, b, c);
      const double distance = (w.x() * a + w.y() * b + w.z() * c - point).squaredNorm();
      if (distance < best) best = distance, face = f, weights = w;
    }
  };
  const double near = 1e-4 * voxel_ * voxel_;
  look_about(vertex);
  // Where the mesh is uneven, the triangle that holds the point need not be about the vertex nearest to it.
  for (int at = start_[vertex]; best > near && at < start_[vertex + 1]; ++at)
    for (int k = 0; k < 3; ++k) look_about(mesh_.mesh.faces(faces_[at], k));
  if (face < 0 || best > voxel_ * voxel_) {
    place.coordinate = continued(vertex, point);
    return place;
  }
  int strongest = 0;
  weights.maxCoeff(&strongest);
  const int leader = mesh_.mesh.faces(face, strongest);
  const Vec2f said = continued(leader, point);
  place.sample = mesh_.sample_of(leader);
  const Eigen::Vector2f& size = sizes_[static_cast<std::size_t>(place.sample)];
  Vec2f sum = Vec2f::Zero();
  Vec3 normal = Vec3::Zero(), u = Vec3::Zero();
  float total = 0;
  place.coherent = true;
  for (int k = 0; k < 3; ++k) {
    const int v = mesh_.mesh.faces(face, k);
    normal += weights[k] * mesh_.normals.row(v).transpose();
    Vec2f step = Vec2f::Zero();
    if (k != strongest) {
      step = continued(v, point) - said;
      step -= size.cwiseProduct((step.cwiseQuotient(size)).array().round().matrix());
    }
    if (mesh_.sample_of(v) == place.sample && step.cwiseAbs().maxCoeff() < reach) {
      sum += static_cast<float>(weights[k]) * step;
      total += static_cast<float>(weights[k]);
      u += weights[k] * mesh_.directions.row(v).transpose();
    } else {
      place.coherent = false;
    }
  }
  place.coordinate = said + sum / total;
  if (normal.norm() > 1e-6) {
    normal.normalize();
    u -= normal * normal.dot(u);
    if (u.norm() < 1e-6) u = mesh_.directions.row(leader).transpose(), u -= normal * normal.dot(u);
    if (u.norm() > 1e-6) {
      place.normal = normal;
      place.u = u.normalized();
      place.v = normal.cross(place.u);
    }
  }
  return place;
}

}  // namespace shellgrid
