// SPDX-License-Identifier: AGPL-3.0-or-later
// What all pictures share: the object, what surrounds it, and the way rays go.
#pragma once
#include <fmt/format.h>

#include <Eigen/Geometry>
#include <atomic>
#include <numbers>
#include <optional>
#include <vector>

#include "meshing/core/error.h"
#include "meshing/surface/half_edges.h"
#include "solvers/render/scene_geometry.h"
#include "solvers/render/surface_render.h"
#include "solvers/scattering/fresnel.h"

namespace shellgrid {

inline Vec3 reflect(const Vec3& direction, const Vec3& normal) {
  return direction - 2 * direction.dot(normal) * normal;
}

class PictureStage {
 public:
  using Hit = SceneGeometry::Hit;

  // Throws: InputError if the camera is inside the object.
  PictureStage(const TriangleMesh& mesh, const std::vector<Light>& lights, const Camera& camera,
               const RenderSettings& settings)
      : PictureStage(mesh, vertex_normals(mesh), lights, camera, settings) {}
  PictureStage(const TriangleMesh& mesh, VertexMatrix vertex_normals, const std::vector<Light>& lights,
               const Camera& camera, const RenderSettings& settings)
      : mesh(mesh), geometry(mesh), rays(camera), normals(std::move(vertex_normals)), settings(settings) {
    if (geometry.contains(camera.position))
      throw InputError(fmt::format("the camera at ({:g}, {:g}, {:g}) is inside the object; move its position out",
                                   camera.position.x(), camera.position.y(), camera.position.z()));
    for (const Light& light : lights) {
      if (const auto* environment = std::get_if<EnvironmentLight>(&light)) environments.push_back(*environment);
      if (const auto* area = std::get_if<AreaLight>(&light)) areas.push_back(*area);
    }
    up = environments.empty() ? Vec3(camera.up.normalized()) : Vec3(environments.front().up.normalized());
  }

  // What a ray meets that meets nothing else: rectangles that shine, before the environment or the background.
  Rgb lamps(const Vec3& origin, const Vec3& direction) const {
    Rgb sum = Rgb::Zero();
    for (const AreaLight& area : areas) sum += radiance(area, origin, direction);
    return sum;
  }
  Rgb far(const Vec3& origin, const Vec3& direction) const {
    Rgb sum = lamps(origin, direction);
    for (const EnvironmentLight& environment : environments) sum += radiance(environment, direction);
    return sum;
  }

  // The interpolated normal, or the face's where that one looks away from the viewer.
  Vec3 shading_normal(const Hit& hit, const Vec3& direction) const {
    Vec3 normal = Vec3::Zero();
    for (int k = 0; k < 3; ++k) normal += hit.barycentric[k] * normals.row(mesh.faces(hit.face_index, k)).transpose();
    const double length = normal.norm();
    if (!(length > 1e-6)) return hit.normal;
    normal /= length;
    return normal.dot(direction) < 0 && normal.dot(hit.normal) > 0 ? normal : hit.normal;
  }

  const TriangleMesh& mesh;
  SceneGeometry geometry;
  CameraRays rays;
  VertexMatrix normals;
  const RenderSettings& settings;
  std::vector<EnvironmentLight> environments;
  std::vector<AreaLight> areas;
  Vec3 up;
  std::optional<LitFloor> floor;
  mutable std::atomic<std::int64_t> mirror_rays{0}, shadow_rays{0};
};

// Exposes the film. `shade(hit, direction, sample, backdrop)` fills the sample's exitance and specular, or, where the
// ray goes on past the object, notes that in `hit` and asks `backdrop(origin, direction)` what is there; `glimpse(hit,
// direction)` is the object's radiance as a polished floor mirrors it.
template <class Shade, class Glimpse>
RenderedImage expose(const PictureStage& stage, const Camera& camera, const Shade& shade, const Glimpse& glimpse,
                     Progress& progress) {
  Film film(camera.width, camera.height, stage.settings.film);
  auto backdrop = [&](const Vec3& origin, const Vec3& direction) -> Rgb {
    const Rgb behind = stage.settings.background ? Rgb(*stage.settings.background + stage.lamps(origin, direction))
                                                 : stage.far(origin, direction);
    if (!stage.floor) return behind;
    const std::optional<double> distance = stage.floor->intersect(origin, direction);
    if (!distance) return behind;
    const Vec3 point = origin + *distance * direction;
    const auto opacity = static_cast<float>(stage.floor->opacity(point));
    if (opacity == 0) return behind;
    Rgb light = stage.floor->radiance(point);
    const double ior = stage.floor->floor().ior;
    if (ior > 1) {
      const Vec3 mirrored = reflect(direction, stage.floor->normal());
      const auto reflectance = static_cast<float>(fresnel_reflectance(mirrored.dot(stage.floor->normal()), ior));
      ++stage.mirror_rays;
      const std::optional<SceneGeometry::Hit> hit = stage.geometry.intersect(point, mirrored);
      light = light * (1 - reflectance) + reflectance * (hit ? glimpse(*hit, mirrored) : stage.far(point, mirrored));
    }
    return behind * (1 - opacity) + light * opacity;
  };
  RenderedImage result;
  result.statistics.film = film.expose(
      [&](double x, double y) {
        FilmSample sample;
        const Vec3 direction = stage.rays.direction(x, y);
        const std::optional<SceneGeometry::Hit> hit = stage.geometry.intersect(stage.rays.origin(), direction);
        if (!hit) {
          sample.backdrop = backdrop(stage.rays.origin(), direction);
          return sample;
        }
        sample.hit = true;
        sample.depth = hit->distance * direction.dot(stage.rays.axis());
        sample.normal = stage.shading_normal(*hit, direction);
        shade(*hit, direction, sample, backdrop);
        return sample;
      },
      progress);
  result.image = film.develop();
  result.statistics.mirror_rays = stage.mirror_rays;
  result.statistics.shadow_rays = stage.shadow_rays;
  if (stage.floor) {
    result.statistics.shadow_rays += stage.floor->shadow_rays();
    result.statistics.shadow_rays_skipped += stage.floor->shadow_rays_skipped();
  }
  return result;
}

}  // namespace shellgrid
