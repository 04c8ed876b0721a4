// SPDX-License-Identifier: AGPL-3.0-or-later
#include "solvers/diffusion/crease_split.h"

#include <Eigen/Geometry>
#include <algorithm>
#include <numeric>
#include <tuple>

namespace shellgrid {
namespace {

constexpr double least_cosine = 0.70710678118654752;  // between normals of faces that are one surface

// Corners of faces (3 f + k) that are the same vertex of the same smooth part: their sets' least corners.
std::vector<std::int32_t> smooth_corners(const TriangleMesh& surface, const std::vector<Vec3>& normals) {
  const std::int32_t faces = surface.face_count();
  std::vector<std::int32_t> set(3 * static_cast<std::size_t>(faces));
  std::iota(set.begin(), set.end(), 0);
  const auto find = [&](std::int32_t corner) {
    while (set[corner] != corner) corner = set[corner] = set[set[corner]];
    return corner;
  };
  const auto join = [&](std::int32_t a, std::int32_t b) {
    a = find(a);
    b = find(b);
    set[std::max(a, b)] = std::min(a, b);
  };
  // Half-edges by their ends; those of one edge stand together.
  std::vector<std::int32_t> edges(set);
  const auto ends = [&](std::int32_t h) {
    const std::int32_t a = surface.faces(h / 3, h % 3), b = surface.faces(h / 3, (h % 3 + 1) % 3);
    return std::tuple(std::min(a, b), std::max(a, b));
  };
  std::sort(edges.begin(), edges.end(), [&](std::int32_t g, std::int32_t h) {
    return std::tuple_cat(ends(g), std::tuple(g)) < std::tuple_cat(ends(h), std::tuple(h));
  });
  for (std::size_t i = 0; i < edges.size();) {
    std::size_t end = i + 1;
    while (end < edges.size() && ends(edges[end]) == ends(edges[i])) ++end;
    const std::int32_t g = edges[i], h = edges[end - 1];
    if (end == i + 2 && normals[g / 3].dot(normals[h / 3]) > least_cosine)
      for (int k = 0; k < 2; ++k)
        for (int l = 0; l < 2; ++l) {
          const std::int32_t a = g / 3 * 3 + (g + k) % 3, b = h / 3 * 3 + (h + l) % 3;
          if (surface.faces(a / 3, a % 3) == surface.faces(b / 3, b % 3)) join(a, b);
        }
    i = end;
  }
  for (std::size_t corner = 0; corner < set.size(); ++corner) set[corner] = find(static_cast<std::int32_t>(corner));
  return set;
}

}  // namespace

CreaseSplit::CreaseSplit(const TriangleMesh& surface) : mesh_(surface) {
  const std::int32_t vertices = surface.vertex_count(), faces = surface.face_count();
  vertices_ = static_cast<std::size_t>(vertices);
  std::vector<Vec3> normals(faces);
  std::vector<double> areas(faces);
  for (std::int32_t f = 0; f < faces; ++f) {
    const Vec3 a = surface.corner(f, 0), cross = (surface.corner(f, 1) - a).cross(surface.corner(f, 2) - a);
    areas[f] = cross.norm() / 2;
    normals[f] = cross.stableNormalized();
  }
  const std::vector<std::int32_t> set = smooth_corners(surface, normals);
  // The set that is met first keeps the vertex.
  std::vector<std::int32_t> vertex_of(set.size(), -1);
  std::vector<char> taken(vertices, 0), copied(vertices, 0);
  original_.resize(vertices);
  std::iota(original_.begin(), original_.end(), 0);
  for (std::size_t corner = 0; corner < set.size(); ++corner) {
    const auto f = static_cast<std::int32_t>(corner / 3), k = static_cast<std::int32_t>(corner % 3);
    std::int32_t& own = vertex_of[set[corner]];
    if (own < 0) {
      const std::int32_t vertex = surface.faces(f, k);
      own = vertex;
      if (taken[vertex]) {
        own = static_cast<std::int32_t>(original_.size());
        original_.push_back(vertex);
        copied[vertex] = 1;
      }
      taken[vertex] = 1;
    }
    mesh_.faces(f, k) = own;
  }
  const auto count = static_cast<Eigen::Index>(original_.size());
  mesh_.vertices.conservativeResize(count, 3);
  for (Eigen::Index v = vertices; v < count; ++v) mesh_.vertices.row(v) = surface.vertices.row(original_[v]);
  places_ = VertexMatrix::Zero(count, 3);
  area_.assign(original_.size(), 0.0);
  for (std::int32_t f = 0; f < faces; ++f)
    for (int k = 0; k < 3; ++k) {
      const Vec3 centroid =
          0.5 * mesh_.corner(f, k) + 0.25 * (mesh_.corner(f, (k + 1) % 3) + mesh_.corner(f, (k + 2) % 3));
      places_.row(mesh_.faces(f, k)) += areas[f] * centroid.transpose();
      area_[mesh_.faces(f, k)] += areas[f];
    }
  for (Eigen::Index v = 0; v < count; ++v) {
    if (copied[original_[v]] && area_[v] > 0)
      places_.row(v) /= area_[v];
    else
      places_.row(v) = mesh_.vertices.row(v);
  }
}

std::vector<Rgb> CreaseSplit::merge(const std::vector<Rgb>& values) const {
  std::vector<Rgb> sum(vertices_, Rgb::Zero());
  std::vector<double> area(vertices_, 0.0);
  for (std::size_t v = 0; v < values.size(); ++v) area[original_[v]] += area_[v];
  for (std::size_t v = 0; v < values.size(); ++v) {
    const std::int32_t o = original_[v];
    sum[o] += area_[v] == area[o] ? values[v] : Rgb(static_cast<float>(area_[v] / area[o]) * values[v]);
  }
  return sum;
}

}  // namespace shellgrid
