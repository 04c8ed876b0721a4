// SPDX-License-Identifier: AGPL-3.0-or-later
#include "solvers/render/floor.h"

#include <Eigen/Geometry>
#include <algorithm>
#include <cmath>
#include <numbers>

#include "meshing/core/parallel.h"

namespace shellgrid {
namespace {

constexpr double pi = std::numbers::pi;
constexpr int grid = 193;                // points across
constexpr double grid_half_width = 1.6;  // in sizes of the object
constexpr int bounce_directions = 64;

}  // namespace

LitFloor::LitFloor(const Floor& floor, const TriangleMesh& mesh, const SceneGeometry& geometry, const Vec3& up,
                   const std::vector<Light>& lights, int environment_samples,
                   const std::function<Rgb(const SceneGeometry::Hit&)>& radiosity, Progress& progress)
    : floor_(floor), geometry_(&geometry), up_(up.normalized()) {
  std::vector<SimpleLight> soft;
  for (const Light& light : lights)
    for (const SimpleLight& simple : simple_lights({light}, environment_samples))
      (has_extent(light) ? soft : sharp_).push_back(simple);
  const Vec3 lower = mesh.vertices.colwise().minCoeff().transpose(),
             upper = mesh.vertices.colwise().maxCoeff().transpose();
  const Vec3 middle = 0.5 * (lower + upper);
  size_ = (upper - lower).maxCoeff();
  const double height = (mesh.vertices * up_).minCoeff() - geometry.offset();
  centre_ = middle + (height - middle.dot(up_)) * up_;
  right_ = up_.unitOrthogonal();
  forward_ = up_.cross(right_);
  half_width_ = grid_half_width * size_;
  step_ = 2 * half_width_ / (grid - 1);
  irradiance_.assign(static_cast<std::size_t>(grid) * grid, Rgb::Zero());

  // Rays that pass the object's bounding sphere need no tracing.
  const double radius = 0.5 * (upper - lower).norm();
  auto may_hit = [&](const Vec3& point, const Vec3& direction) {
    const Vec3 way = middle - point;
    const double along = way.dot(direction);
    return along > -radius && way.squaredNorm() - along * along < radius * radius;
  };
  std::vector<Vec3> bounces(bounce_directions);
  for (int i = 0; i < bounce_directions; ++i) {
    // Cosine-weighted directions on a Fibonacci spiral.
    const double c2 = (i + 0.5) / bounce_directions, s = std::sqrt(1 - c2), angle = 2.399963229728653 * i;
    bounces[i] = std::sqrt(c2) * up_ + s * (std::cos(angle) * right_ + std::sin(angle) * forward_);
  }

  std::vector<std::int64_t> traced(grid, 0), skipped(grid, 0);
  progress.begin("light the floor", grid);
  parallel_for(
      grid,
      [&](std::size_t j) {
        for (int i = 0; i < grid; ++i) {
          const Vec3 point = grid_point(i, static_cast<int>(j));
          Rgb sum = Rgb::Zero();
          for (const SimpleLight& light : soft) {
            const IncidentBeam beam = incident_beam(light, point);
            const double cosine = beam.direction.dot(up_);
            if (!(cosine > 0)) continue;
            const bool trace = may_hit(point, beam.direction);
            ++(trace ? traced : skipped)[j];
            if (trace && geometry.occluded(point, beam.direction, beam.distance)) continue;
            sum += beam.irradiance * static_cast<float>(cosine);
          }
          for (const Vec3& direction : bounces) {
            const bool trace = may_hit(point, direction);
            ++(trace ? traced : skipped)[j];
            if (!trace) continue;
            const auto hit = geometry.intersect(point, direction);
            // Each direction stands for π/n of cosine-weighted solid angle; the object radiates M/π.
            if (hit) sum += radiosity(*hit) / static_cast<float>(bounce_directions);
          }
          irradiance_[j * grid + i] = sum;
        }
        progress.advance();
      },
      1);
  progress.end();
  for (int j = 0; j < grid; ++j) shadow_rays_ += traced[j], shadow_rays_skipped_ += skipped[j];
}

std::optional<double> LitFloor::intersect(const Vec3& origin, const Vec3& direction) const {
  const double height = (origin - centre_).dot(up_), descent = -direction.dot(up_);
  if (!(height > 0) || !(descent > 0)) return std::nullopt;
  return height / descent;
}

double LitFloor::opacity(const Vec3& point) const {
  const double near = 0.35 * floor_.radius * size_, far = floor_.radius * size_;
  const double t = std::clamp(((point - centre_).norm() - near) / (far - near), 0.0, 1.0);
  return 1 - t * t * (3 - 2 * t);
}

Rgb LitFloor::radiance(const Vec3& point) const {
  const double x = std::clamp(((point - centre_).dot(right_) + half_width_) / step_, 0.0, grid - 1.0);
  const double y = std::clamp(((point - centre_).dot(forward_) + half_width_) / step_, 0.0, grid - 1.0);
  const int i = std::min(static_cast<int>(x), grid - 2), j = std::min(static_cast<int>(y), grid - 2);
  const auto fx = static_cast<float>(x - i), fy = static_cast<float>(y - j);
  const Rgb* row = irradiance_.data() + static_cast<std::size_t>(j) * grid + i;
  const Rgb near = row[0] * (1 - fx) + row[1] * fx, far = row[grid] * (1 - fx) + row[grid + 1] * fx;
  Rgb sum = near * (1 - fy) + far * fy;
  for (const SimpleLight& light : sharp_) {
    const IncidentBeam beam = incident_beam(light, point);
    const double cosine = beam.direction.dot(up_);
    if (!(cosine > 0)) continue;
    ++sharp_rays_;
    if (!geometry_->occluded(point, beam.direction, beam.distance)) sum += beam.irradiance * static_cast<float>(cosine);
  }
  return sum * floor_.reflectance / static_cast<float>(pi);
}

}  // namespace shellgrid
