// SPDX-License-Identifier: AGPL-3.0-or-later
#include "solvers/diffusion/surface_transfer.h"

#include <Eigen/Geometry>
#include <Eigen/LU>
#include <algorithm>
#include <cmath>

#include "meshing/core/error.h"
#include "meshing/core/parallel.h"
#include "meshing/surface/closest_point.h"

namespace shellgrid {
namespace {

struct Quad {
  Vec3 x[4];
  Quad(const Polygrid& polygrid, Eigen::Index quad) {
    for (int a = 0; a < 4; ++a) x[a] = polygrid.points.row(polygrid.boundary_quads(quad, a)).transpose();
  }
  Vec3 along_s(double t) const { return (1 - t) * (x[1] - x[0]) + t * (x[2] - x[3]); }
  Vec3 along_t(double s) const { return (1 - s) * (x[3] - x[0]) + s * (x[2] - x[1]); }
  static std::array<double, 4> values(double s, double t) {
    return {(1 - s) * (1 - t), s * (1 - t), s * t, (1 - s) * t};
  }
  Vec3 at(double s, double t) const {
    const auto v = values(s, t);
    return v[0] * x[0] + v[1] * x[1] + v[2] * x[2] + v[3] * x[3];
  }
};

// Coordinates (s, t) of the quad's point nearest to `point`, from a start: damped Gauss–Newton within the square.
void nearest_in_quad(const Quad& quad, const Vec3& point, double& s, double& t) {
  for (int iteration = 0; iteration < 6; ++iteration) {
    const Vec3 rest = point - quad.at(s, t), ds = quad.along_s(t), dt = quad.along_t(s);
    double a = ds.dot(ds), b = ds.dot(dt), c = dt.dot(dt), e = ds.dot(rest), f = dt.dot(rest);
    // A coordinate at its bound that would leave the square is held.
    const bool hold_s = (s <= 0 && e < 0) || (s >= 1 && e > 0);
    const bool hold_t = (t <= 0 && f < 0) || (t >= 1 && f > 0);
    double step_s = 0, step_t = 0;
    const double determinant = a * c - b * b;
    if (!hold_s && !hold_t && determinant > 1e-12 * a * c) {
      step_s = (c * e - b * f) / determinant;
      step_t = (a * f - b * e) / determinant;
    } else if (!hold_s && a > 0) {
      step_s = e / a;
    } else if (!hold_t && c > 0) {
      step_t = f / c;
    }
    const double new_s = std::clamp(s + step_s, 0.0, 1.0), new_t = std::clamp(t + step_t, 0.0, 1.0);
    if ((point - quad.at(new_s, new_t)).squaredNorm() > rest.squaredNorm()) return;
    const double moved = std::abs(new_s - s) + std::abs(new_t - t);
    s = new_s;
    t = new_t;
    if (moved < 1e-6) return;
  }
}

}  // namespace

SurfaceTransfer::SurfaceTransfer(const Polygrid& polygrid, const TriangleMesh& surface, const VertexMatrix* places)
    : polygrid_(polygrid) {
  const Eigen::Index quads = polygrid.boundary_quads.rows();
  if (quads == 0) throw InputError("polygrid: it has no boundary quads");
  if (surface.face_count() == 0) throw InputError("surface: it has no faces");

  const ClosestPointQuery mesh_query(surface);
  static const double gauss[3] = {0.5 - 0.38729833462074168852, 0.5, 0.5 + 0.38729833462074168852};
  static const double weight[3] = {5.0 / 18, 8.0 / 18, 5.0 / 18};
  samples_.resize(9 * static_cast<std::size_t>(quads));
  std::vector<double> distance(static_cast<std::size_t>(quads) + surface.vertex_count(), 0.0);
  parallel_for(
      static_cast<std::size_t>(quads),
      [&](std::size_t q) {
        const Quad quad(polygrid, q);
        for (int i = 0; i < 3; ++i)
          for (int j = 0; j < 3; ++j) {
            const double s = gauss[i], t = gauss[j];
            const SurfacePoint nearest = mesh_query.nearest(quad.at(s, t));
            const double area = weight[i] * weight[j] * quad.along_s(t).cross(quad.along_t(s)).norm();
            const auto values = Quad::values(s, t);
            QuadSample& sample = samples_[9 * q + 3 * i + j];
            for (int k = 0; k < 3; ++k) {
              sample.vertices[k] = surface.faces(nearest.face_index, k);
              sample.weights[k] = static_cast<float>(nearest.barycentric[k]);
            }
            for (int k = 0; k < 4; ++k) sample.areas[k] = static_cast<float>(area * values[k]);
            distance[q] = std::max(distance[q], nearest.squared_distance);
          }
      },
      64);

  TriangleMesh boundary;
  boundary.vertices = polygrid.points;
  boundary.faces.resize(2 * quads, 3);
  for (Eigen::Index q = 0; q < quads; ++q) {
    const auto c = polygrid.boundary_quads.row(q);
    boundary.faces.row(2 * q) << c[0], c[1], c[2];
    boundary.faces.row(2 * q + 1) << c[0], c[2], c[3];
  }
  const ClosestPointQuery quad_query(boundary);
  locations_.resize(surface.vertex_count());
  parallel_for(
      locations_.size(),
      [&](std::size_t v) {
        const Vec3 point = (places ? *places : surface.vertices).row(static_cast<Eigen::Index>(v)).transpose();
        const SurfacePoint nearest = quad_query.nearest(point);
        VertexLocation& location = locations_[v];
        location.quad = nearest.face_index / 2;
        // Barycentric weights of the half that was hit, as the quad's coordinates.
        const Vec3& w = nearest.barycentric;
        double s = nearest.face_index % 2 == 0 ? w[1] + w[2] : w[1];
        double t = nearest.face_index % 2 == 0 ? w[2] : w[1] + w[2];
        nearest_in_quad(Quad(polygrid, location.quad), point, s, t);
        const auto values = Quad::values(s, t);
        for (int k = 0; k < 4; ++k) location.weights[k] = static_cast<float>(values[k]);
        distance[quads + v] = nearest.squared_distance;
      },
      64);
  largest_distance_ = std::sqrt(*std::max_element(distance.begin(), distance.end()));
}

std::vector<Rgb> SurfaceTransfer::to_points(const std::vector<Rgb>& vertex_values) const {
  std::vector<Eigen::Array3d> sum(polygrid_.points.rows(), Eigen::Array3d::Zero());
  std::vector<double> area(polygrid_.points.rows(), 0.0);
  for (std::size_t k = 0; k < samples_.size(); ++k) {
    const QuadSample& sample = samples_[k];
    Rgb value = Rgb::Zero();
    for (int c = 0; c < 3; ++c) value += sample.weights[c] * vertex_values[sample.vertices[c]];
    for (int a = 0; a < 4; ++a) {
      const std::int32_t point = polygrid_.boundary_quads(static_cast<Eigen::Index>(k / 9), a);
      sum[point] += value.cast<double>() * sample.areas[a];
      area[point] += sample.areas[a];
    }
  }
  std::vector<Rgb> result(sum.size(), Rgb::Zero());
  for (std::size_t i = 0; i < sum.size(); ++i)
    if (area[i] > 0) result[i] = (sum[i] / area[i]).cast<float>();
  return result;
}

std::vector<Rgb> SurfaceTransfer::to_vertices(const std::vector<Rgb>& point_values) const {
  std::vector<Rgb> result(locations_.size(), Rgb::Zero());
  for (std::size_t v = 0; v < locations_.size(); ++v)
    for (int a = 0; a < 4; ++a)
      result[v] += locations_[v].weights[a] * point_values[polygrid_.boundary_quads(locations_[v].quad, a)];
  return result;
}

Eigen::Array3d surface_integral(const TriangleMesh& mesh, const std::vector<Rgb>& values) {
  Eigen::Array3d total = Eigen::Array3d::Zero();
  for (int f = 0; f < mesh.face_count(); ++f) {
    const Vec3 a = mesh.corner(f, 0);
    const double third = (mesh.corner(f, 1) - a).cross(mesh.corner(f, 2) - a).norm() / 6;
    for (int k = 0; k < 3; ++k) total += third * values[mesh.faces(f, k)].cast<double>();
  }
  return total;
}

}  // namespace shellgrid
