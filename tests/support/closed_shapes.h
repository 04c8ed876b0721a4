// SPDX-License-Identifier: AGPL-3.0-or-later
// Closed meshes for tests, counter-clockwise from outside.
#pragma once
#include <Eigen/Geometry>
#include <cmath>
#include <map>
#include <numbers>
#include <utility>
#include <vector>

#include "meshing/core/random.h"
#include "meshing/core/triangle_mesh.h"

namespace shellgrid::shapes {

inline TriangleMesh from_lists(const std::vector<Vec3>& vertices, const std::vector<Eigen::Vector3i>& faces) {
  TriangleMesh mesh;
  mesh.vertices.resize(static_cast<Eigen::Index>(vertices.size()), 3);
  mesh.faces.resize(static_cast<Eigen::Index>(faces.size()), 3);
  for (std::size_t i = 0; i < vertices.size(); ++i)
    mesh.vertices.row(static_cast<Eigen::Index>(i)) = vertices[i].transpose();
  for (std::size_t i = 0; i < faces.size(); ++i) mesh.faces.row(static_cast<Eigen::Index>(i)) = faces[i].transpose();
  return mesh;
}

// A box centred on the origin, two triangles a side.
inline TriangleMesh box(const Vec3& size) {
  std::vector<Vec3> v;
  for (int k = 0; k < 8; ++k) v.push_back(size.cwiseProduct(Vec3((k & 1) - 0.5, (k >> 1 & 1) - 0.5, (k >> 2) - 0.5)));
  return from_lists(v, {{0, 2, 3},
                        {0, 3, 1},
                        {4, 5, 7},
                        {4, 7, 6},
                        {0, 1, 5},
                        {0, 5, 4},
                        {2, 6, 7},
                        {2, 7, 3},
                        {0, 4, 6},
                        {0, 6, 2},
                        {1, 3, 7},
                        {1, 7, 5}});
}

// Two cones over a regular polygon: `sides` faces meet at each tip.
inline TriangleMesh double_cone(int sides, double radius, double up, double down) {
  std::vector<Vec3> v;
  std::vector<Eigen::Vector3i> f;
  for (int i = 0; i < sides; ++i) {
    const double angle = 2 * std::numbers::pi * i / sides;
    v.emplace_back(radius * std::cos(angle), radius * std::sin(angle), 0);
    f.emplace_back(i, (i + 1) % sides, sides);
    f.emplace_back((i + 1) % sides, i, sides + 1);
  }
  v.emplace_back(0, 0, up);
  v.emplace_back(0, 0, -down);
  return from_lists(v, f);
}

inline TriangleMesh torus(double major, double minor, int around, int across) {
  std::vector<Vec3> v;
  std::vector<Eigen::Vector3i> f;
  for (int i = 0; i < around; ++i)
    for (int j = 0; j < across; ++j) {
      const double s = 2 * std::numbers::pi * i / around, t = 2 * std::numbers::pi * j / across;
      const double r = major + minor * std::cos(t);
      v.emplace_back(r * std::cos(s), r * std::sin(s), minor * std::sin(t));
      const int a = i * across + j, b = (i + 1) % around * across + j;
      const int c = (i + 1) % around * across + (j + 1) % across, d = i * across + (j + 1) % across;
      f.emplace_back(a, b, c);
      f.emplace_back(a, c, d);
    }
  return from_lists(v, f);
}

inline TriangleMesh sphere(double radius, int subdivisions) {
  std::vector<Vec3> v = {{1, 0, 0}, {-1, 0, 0}, {0, 1, 0}, {0, -1, 0}, {0, 0, 1}, {0, 0, -1}};
  std::vector<Eigen::Vector3i> f = {{0, 2, 4}, {2, 1, 4}, {1, 3, 4}, {3, 0, 4},
                                    {2, 0, 5}, {1, 2, 5}, {3, 1, 5}, {0, 3, 5}};
  for (int round = 0; round < subdivisions; ++round) {
    std::map<std::pair<int, int>, int> middle;
    const auto split = [&](int a, int b) {
      const auto [at, added] = middle.try_emplace(std::minmax(a, b), static_cast<int>(v.size()));
      if (added) v.push_back((v[a] + v[b]).normalized());
      return at->second;
    };
    std::vector<Eigen::Vector3i> finer;
    for (const Eigen::Vector3i& t : f) {
      const int ab = split(t[0], t[1]), bc = split(t[1], t[2]), ca = split(t[2], t[0]);
      finer.insert(finer.end(), {{t[0], ab, ca}, {t[1], bc, ab}, {t[2], ca, bc}, {ab, bc, ca}});
    }
    f = finer;
  }
  for (Vec3& p : v) p *= radius;
  return from_lists(v, f);
}

inline TriangleMesh moved(TriangleMesh mesh, const Vec3& by) {
  mesh.vertices.rowwise() += by.transpose();
  return mesh;
}

inline TriangleMesh turned_around(TriangleMesh mesh) {
  mesh.faces.col(1).swap(mesh.faces.col(2));
  return mesh;
}

inline TriangleMesh rotated(TriangleMesh mesh, std::uint64_t seed) {
  RandomStream random(seed);
  const Vec3 axis = Vec3(random.next() - 0.5, random.next() - 0.5, random.next() - 0.5).normalized();
  const Mat3 rotation = Eigen::AngleAxisd(2 * std::numbers::pi * random.next(), axis).toRotationMatrix();
  mesh.vertices = (mesh.vertices * rotation.transpose()).eval();
  return mesh;
}

inline TriangleMesh joined(const TriangleMesh& a, const TriangleMesh& b) {
  TriangleMesh mesh;
  mesh.vertices.resize(a.vertices.rows() + b.vertices.rows(), 3);
  mesh.vertices << a.vertices, b.vertices;
  mesh.faces.resize(a.faces.rows() + b.faces.rows(), 3);
  mesh.faces << a.faces, (b.faces.array() + a.vertex_count()).matrix();
  return mesh;
}

}  // namespace shellgrid::shapes
