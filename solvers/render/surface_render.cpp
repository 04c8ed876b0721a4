// SPDX-License-Identifier: AGPL-3.0-or-later
#include "solvers/render/surface_render.h"

#include <fmt/format.h>

#include <Eigen/Geometry>
#include <algorithm>
#include <atomic>
#include <cmath>
#include <numbers>

#include "meshing/core/error.h"
#include "meshing/core/parallel.h"
#include "solvers/render/picture_stage.h"

namespace shellgrid {
namespace {

constexpr float pi = std::numbers::pi_v<float>;
using Hit = SceneGeometry::Hit;

Rgb interpolate(const std::vector<Rgb>& values, const TriangleMesh& mesh, const Hit& hit) {
  Rgb sum = Rgb::Zero();
  for (int k = 0; k < 3; ++k) sum += values[mesh.faces(hit.face_index, k)] * static_cast<float>(hit.barycentric[k]);
  return sum;
}

}  // namespace

RenderedImage render_surface(const TriangleMesh& mesh, const TranslucentSurface& surface,
                             const std::vector<Light>& lights, const Camera& camera, const RenderSettings& settings,
                             Progress& progress) {
  if (static_cast<int>(surface.exitance.size()) != mesh.vertex_count())
    throw InputError(
        fmt::format("{} values of exitance for {} vertices", surface.exitance.size(), mesh.vertex_count()));
  for (const Rgb& value : surface.exitance)
    if (!value.isFinite().all()) throw InputError("the exitance is not finite everywhere");
  PictureStage stage(mesh, lights, camera, settings);
  const double ior = surface.ior;
  const auto normalization = static_cast<float>(diffuse_fresnel(ior).exit_normalization);

  // L = M F_t / (π ∫ 2μ F_t dμ), PHYSICS "Where light leaves".
  auto leaving = [&](const Hit& hit, double cosine) -> Rgb {
    const auto transmittance = static_cast<float>(fresnel_transmittance(cosine, ior));
    return interpolate(surface.exitance, mesh, hit).max(0) * (transmittance / (pi * normalization));
  };
  if (settings.floor)
    stage.floor.emplace(
        *settings.floor, mesh, stage.geometry, stage.up, lights, settings.environment_samples,
        [&](const Hit& hit) -> Rgb { return interpolate(surface.exitance, mesh, hit).max(0); }, progress);

  // The object's radiance towards where a ray came from, its own mirror image showing the environment alone.
  auto glimpse = [&](const Hit& hit, const Vec3& direction) -> Rgb {
    const Vec3 normal = stage.shading_normal(hit, direction);
    const double cosine = std::clamp(-direction.dot(normal), 0.0, 1.0);
    return leaving(hit, cosine) +
           static_cast<float>(fresnel_reflectance(cosine, ior)) * stage.far(hit.point, reflect(direction, normal));
  };
  auto shade = [&](const Hit& hit, const Vec3& direction, FilmSample& sample, const auto&) {
    const double cosine = std::clamp(-direction.dot(sample.normal), 0.0, 1.0);
    sample.exitance = leaving(hit, cosine);
    const auto reflectance = static_cast<float>(fresnel_reflectance(cosine, ior));
    if (!(reflectance > 0)) return;
    Vec3 mirrored = reflect(direction, sample.normal);
    if (!(mirrored.dot(hit.normal) > 0)) mirrored = reflect(direction, hit.normal);
    const Vec3 origin = hit.point + stage.geometry.offset() * hit.normal;
    ++stage.mirror_rays;
    const std::optional<Hit> second = stage.geometry.intersect(origin, mirrored);
    Rgb seen;
    if (second) {
      seen = glimpse(*second, mirrored);
    } else {
      seen = stage.far(origin, mirrored);
      if (stage.floor)
        if (const std::optional<double> distance = stage.floor->intersect(origin, mirrored)) {
          const Vec3 point = origin + *distance * mirrored;
          const auto opacity = static_cast<float>(stage.floor->opacity(point));
          seen = seen * (1 - opacity) + stage.floor->radiance(point) * opacity;
        }
    }
    sample.specular = reflectance * seen;
  };
  RenderedImage picture = expose(stage, camera, shade, glimpse, progress);
  for (const Rgb& value : surface.exitance) picture.statistics.negative_exitance_vertices += (value < 0).any();
  return picture;
}

RenderedImage render_surface(const TriangleMesh& mesh, const OpaqueSurface& surface, const std::vector<Light>& lights,
                             const Camera& camera, const RenderSettings& settings, Progress& progress) {
  if ((surface.reflectance < 0).any() || (surface.reflectance > 1).any() || !surface.reflectance.isFinite().all())
    throw InputError("the reflectance is not between 0 and 1");
  PictureStage stage(mesh, lights, camera, settings);
  std::vector<SimpleLight> sharp, soft;
  for (const Light& light : lights) {
    for (const SimpleLight& simple : simple_lights({light}, settings.environment_samples))
      (has_extent(light) ? soft : sharp).push_back(simple);
  }
  auto irradiance = [&](const std::vector<SimpleLight>& some, const Vec3& point, const Vec3& face_normal,
                        const Vec3& normal) -> Rgb {
    Rgb sum = Rgb::Zero();
    std::int64_t traced = 0;
    const Vec3 origin = point + stage.geometry.offset() * face_normal;
    for (const SimpleLight& light : some) {
      const IncidentBeam beam = incident_beam(light, origin);
      const double cosine = beam.direction.dot(normal);
      if (!(cosine > 0)) continue;
      ++traced;
      if (!stage.geometry.occluded(origin, beam.direction, beam.distance))
        sum += beam.irradiance * static_cast<float>(cosine);
    }
    stage.shadow_rays += traced;
    return sum;
  };

  // Environments change slowly over the surface: once a vertex, where the camera may see it (or the floor mirror or
  // light it).
  std::vector<char> needed(mesh.vertex_count(), settings.floor ? 1 : 0);
  for (int f = 0; f < mesh.face_count(); ++f) {
    const Vec3 a = mesh.corner(f, 0), area = (mesh.corner(f, 1) - a).cross(mesh.corner(f, 2) - a);
    if (area.dot(stage.rays.origin() - a) >= 0)
      for (int k = 0; k < 3; ++k) needed[mesh.faces(f, k)] = 1;
  }
  std::vector<Rgb> soft_irradiance(mesh.vertex_count(), Rgb::Zero());
  if (!soft.empty()) {
    progress.begin("light the vertices", mesh.vertex_count());
    parallel_chunks(mesh.vertex_count(), 256, [&](std::size_t begin, std::size_t end) {
      for (std::size_t v = begin; v < end; ++v) {
        if (!needed[v]) continue;
        const Vec3 normal = stage.normals.row(static_cast<Eigen::Index>(v)).transpose();
        soft_irradiance[v] = irradiance(soft, mesh.vertex(static_cast<int>(v)), normal, normal);
      }
      progress.advance(static_cast<long>(end - begin));
    });
    progress.end();
  }
  const std::int64_t unseen = soft.empty() ? 0 : std::count(needed.begin(), needed.end(), 0);
  auto radiosity = [&](const Hit& hit, const Vec3& normal) -> Rgb {
    return surface.reflectance *
           (interpolate(soft_irradiance, mesh, hit) + irradiance(sharp, hit.point, hit.normal, normal));
  };
  if (settings.floor)
    stage.floor.emplace(
        *settings.floor, mesh, stage.geometry, stage.up, lights, settings.environment_samples,
        [&](const Hit& hit) { return radiosity(hit, hit.normal); }, progress);
  auto shade = [&](const Hit& hit, const Vec3&, FilmSample& sample, const auto&) {
    sample.exitance = radiosity(hit, sample.normal) / pi;
  };
  auto glimpse = [&](const Hit& hit, const Vec3& direction) -> Rgb {
    return radiosity(hit, stage.shading_normal(hit, direction)) / pi;
  };
  RenderedImage result = expose(stage, camera, shade, glimpse, progress);
  result.statistics.unseen_vertices_skipped = unseen;
  return result;
}

}  // namespace shellgrid
