// SPDX-License-Identifier: AGPL-3.0-or-later
// Closed surfaces of known genus, made in code.
#pragma once
#include <array>
#include <cmath>
#include <functional>
#include <map>
#include <numbers>
#include <vector>

#include "meshing/core/triangle_mesh.h"

namespace shellgrid::voxel_shapes {

// The boundary of the unit cells (i, j, k) in [0, size) where inside(i, j, k), as triangles, smoothed by
// averaging over neighbours.
inline TriangleMesh voxel_surface(const Vec3i& size, const std::function<bool(int, int, int)>& inside, int smoothing) {
  const auto filled = [&](const Vec3i& c) {
    return (c.array() >= 0).all() && (c.array() < size.array()).all() && inside(c.x(), c.y(), c.z());
  };
  std::map<std::array<int, 3>, int> index;
  std::vector<Vec3> points;
  std::vector<std::array<int, 4>> quads;
  for (int k = 0; k < size.z(); ++k)
    for (int j = 0; j < size.y(); ++j)
      for (int i = 0; i < size.x(); ++i) {
        const Vec3i cell(i, j, k);
        if (!filled(cell)) continue;
        for (int side = 0; side < 6; ++side) {
          const int axis = side / 2, u = (axis + 1) % 3, v = (axis + 2) % 3;
          if (filled(cell + (side & 1 ? 1 : -1) * Vec3i::Unit(axis))) continue;
          std::array<int, 4> quad;
          for (int n = 0; n < 4; ++n) {
            Vec3i p = cell + (side & 1) * Vec3i::Unit(axis);
            if (n == 1 || n == 2) p[u] += 1;
            if (n == 2 || n == 3) p[v] += 1;
            const auto [found, fresh] = index.try_emplace({p.x(), p.y(), p.z()}, static_cast<int>(points.size()));
            if (fresh) points.push_back(p.cast<double>());
            quad[side & 1 ? n : 3 - n] = found->second;
          }
          quads.push_back(quad);
        }
      }
  for (int round = 0; round < smoothing; ++round) {
    std::vector<Vec3> sum(points.size(), Vec3::Zero());
    std::vector<int> count(points.size(), 0);
    for (const auto& q : quads)
      for (int n = 0; n < 4; ++n) sum[q[n]] += points[q[(n + 1) % 4]] + points[q[(n + 3) % 4]], count[q[n]] += 2;
    for (std::size_t p = 0; p < points.size(); ++p) points[p] = 0.5 * points[p] + 0.5 * sum[p] / count[p];
  }
  TriangleMesh mesh;
  mesh.vertices.resize(static_cast<Eigen::Index>(points.size()), 3);
  for (std::size_t p = 0; p < points.size(); ++p) mesh.vertices.row(p) = points[p].transpose();
  mesh.faces.resize(2 * static_cast<Eigen::Index>(quads.size()), 3);
  for (std::size_t q = 0; q < quads.size(); ++q) {
    mesh.faces.row(2 * q) << quads[q][0], quads[q][1], quads[q][2];
    mesh.faces.row(2 * q + 1) << quads[q][0], quads[q][2], quads[q][3];
  }
  return mesh;
}

// A surface of rings and segments: rows × columns points, closed in both directions.
inline TriangleMesh torus(double radius, double tube, int rows = 60, int columns = 24) {
  TriangleMesh mesh;
  mesh.vertices.resize(rows * columns, 3);
  mesh.faces.resize(2 * rows * columns, 3);
  for (int i = 0; i < rows; ++i)
    for (int j = 0; j < columns; ++j) {
      const double a = 2 * std::numbers::pi * i / rows, b = 2 * std::numbers::pi * j / columns;
      mesh.vertices.row(i * columns + j) << (radius + tube * std::cos(b)) * std::cos(a),
          (radius + tube * std::cos(b)) * std::sin(a), tube * std::sin(b);
      const int p = i * columns + j, q = (i + 1) % rows * columns + j;
      const int r = (i + 1) % rows * columns + (j + 1) % columns, s = i * columns + (j + 1) % columns;
      mesh.faces.row(2 * p) << p, q, r;
      mesh.faces.row(2 * p + 1) << p, r, s;
    }
  return mesh;
}

// A cube's surface of n×n squares a side, blown up to a ball.
inline TriangleMesh sphere(double radius, int n = 16) {
  TriangleMesh mesh = voxel_surface(
      Vec3i::Constant(n), [](int, int, int) { return true; }, 0);
  for (int v = 0; v < mesh.vertex_count(); ++v)
    mesh.vertices.row(v) = radius * (mesh.vertices.row(v).array() - 0.5 * n).matrix().normalized();
  return mesh;
}

inline TriangleMesh box(double x, double y, double z) {
  TriangleMesh mesh = voxel_surface(
      Vec3i::Ones(), [](int, int, int) { return true; }, 0);
  mesh.vertices = mesh.vertices * Vec3(x, y, z).asDiagonal();
  return mesh;
}

// A plate with two round holes: genus 2.
inline TriangleMesh double_torus() {
  return voxel_surface(
      {30, 16, 8},
      [](int i, int j, int) {
        const auto in_hole = [&](double x) { return std::hypot(i + 0.5 - x, j + 0.5 - 8) < 3.5; };
        return !in_hole(8) && !in_hole(22);
      },
      6);
}

// A hairpin of two bars of the given width whose gap lies at y from 4 to 4 + gap; joined at low x.
inline TriangleMesh hairpin(double gap) {
  TriangleMesh mesh = voxel_surface(
      {16, 9, 4}, [](int i, int j, int) { return j != 4 || i < 3; }, 0);
  for (int v = 0; v < mesh.vertex_count(); ++v)
    if (mesh.vertices(v, 1) > 4.5) mesh.vertices(v, 1) += gap - 1;
  return mesh;
}

// Three crossing bars of different thickness.
inline TriangleMesh branching() {
  return voxel_surface(
      Vec3i::Constant(30),
      [](int i, int j, int k) {
        const auto near = [](int a, int width) { return a >= 15 - width && a < 15 + width; };
        return (near(i, 4) && near(j, 4)) || (near(j, 3) && near(k, 3)) || (near(i, 2) && near(k, 2));
      },
      4);
}

}  // namespace shellgrid::voxel_shapes
