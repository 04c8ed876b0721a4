// SPDX-License-Identifier: AGPL-3.0-or-later
// Samples and meshes that several tests share.
#pragma once
#include <cmath>
#include <map>
#include <numbers>
#include <utility>

#include "meshing/core/triangle_mesh.h"
#include "synthesis/procedural_sample.h"

namespace shellgrid::testing {

inline Material material(const Rgb& absorption, const Rgb& scattering) {
  return Material::from_absorption_scattering(absorption, scattering, Rgb::Zero());
}
inline Material marble_body() { return material({0.0021f, 0.0041f, 0.0071f}, {2.19f, 2.62f, 3.00f}); }
inline Material marble_vein() { return material({0.30f, 0.27f, 0.33f}, {1.7f, 1.9f, 2.0f}); }

inline SampleDefinition marble(int size, std::uint64_t seed = 1) {
  SampleDefinition definition;
  definition.width = definition.height = size;
  definition.seed = seed;
  MarblePattern pattern;
  pattern.body = marble_body();
  pattern.vein = marble_vein();
  pattern.veins = {{2, 1.1, 1.0, 1, 0.9, 1, 1}, {4, 0.5, 0.8, 0.7, 0.6}};
  definition.pattern = pattern;
  return definition;
}

inline SampleDefinition spots(int size) {
  SampleDefinition definition;
  definition.width = definition.height = size;
  definition.pattern = SpotsPattern{marble_body(), marble_vein(), size * size / 60, 1.0, 0.5, 0.4};
  return definition;
}

inline SampleDefinition layers(int size) {
  SampleDefinition definition;
  definition.width = definition.height = size;
  definition.pattern = LayersPattern{{{marble_body(), 1.2}, {marble_vein(), 1}}, 0.5, 3};
  return definition;
}

inline SampleDefinition bumps(int size) {
  SampleDefinition definition;
  definition.width = definition.height = size;
  definition.thickness = 6;
  definition.pattern = BumpsPattern{marble_body(), marble_vein(), size * size / 120, 1.4, 0.6};
  return definition;
}

inline SampleDefinition wood(int size) {
  SampleDefinition definition;
  definition.width = definition.height = size;
  definition.pattern = WoodPattern{marble_body(), marble_vein(), 2, 6, 0.5, 5, 0.3, 0.02};
  return definition;
}

inline SampleDefinition cells(int size) {
  SampleDefinition definition;
  definition.width = definition.height = size;
  definition.pattern = CellsPattern{marble_body(), marble_vein(), 4, 1.2, 0, 0.9};
  return definition;
}

inline SampleDefinition grass(int size) {
  SampleDefinition definition;
  definition.width = definition.height = size;
  definition.thickness = 6;
  definition.pattern = GrassPattern{marble_body(), marble_vein(), size * size / 60, 3.6, 0.6, 0.9};
  return definition;
}

inline SampleDefinition weave(int size) {
  SampleDefinition definition;
  definition.width = definition.height = size;
  definition.thickness = 6;
  definition.pattern = WeavePattern{marble_body(), marble_vein(), marble_vein(), 4, 4, 2, 2, 0.9, 1, 3};
  return definition;
}

// A flat patch of right triangles, (n + 1)² vertices `step` apart, facing +z.
inline TriangleMesh patch(int n, double step) {
  TriangleMesh mesh;
  mesh.vertices.resize((n + 1) * (n + 1), 3);
  mesh.faces.resize(2 * n * n, 3);
  for (int j = 0; j <= n; ++j)
    for (int i = 0; i <= n; ++i) mesh.vertices.row(j * (n + 1) + i) << i * step, j * step, 0;
  for (int j = 0; j < n; ++j)
    for (int i = 0; i < n; ++i) {
      const int a = j * (n + 1) + i;
      mesh.faces.row(2 * (j * n + i)) << a, a + 1, a + n + 2;
      mesh.faces.row(2 * (j * n + i) + 1) << a, a + n + 2, a + n + 1;
    }
  return mesh;
}

inline TriangleMesh torus(double major, double minor, int around, int across) {
  TriangleMesh mesh;
  mesh.vertices.resize(around * across, 3);
  mesh.faces.resize(2 * around * across, 3);
  for (int i = 0; i < around; ++i)
    for (int j = 0; j < across; ++j) {
      const double u = 2 * std::numbers::pi * i / around, v = 2 * std::numbers::pi * j / across;
      const double r = major + minor * std::cos(v);
      mesh.vertices.row(i * across + j) << r * std::cos(u), r * std::sin(u), minor * std::sin(v);
      const int a = i * across + j, b = (i + 1) % around * across + j;
      const int c = (i + 1) % around * across + (j + 1) % across, d = i * across + (j + 1) % across;
      mesh.faces.row(2 * a) << a, b, c;
      mesh.faces.row(2 * a + 1) << a, c, d;
    }
  return mesh;
}

// An octahedron split `times` times, on a sphere.
inline TriangleMesh sphere(double radius, int times) {
  std::vector<Vec3> points = {{1, 0, 0}, {-1, 0, 0}, {0, 1, 0}, {0, -1, 0}, {0, 0, 1}, {0, 0, -1}};
  std::vector<Vec3i> faces = {{0, 2, 4}, {2, 1, 4}, {1, 3, 4}, {3, 0, 4}, {2, 0, 5}, {1, 2, 5}, {3, 1, 5}, {0, 3, 5}};
  for (int round = 0; round < times; ++round) {
    std::map<std::pair<int, int>, int> middle;
    const auto split = [&](int a, int b) {
      const auto [entry, added] = middle.try_emplace(std::minmax(a, b), static_cast<int>(points.size()));
      if (added) points.push_back((points[a] + points[b]).normalized());
      return entry->second;
    };
    std::vector<Vec3i> finer;
    for (const Vec3i& f : faces) {
      const int ab = split(f[0], f[1]), bc = split(f[1], f[2]), ca = split(f[2], f[0]);
      finer.insert(finer.end(), {{f[0], ab, ca}, {ab, f[1], bc}, {ca, bc, f[2]}, {ab, bc, ca}});
    }
    faces = std::move(finer);
  }
  TriangleMesh mesh;
  mesh.vertices.resize(static_cast<Eigen::Index>(points.size()), 3);
  mesh.faces.resize(static_cast<Eigen::Index>(faces.size()), 3);
  for (std::size_t i = 0; i < points.size(); ++i)
    mesh.vertices.row(static_cast<Eigen::Index>(i)) = radius * points[i].transpose();
  for (std::size_t i = 0; i < faces.size(); ++i) mesh.faces.row(static_cast<Eigen::Index>(i)) = faces[i].transpose();
  return mesh;
}

}  // namespace shellgrid::testing
