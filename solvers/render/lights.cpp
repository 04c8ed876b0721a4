// SPDX-License-Identifier: AGPL-3.0-or-later
#include "solvers/render/lights.h"

#include <Eigen/Geometry>
#include <algorithm>
#include <cmath>
#include <limits>
#include <numbers>

#include "meshing/core/error.h"

namespace shellgrid {
namespace {

constexpr double pi = std::numbers::pi;
constexpr double golden_angle = 2.399963229728653;

double smooth_step(double t) {
  t = std::clamp(t, 0.0, 1.0);
  return t * t * (3 - 2 * t);
}

double luminance(const Rgb& c) { return 0.2126 * c[0] + 0.7152 * c[1] + 0.0722 * c[2]; }

// Axes of an equirectangular picture.
struct Frame {
  Vec3 up, forward, right;
  explicit Frame(const Vec3& axis) : up(axis.normalized()) {
    Vec3 reference(0, 0, -1);
    if (std::abs(reference.dot(up)) > 0.999) reference = Vec3(1, 0, 0);
    forward = (reference - reference.dot(up) * up).normalized();
    right = forward.cross(up);
  }
  // Direction to longitude share u and latitude share v in [0, 1] (v = 0 at the top).
  Vec3 direction(double u, double v) const {
    const double longitude = 2 * pi * (u - 0.5), polar = pi * v;
    return std::cos(polar) * up + std::sin(polar) * (std::cos(longitude) * forward + std::sin(longitude) * right);
  }
};

struct Channels {
  const Image::Channel *r, *g, *b;
  int width, height;
  explicit Channels(const Image& image)
      : r(image.find("R")), g(image.find("G")), b(image.find("B")), width(image.width), height(image.height) {
    if (!r || !g || !b || width < 1 || height < 1) throw InputError("the environment picture lacks R, G or B");
  }
  Rgb pixel(int x, int y) const {
    const std::size_t i = static_cast<std::size_t>(y) * width + x;
    return {r->values[i], g->values[i], b->values[i]};
  }
  // Between the centres of pixels; pixel (0, 0) is centred on (0, 0), and x wraps around.
  Rgb interpolated(double x, double y) const {
    y = std::clamp(y, 0.0, height - 1.0);
    const double x_floor = std::floor(x);
    const float fx = static_cast<float>(x - x_floor), fy = static_cast<float>(y - std::floor(y));
    const int x0 = ((static_cast<int>(x_floor) % width) + width) % width, x1 = (x0 + 1) % width;
    const int y0 = static_cast<int>(y), y1 = std::min(y0 + 1, height - 1);
    const Rgb top = pixel(x0, y0) * (1 - fx) + pixel(x1, y0) * fx;
    const Rgb bottom = pixel(x0, y1) * (1 - fx) + pixel(x1, y1) * fx;
    return top * (1 - fy) + bottom * fy;
  }
};

Rgb picture_radiance(const EnvironmentLight& environment, const Vec3& direction) {
  const Channels picture(*environment.image);
  const Frame frame(environment.up);
  const double longitude = std::atan2(direction.dot(frame.right), direction.dot(frame.forward));
  const double polar = std::acos(std::clamp(direction.dot(frame.up), -1.0, 1.0));
  const double x = (longitude / (2 * pi) + 0.5) * picture.width - 0.5;
  return picture.interpolated(x, polar / pi * picture.height - 0.5);
}

Rgb sky_radiance(const EnvironmentLight& environment, const Vec3& direction) {
  const double height = direction.dot(environment.up.normalized());
  const float t = static_cast<float>(smooth_step(std::abs(height)));
  return environment.horizon * (1 - t) + (height > 0 ? environment.zenith : environment.ground) * t;
}

// Share of a lamp's radiance at cosine `cosine` from its axis.
float lamp_profile(const EnvironmentLight::Lamp& lamp, double cosine) {
  const double angle = std::acos(std::clamp(cosine, -1.0, 1.0));
  if (angle >= lamp.half_angle) return 0;
  const double fade = lamp.half_angle * lamp.softness;
  return fade > 0 ? static_cast<float>(smooth_step((lamp.half_angle - angle) / fade)) : 1.0f;
}

// Equal solid angles around the lamp's axis, on a Fibonacci spiral.
void add_lamp(const EnvironmentLight::Lamp& lamp, int count, std::vector<DirectionalLight>& lights) {
  const double height = 1 - std::cos(lamp.half_angle);
  const double solid_angle = 2 * pi * height / count;
  const Frame frame(lamp.direction);
  for (int i = 0; i < count; ++i) {
    const double c = 1 - height * (i + 0.5) / count, s = std::sqrt(std::max(0.0, 1 - c * c));
    const Vec3 towards =
        c * frame.up + s * (std::cos(golden_angle * i) * frame.forward + std::sin(golden_angle * i) * frame.right);
    const Rgb irradiance = lamp.radiance * (lamp_profile(lamp, c) * static_cast<float>(solid_angle));
    if ((irradiance > 0).any()) lights.push_back({-towards, irradiance});
  }
}

void add_sky(const EnvironmentLight& environment, int count, std::vector<DirectionalLight>& lights) {
  const Frame frame(environment.up);
  for (int i = 0; i < count; ++i) {
    const double c = 1 - (2 * i + 1.0) / count, s = std::sqrt(1 - c * c);
    const Vec3 towards =
        c * frame.up + s * (std::cos(golden_angle * i) * frame.forward + std::sin(golden_angle * i) * frame.right);
    const Rgb irradiance = sky_radiance(environment, towards) * static_cast<float>(4 * pi / count);
    if ((irradiance > 0).any()) lights.push_back({-towards, irradiance});
  }
}

// A small picture with more pixels, as it is seen: lights cannot be finer than the pixels they stand for.
Image refined(const Image& image, int least_width, int least_height) {
  const Channels picture(image);
  const int along = (least_width + image.width - 1) / image.width,
            down = (least_height + image.height - 1) / image.height;
  Image fine;
  fine.width = along * image.width;
  fine.height = down * image.height;
  fine.channels.reserve(3);
  for (const char* name : {"R", "G", "B"}) fine.add(name);
  for (int y = 0; y < fine.height; ++y)
    for (int x = 0; x < fine.width; ++x) {
      const Rgb value = picture.interpolated((x + 0.5) / along - 0.5, (y + 0.5) / down - 0.5);
      for (int k = 0; k < 3; ++k) fine.channels[k].values[static_cast<std::size_t>(y) * fine.width + x] = value[k];
    }
  return fine;
}

// Cuts the picture's regions in two halves of equal energy until `count` remain, the one of most energy first.
void add_picture(const EnvironmentLight& environment, int count, std::vector<DirectionalLight>& lights) {
  constexpr int least_width = 64, least_height = 32;
  const bool small = environment.image->width < least_width || environment.image->height < least_height;
  const Image fine = small ? refined(*environment.image, least_width, least_height) : Image();
  const Channels picture(small ? fine : *environment.image);
  const Frame frame(environment.up);
  const int w = picture.width, h = picture.height;
  // Summed-area table of luminance times solid angle.
  std::vector<double> sums(static_cast<std::size_t>(w + 1) * (h + 1), 0.0);
  auto sum = [&](int x, int y) -> double& { return sums[static_cast<std::size_t>(y) * (w + 1) + x]; };
  auto solid_angle = [&](int y) { return 2 * pi / w * (std::cos(pi * y / h) - std::cos(pi * (y + 1) / h)); };
  for (int y = 0; y < h; ++y)
    for (int x = 0; x < w; ++x) {
      const Rgb pixel = picture.pixel(x, y);
      if (!pixel.isFinite().all() || (pixel < 0).any())
        throw InputError("the environment picture holds a negative or non-finite value");
      sum(x + 1, y + 1) = luminance(pixel) * solid_angle(y) + sum(x, y + 1) + sum(x + 1, y) - sum(x, y);
    }
  struct Region {
    int x0, y0, x1, y1;
    double energy;
  };
  auto energy = [&](int x0, int y0, int x1, int y1) { return sum(x1, y1) - sum(x0, y1) - sum(x1, y0) + sum(x0, y0); };
  std::vector<Region> regions{{0, 0, w, h, energy(0, 0, w, h)}};
  auto weaker = [](const Region& a, const Region& b) {
    if (a.energy != b.energy) return a.energy < b.energy;
    return std::pair(a.y0, a.x0) > std::pair(b.y0, b.x0);
  };
  std::vector<Region> finished;
  while (!regions.empty() && static_cast<int>(regions.size() + finished.size()) < count) {
    std::pop_heap(regions.begin(), regions.end(), weaker);
    const Region r = regions.back();
    regions.pop_back();
    // The longer side on the sphere is cut.
    const double width = (r.x1 - r.x0) * 2.0 / w * std::sin(pi * 0.5 * (r.y0 + r.y1) / h),
                 height = 1.0 * (r.y1 - r.y0) / h;
    const bool along_x = r.x1 - r.x0 > 1 && (width >= height || r.y1 - r.y0 == 1);
    if (!along_x && r.y1 - r.y0 == 1) {
      finished.push_back(r);
      continue;
    }
    const int low = along_x ? r.x0 : r.y0, high = along_x ? r.x1 : r.y1;
    int cut = low + 1;
    auto first_half = [&](int at) { return along_x ? energy(r.x0, r.y0, at, r.y1) : energy(r.x0, r.y0, r.x1, at); };
    while (cut < high - 1 && first_half(cut) < 0.5 * r.energy) ++cut;
    Region a = r, b = r;
    (along_x ? a.x1 : a.y1) = cut;
    (along_x ? b.x0 : b.y0) = cut;
    for (Region part : {a, b}) {
      part.energy = energy(part.x0, part.y0, part.x1, part.y1);
      regions.push_back(part);
      std::push_heap(regions.begin(), regions.end(), weaker);
    }
  }
  regions.insert(regions.end(), finished.begin(), finished.end());
  for (const Region& r : regions) {
    Eigen::Array3d irradiance = Eigen::Array3d::Zero();
    Vec3 centroid = Vec3::Zero();
    for (int y = r.y0; y < r.y1; ++y)
      for (int x = r.x0; x < r.x1; ++x) {
        const Eigen::Array3d part = picture.pixel(x, y).cast<double>() * solid_angle(y);
        irradiance += part;
        centroid += luminance(part.cast<float>()) * frame.direction((x + 0.5) / w, (y + 0.5) / h);
      }
    if ((irradiance > 0).any() && centroid.norm() > 0)
      lights.push_back({-centroid.normalized(), irradiance.cast<float>()});
  }
}

}  // namespace

Rgb radiance(const EnvironmentLight& environment, const Vec3& direction) {
  Rgb sum = environment.image ? picture_radiance(environment, direction) : sky_radiance(environment, direction);
  for (const EnvironmentLight::Lamp& lamp : environment.lamps)
    sum += lamp.radiance * lamp_profile(lamp, direction.dot(lamp.direction.normalized()));
  return sum * environment.scale;
}

std::vector<DirectionalLight> directional_lights(const EnvironmentLight& environment, int count) {
  std::vector<DirectionalLight> lights;
  // Lamps get half of the lights, shared by the square root of their energy: bright ones need finer shadows.
  double total = 0;
  auto importance = [](const EnvironmentLight::Lamp& lamp) {
    return std::sqrt(luminance(lamp.radiance) * (1 - std::cos(lamp.half_angle)));
  };
  for (const EnvironmentLight::Lamp& lamp : environment.lamps) total += importance(lamp);
  for (const EnvironmentLight::Lamp& lamp : environment.lamps)
    if (total > 0) add_lamp(lamp, std::max(8, static_cast<int>(0.5 * count * importance(lamp) / total)), lights);
  const int rest = std::max(16, total > 0 ? count / 2 : count);
  if (environment.image)
    add_picture(environment, rest, lights);
  else if ((environment.zenith > 0).any() || (environment.horizon > 0).any() || (environment.ground > 0).any())
    add_sky(environment, rest, lights);
  for (DirectionalLight& light : lights) light.irradiance *= environment.scale;
  return lights;
}

IncidentBeam incident_beam(const DirectionalLight& light, const Vec3&) {
  return {-light.direction.normalized(), std::numeric_limits<double>::infinity(), light.irradiance};
}

IncidentBeam incident_beam(const PointLight& light, const Vec3& point) {
  const Vec3 way = light.position - point;
  const double distance = way.norm();
  if (!(distance > 0)) return {Vec3(0, 0, 1), 0, Rgb::Zero()};
  return {way / distance, distance, light.intensity / static_cast<float>(distance * distance)};
}

IncidentBeam incident_beam(const PatchLight& light, const Vec3& point) {
  IncidentBeam beam = incident_beam(PointLight{light.position, light.intensity}, point);
  beam.irradiance *= static_cast<float>(std::max(0.0, -beam.direction.dot(light.direction)));
  return beam;
}

IncidentBeam incident_beam(const SimpleLight& light, const Vec3& point) {
  return std::visit([&](const auto& any) { return incident_beam(any, point); }, light);
}

std::optional<Vec3> light_position(const Light& light) {
  if (const auto* point = std::get_if<PointLight>(&light)) return point->position;
  if (const auto* area = std::get_if<AreaLight>(&light)) return area->position;
  return std::nullopt;
}

AreaFrame::AreaFrame(const AreaLight& light) : normal(light.direction.normalized()) {
  up = light.up - light.up.dot(normal) * normal;
  up = up.norm() > 1e-9 * light.up.norm() ? Vec3(up.normalized()) : normal.unitOrthogonal();
  right = up.cross(normal);
}

Rgb radiance(const AreaLight& light, const Vec3& origin, const Vec3& direction, double distance) {
  const AreaFrame frame(light);
  const double cosine = -direction.dot(frame.normal);
  if (!(cosine > 0)) return Rgb::Zero();
  const double t = (origin - light.position).dot(frame.normal) / cosine;
  if (!(t > 0) || t > distance) return Rgb::Zero();
  const Vec3 at = origin + t * direction - light.position;
  const bool within =
      std::abs(at.dot(frame.right)) <= 0.5 * light.width && std::abs(at.dot(frame.up)) <= 0.5 * light.height;
  return within ? light.radiance : Rgb(Rgb::Zero());
}

std::vector<PatchLight> patch_lights(const AreaLight& light, int count) {
  if (light.patches > 0) count = light.patches;
  const AreaFrame frame(light);
  const double edge = std::sqrt(light.width * light.height / std::max(1, count));
  const int columns = std::clamp(static_cast<int>(std::lround(light.width / edge)), 1, std::max(1, count));
  const int rows = std::clamp(static_cast<int>(std::lround(light.height / edge)), 1, std::max(1, count));
  const Rgb intensity = light.radiance * static_cast<float>(light.width * light.height / (columns * rows));
  std::vector<PatchLight> patches;
  for (int row = 0; row < rows; ++row)
    for (int column = 0; column < columns; ++column)
      patches.push_back({light.position + ((column + 0.5) / columns - 0.5) * light.width * frame.right +
                             ((row + 0.5) / rows - 0.5) * light.height * frame.up,
                         frame.normal, intensity});
  return patches;
}

std::vector<SimpleLight> simple_lights(const std::vector<Light>& lights, int environment_samples) {
  std::vector<SimpleLight> simple;
  for (const Light& light : lights) {
    if (const auto* directional = std::get_if<DirectionalLight>(&light)) simple.emplace_back(*directional);
    if (const auto* point = std::get_if<PointLight>(&light)) simple.emplace_back(*point);
    if (const auto* area = std::get_if<AreaLight>(&light))
      for (const PatchLight& patch : patch_lights(*area, environment_samples / 4)) simple.emplace_back(patch);
    if (const auto* environment = std::get_if<EnvironmentLight>(&light))
      for (const DirectionalLight& part : directional_lights(*environment, environment_samples))
        simple.emplace_back(part);
  }
  return simple;
}

}  // namespace shellgrid
