// SPDX-License-Identifier: AGPL-3.0-or-later
#include "meshing/surface/surface_quality.h"

#include <Eigen/Geometry>
#include <algorithm>
#include <cmath>
#include <limits>
#include <map>
#include <mutex>
#include <numbers>

#include "meshing/core/parallel.h"
#include "meshing/surface/closest_point.h"
#include "meshing/surface/half_edges.h"

namespace shellgrid {

EdgeStatistics measure_edges(const TriangleMesh& mesh) {
  EdgeStatistics statistics;
  double least = std::numeric_limits<double>::infinity(), greatest = 0, count = 0, sum = 0, squares = 0;
  for (int f = 0; f < mesh.face_count(); ++f)
    for (int k = 0; k < 3; ++k) {
      if (mesh.faces(f, k) > mesh.faces(f, (k + 1) % 3)) continue;  // the other face counts it
      const double length = (mesh.corner(f, (k + 1) % 3) - mesh.corner(f, k)).norm();
      least = std::min(least, length);
      greatest = std::max(greatest, length);
      sum += length, squares += length * length, ++count;
    }
  if (count == 0) return statistics;
  statistics.mean = sum / count;
  statistics.deviation = std::sqrt(std::max(0.0, squares / count - statistics.mean * statistics.mean));
  statistics.least = least;
  statistics.greatest = greatest;
  return statistics;
}

namespace {

// Calls visit(chunk, point, squared distance) for the samples of `from`, chunks side by side, each in order. Returns
// the greatest squared distance.
template <class Visit>
double visit_samples(const TriangleMesh& from, const TriangleMesh& to, double spacing, const Visit& visit) {
  const ClosestPointQuery query(to);
  constexpr std::size_t chunk = 1024;
  const std::size_t vertices = static_cast<std::size_t>(from.vertex_count()),
                    count = vertices + static_cast<std::size_t>(from.face_count());
  std::vector<double> greatest((count + chunk - 1) / chunk, 0.0);
  parallel_chunks(count, chunk, [&](std::size_t begin, std::size_t end) {
    const auto sample = [&](const Vec3& p) {
      const double squared = query.nearest(p).squared_distance;
      greatest[begin / chunk] = std::max(greatest[begin / chunk], squared);
      visit(begin / chunk, p, squared);
    };
    for (std::size_t item = begin; item < end; ++item) {
      if (item < vertices) {
        sample(from.vertex(static_cast<int>(item)));
        continue;
      }
      const int f = static_cast<int>(item - vertices);
      const Vec3 a = from.corner(f, 0), ab = from.corner(f, 1) - a, ac = from.corner(f, 2) - a;
      const double area = 0.5 * ab.cross(ac).norm();
      // The centres of a regular division into n² triangles.
      const int n = std::clamp(static_cast<int>(std::ceil(std::sqrt(2 * area) / spacing)), 1, 1000);
      for (int i = 0; i < n; ++i)
        for (int j = 0; i + j < n; ++j)
          for (int half = 0; half < (i + j + 1 < n ? 2 : 1); ++half) {
            const double shift = half == 0 ? 1.0 / 3 : 2.0 / 3;
            sample(a + (i + shift) / n * ab + (j + shift) / n * ac);
          }
    }
  });
  return greatest.empty() ? 0.0 : *std::max_element(greatest.begin(), greatest.end());
}

}  // namespace

double sampled_distance(const TriangleMesh& from, const TriangleMesh& to, double spacing) {
  return std::sqrt(visit_samples(from, to, spacing, [](std::size_t, const Vec3&, double) {}));
}

std::vector<Vec3> samples_beyond(const TriangleMesh& from, const TriangleMesh& to, double spacing, double limit) {
  std::map<std::size_t, std::vector<Vec3>> found;
  std::mutex guard;
  visit_samples(from, to, spacing, [&](std::size_t chunk, const Vec3& p, double squared) {
    if (squared <= limit * limit) return;
    const std::lock_guard lock(guard);
    found[chunk].push_back(p);
  });
  std::vector<Vec3> result;
  for (const auto& [chunk, points] : found) result.insert(result.end(), points.begin(), points.end());
  return result;
}

namespace {

// Edges whose faces' normals differ by more than the angle, as faces without area.
TriangleMesh sharp_edges(const TriangleMesh& mesh, double angle) {
  const HalfEdges half_edges = build_half_edges(mesh);
  const double limit = std::cos(angle * std::numbers::pi / 180);
  const auto normal = [&](std::int32_t h) {
    const int f = h / 3;
    return (mesh.corner(f, 1) - mesh.corner(f, 0)).cross(mesh.corner(f, 2) - mesh.corner(f, 0)).normalized();
  };
  std::vector<Eigen::Vector3i> edges;
  for (std::int32_t h = 0; h < 3 * mesh.face_count(); ++h) {
    const std::int32_t twin = half_edges.twin[h];
    if (twin < h || normal(h).dot(normal(twin)) >= limit) continue;
    edges.emplace_back(HalfEdges::from(mesh, h), HalfEdges::to(mesh, h), HalfEdges::to(mesh, h));
  }
  TriangleMesh result;
  result.vertices = mesh.vertices;
  result.faces.resize(static_cast<Eigen::Index>(edges.size()), 3);
  for (std::size_t e = 0; e < edges.size(); ++e) result.faces.row(static_cast<Eigen::Index>(e)) = edges[e].transpose();
  return result;
}

}  // namespace

CreaseFigures compare_creases(const TriangleMesh& from, const TriangleMesh& to, double angle, double spacing) {
  const TriangleMesh creases = sharp_edges(from, angle), others = sharp_edges(to, 0.6 * angle);
  const ClosestPointQuery query(others);
  CreaseFigures figures;
  double kept = 0;
  for (int e = 0; e < creases.face_count(); ++e) {
    const Vec3 a = creases.corner(e, 0), b = creases.corner(e, 1);
    const int parts = static_cast<int>(std::clamp(std::ceil(4 * (b - a).norm() / spacing), 1.0, 1e5));
    const double length = (b - a).norm() / parts;
    for (int i = 0; i < parts; ++i) {
      const double distance = std::sqrt(query.nearest(a + (i + 0.5) / parts * (b - a)).squared_distance);
      figures.length += length;
      figures.distance = std::max(figures.distance, distance);
      if (distance <= 0.25 * spacing) kept += length;
    }
  }
  if (figures.length > 0) figures.kept = kept / figures.length;
  return figures;
}

std::vector<float> distances_to_surface(const VertexMatrix& points, const TriangleMesh& surface) {
  const ClosestPointQuery query(surface);
  std::vector<float> distances(static_cast<std::size_t>(points.rows()));
  parallel_for(distances.size(), [&](std::size_t i) {
    const Vec3 p = points.row(static_cast<Eigen::Index>(i)).transpose();
    distances[i] = static_cast<float>(std::sqrt(query.nearest(p).squared_distance));
  });
  return distances;
}

}  // namespace shellgrid
