// SPDX-License-Identifier: AGPL-3.0-or-later
#include "solvers/transport/light_emission.h"

#include <Eigen/Geometry>
#include <algorithm>
#include <cmath>
#include <numbers>

#include "meshing/core/error.h"
#include "solvers/transport/phase.h"

namespace shellgrid {
namespace {

constexpr double pi = std::numbers::pi;

double luminance(const Rgb& c) { return 0.2126 * c[0] + 0.7152 * c[1] + 0.0722 * c[2]; }
// No channel may be missed, however dark it looks.
double importance(const Rgb& c) { return luminance(c) + 0.1 * c.sum(); }

// Evenly from a cone; `height` is one less the cosine of its half angle, which narrow cones need exactly.
Vec3 in_cone(const Vec3& axis, double height, PathRandom& random) {
  const double h = height * random.next(), sine = std::sqrt(h * (2 - h));
  const CosineSine azimuth = random.azimuth();
  const Vec3 u = axis.unitOrthogonal(), v = axis.cross(u);
  return ((1 - h) * axis + sine * (azimuth.cosine * u + azimuth.sine * v)).normalized();
}

std::size_t draw(const std::vector<double>& cumulative, double u) {
  const auto at = std::upper_bound(cumulative.begin(), cumulative.end(), u * cumulative.back());
  return std::min(cumulative.size() - 1, static_cast<std::size_t>(at - cumulative.begin()));
}

}  // namespace

EnvironmentSampler::EnvironmentSampler(const EnvironmentLight& environment) {
  up_ = environment.up.normalized();
  forward_ = up_.unitOrthogonal();
  right_ = forward_.cross(up_);
  constexpr int most_columns = 1024, most_rows = 512;
  if (environment.image) {
    columns_ = std::clamp(2 * environment.image->width, 64, most_columns);
    rows_ = std::clamp(2 * environment.image->height, 32, most_rows);
  } else {
    columns_ = 4;
    rows_ = 64;
  }
  EnvironmentLight without_lamps = environment;
  without_lamps.lamps.clear();
  chance_.resize(static_cast<std::size_t>(columns_) * rows_);
  double table_flux = 0, lamp_flux = 0;
  // Several looks at each cell; where a picture is finer than the table the even share covers what they miss.
  constexpr int looks = 2;
  for (int row = 0; row < rows_; ++row)
    for (int column = 0; column < columns_; ++column) {
      double mean = 0;
      for (int a = 0; a < looks; ++a)
        for (int b = 0; b < looks; ++b) {
          const double polar = pi * (row + (a + 0.5) / looks) / rows_,
                       longitude = 2 * pi * (column + (b + 0.5) / looks) / columns_;
          const Vec3 d =
              std::cos(polar) * up_ + std::sin(polar) * (std::cos(longitude) * forward_ + std::sin(longitude) * right_);
          mean += importance(radiance(without_lamps, d)) / (looks * looks);
        }
      const double solid_angle = 2 * pi / columns_ * (std::cos(pi * row / rows_) - std::cos(pi * (row + 1) / rows_));
      chance_[static_cast<std::size_t>(row) * columns_ + column] = mean * solid_angle;
      table_flux += mean * solid_angle;
    }
  for (const EnvironmentLight::Lamp& lamp : environment.lamps) {
    const double cosine = std::cos(std::min(lamp.half_angle, pi));
    const double flux = importance(lamp.radiance * environment.scale) * 2 * pi * (1 - cosine);
    if (!(flux > 0)) continue;
    cones_.push_back({lamp.direction.normalized(), cosine, flux});
    lamp_flux += flux;
  }
  flux_ = table_flux + lamp_flux;
  even_share_ = flux_ > 0 ? 0.05 : 1;
  table_share_ = flux_ > 0 ? (1 - even_share_) * table_flux / flux_ : 0;
  for (Cone& cone : cones_) cone.share *= (1 - even_share_) / flux_;
  double sum = 0;
  for (double& value : chance_) {
    if (table_flux > 0) value /= table_flux;
    cumulative_.push_back(sum += value);
  }
}

int EnvironmentSampler::cell_of(const Vec3& direction) const {
  const double polar = std::acos(std::clamp(direction.dot(up_), -1.0, 1.0));
  double longitude = std::atan2(direction.dot(right_), direction.dot(forward_));
  if (longitude < 0) longitude += 2 * pi;
  const int row = std::clamp(static_cast<int>(polar / pi * rows_), 0, rows_ - 1);
  const int column = std::clamp(static_cast<int>(longitude / (2 * pi) * columns_), 0, columns_ - 1);
  return row * columns_ + column;
}

Vec3 EnvironmentSampler::direction(PathRandom& random) const {
  double u = random.next();
  if (u < even_share_) return even_direction(random).normalized();
  u -= even_share_;
  for (const Cone& cone : cones_) {
    if (u < cone.share) return in_cone(cone.axis, 1 - cone.cosine, random);
    u -= cone.share;
  }
  if (!(table_share_ > 0)) return in_cone(cones_.back().axis, 1 - cones_.back().cosine, random);
  const std::size_t cell = draw(cumulative_, random.next());
  const int row = static_cast<int>(cell) / columns_, column = static_cast<int>(cell) % columns_;
  const double top = std::cos(pi * row / rows_), bottom = std::cos(pi * (row + 1) / rows_);
  const double cosine = top + (bottom - top) * random.next(), sine = std::sqrt(std::max(0.0, 1 - cosine * cosine));
  const CosineSine longitude = turn(std::min((column + random.next()) / columns_, 1 - 1e-16));
  return (cosine * up_ + sine * (longitude.cosine * forward_ + longitude.sine * right_)).normalized();
}

double EnvironmentSampler::density(const Vec3& direction) const {
  double density = even_share_ / (4 * pi);
  for (const Cone& cone : cones_)
    if (cone.axis.dot(direction) >= cone.cosine) density += cone.share / (2 * pi * (1 - cone.cosine));
  if (table_share_ > 0) {
    const int cell = cell_of(direction), row = cell / columns_;
    const double solid_angle = 2 * pi / columns_ * (std::cos(pi * row / rows_) - std::cos(pi * (row + 1) / rows_));
    density += table_share_ * chance_[static_cast<std::size_t>(cell)] / solid_angle;
  }
  return density;
}

LightEmission::LightEmission(const std::vector<Light>& lights, const TriangleMesh& mesh, const Vec3& centre,
                             double radius)
    : lights_(lights), centre_(centre), radius_(radius) {
  const double disc = pi * radius * radius;
  double sum = 0;
  for (const Light& light : lights_) {
    double power = 0;
    int part = -1;
    if (const auto* directional = std::get_if<DirectionalLight>(&light)) {
      const Vec3 d = directional->direction.normalized(), u = d.unitOrthogonal(), v = d.cross(u);
      const Eigen::VectorXd x = mesh.vertices * u, y = mesh.vertices * v;
      const double left = x.minCoeff(), bottom = y.minCoeff();
      Window window{left * u + bottom * v + (centre.dot(d) - 1.001 * radius) * d, (x.maxCoeff() - left) * u,
                    (y.maxCoeff() - bottom) * v};
      power = importance(directional->irradiance) * window.along.norm() * window.across.norm();
      part = static_cast<int>(windows_.size());
      windows_.push_back(window);
    } else if (const auto* point = std::get_if<PointLight>(&light)) {
      const double distance = (point->position - centre).norm();
      power = importance(point->intensity) * std::min(4 * pi, disc / std::max(1e-300, distance * distance));
    } else if (const auto* area = std::get_if<AreaLight>(&light)) {
      const double distance = (area->position - centre).norm();
      power = importance(area->radiance) * area->width * area->height *
              std::min(pi, disc / std::max(1e-300, distance * distance));
    } else if (const auto* environment = std::get_if<EnvironmentLight>(&light)) {
      part = static_cast<int>(samplers_.size());
      samplers_.emplace_back(*environment);
      power = samplers_.back().flux() * disc;
    }
    if (!std::isfinite(power)) throw InputError("lights: their power is beyond all numbers");
    part_.push_back(part);
    chance_.push_back(power);
    cumulative_.push_back(sum += power);
  }
  if (sum > 0)
    for (double& chance : chance_) chance /= sum;
  else
    lights_.clear();
}

Vec3 LightEmission::towards_object(const Vec3& point, PathRandom& random, double& solid_angle) const {
  const Vec3 way = centre_ - point;
  const double distance = way.norm(), sine = 1.0001 * radius_ / distance;
  if (!(sine < 1)) {
    solid_angle = 4 * pi;
    return even_direction(random).normalized();
  }
  // 1 − cos, exact for narrow cones.
  const double height = sine * sine / (1 + std::sqrt(1 - sine * sine));
  solid_angle = 2 * pi * height;
  return in_cone(way / distance, height, random);
}

EmittedRay LightEmission::emit_directional(const DirectionalLight& light, const Window& window,
                                           PathRandom& random) const {
  EmittedRay ray;
  const double u = random.next(), v = random.next();
  ray.origin = window.corner + u * window.along + v * window.across;
  ray.direction = light.direction.normalized();
  ray.power = to_double(to_lanes(light.irradiance)) * (window.along.norm() * window.across.norm());
  return ray;
}

EmittedRay LightEmission::emit_point(const PointLight& light, PathRandom& random) const {
  EmittedRay ray;
  double solid_angle = 0;
  ray.origin = light.position;
  ray.direction = towards_object(light.position, random, solid_angle);
  ray.power = to_double(to_lanes(light.intensity)) * solid_angle;
  return ray;
}

EmittedRay LightEmission::emit_area(const AreaLight& light, PathRandom& random) const {
  EmittedRay ray;
  const AreaFrame frame(light);
  const double u = random.next() - 0.5, v = random.next() - 0.5;
  double solid_angle = 0;
  ray.origin = light.position + u * light.width * frame.right + v * light.height * frame.up;
  ray.direction = towards_object(ray.origin, random, solid_angle);
  const double cosine = std::max(0.0, ray.direction.dot(frame.normal));
  ray.power = to_double(to_lanes(light.radiance)) * (cosine * solid_angle * light.width * light.height);
  return ray;
}

EmittedRay LightEmission::emit_environment(const EnvironmentLight& light, const EnvironmentSampler& sampler,
                                           PathRandom& random) const {
  EmittedRay ray;
  const Vec3 towards = sampler.direction(random);
  const double r = radius_ * std::sqrt(random.next());
  const CosineSine azimuth = random.azimuth();
  const Vec3 u = towards.unitOrthogonal(), v = towards.cross(u);
  ray.origin = centre_ + 1.001 * radius_ * towards + r * (azimuth.cosine * u + azimuth.sine * v);
  ray.direction = -towards;
  ray.power = to_double(to_lanes(radiance(light, towards))) * (pi * radius_ * radius_ / sampler.density(towards));
  return ray;
}

EmittedRay LightEmission::emit(PathRandom& random) const {
  if (lights_.empty()) return {};
  const std::size_t k = lights_.size() == 1 ? 0 : draw(cumulative_, random.next());
  const Light& light = lights_[k];
  EmittedRay ray;
  if (const auto* directional = std::get_if<DirectionalLight>(&light))
    ray = emit_directional(*directional, windows_[static_cast<std::size_t>(part_[k])], random);
  else if (const auto* point = std::get_if<PointLight>(&light))
    ray = emit_point(*point, random);
  else if (const auto* area = std::get_if<AreaLight>(&light))
    ray = emit_area(*area, random);
  else if (const auto* environment = std::get_if<EnvironmentLight>(&light))
    ray = emit_environment(*environment, samplers_[static_cast<std::size_t>(part_[k])], random);
  ray.power *= 1 / chance_[k];
  return ray;
}

}  // namespace shellgrid
