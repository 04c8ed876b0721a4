// SPDX-License-Identifier: AGPL-3.0-or-later
#include "solvers/shell_texture/core_light.h"

#include <Eigen/Geometry>
#include <algorithm>
#include <cmath>
#include <utility>

#include "meshing/core/error.h"
#include "meshing/core/parallel.h"
#include "meshing/surface/closest_point.h"

namespace shellgrid {

namespace {

// Of the thickness: from this distance to the surface on there is a core, and from this one on all of it.
constexpr double ended = 0.7, whole = 0.9;
constexpr int thin_places = 16;  // looked at between two sides
constexpr double least_share =
    0.2;  // of the shell's light, that diffusion must send down for a scale to mean something

}  // namespace

CoreSurface core_surface(const TexturedFrames& frames, const SpreadLight& light, const ShellTextureLookup& texture,
                         const std::vector<Vec2f>& coordinates, double thickness) {
  const TriangleMesh& mesh = frames.mesh;
  const auto n = static_cast<std::size_t>(mesh.vertex_count());
  if (coordinates.size() != n) throw InputError("the surface's texture coordinates do not have its size");
  if (!(thickness >= 0)) throw InputError("a shell's thickness is not negative");
  CoreSurface surface;
  surface.points.resize(n);
  surface.areas.assign(n, 0.0f);
  surface.power.resize(n);
  surface.shell_reflection.resize(n);
  for (std::size_t i = 0; i < n; ++i) {
    const int v = static_cast<int>(i);
    surface.points[i] = (mesh.vertex(v) - thickness * frames.normals.row(v).transpose()).cast<float>();
  }
  // Where the shell is thicker than half the object, or than its radius of curvature, points come out near the surface
  // again: there is no core.
  const ClosestPointQuery query(mesh);
  std::vector<float> there(n, 1.0f);
  if (thickness > 0)
    parallel_for(
        n,
        [&](std::size_t i) {
          const Vec3 point = surface.points[i].cast<double>();
          const double depth = (query.nearest(point, thickness).point - point).norm() / thickness;
          there[i] = static_cast<float>(std::clamp((depth - ended) / (whole - ended), 0.0, 1.0));
        },
        64);
  const auto area = [](const Vec3& a, const Vec3& b, const Vec3& c) -> Vec3 { return (b - a).cross(c - a) / 2; };
  for (int f = 0; f < mesh.face_count(); ++f) {
    const Vec3 above = area(mesh.corner(f, 0), mesh.corner(f, 1), mesh.corner(f, 2));
    const auto point = [&](int k) -> Vec3 { return surface.points[mesh.faces(f, k)].cast<double>(); };
    const double size = above.norm(), below = size > 0 ? area(point(0), point(1), point(2)).dot(above) / size : 0;
    for (int k = 0; k < 3; ++k) surface.areas[mesh.faces(f, k)] += static_cast<float>(std::max(0.0, below) / 3);
  }
  for (std::size_t i = 0; i < n; ++i) surface.areas[i] *= there[i];
  surface.presence = std::move(there);
  parallel_for(
      n,
      [&](std::size_t i) {
        const Vec2f& at = coordinates[i];
        const Vec3f down = texture.below(at.x(), at.y(), texture.prepare(light.at_bottom(static_cast<int>(i))));
        surface.power[i] = down.array().max(0) * surface.areas[i];
        surface.shell_reflection[i] = texture.below_of_back_light(at.x(), at.y()).array().max(0).min(1);
      },
      64);
  return surface;
}

CoreDiffusion core_from_fluence(const TexturedFrames& frames, const CoreSurface& surface, double thickness,
                                const FluenceField& fluence, const Rgb& diffusion_coefficient) {
  const std::size_t n = surface.points.size();
  if (static_cast<std::size_t>(frames.mesh.vertex_count()) != n || surface.power.size() != n ||
      surface.areas.size() != n || surface.shell_reflection.size() != n)
    throw InputError("the core's surface does not have the mesh's size");
  const ClosestPointQuery query(frames.mesh);
  CoreDiffusion core;
  core.exitance.resize(n);
  core.irradiance.resize(n);
  parallel_for(
      n,
      [&](std::size_t i) {
        const int v = static_cast<int>(i);
        const Vec3 normal = frames.normals.row(v).transpose(), above = frames.mesh.vertex(v);
        Vec3 point = surface.points[i].cast<double>();
        if (!surface.presence.empty() && surface.presence[i] < 1) {
          // The place on the way down that is farthest from the surface.
          double deepest = 0;
          for (int k = 1; k <= thin_places; ++k) {
            const Vec3 place = above - thickness * k / thin_places * normal;
            const double depth = std::sqrt(query.nearest(place, thickness).squared_distance);
            if (std::isfinite(depth) && depth > deepest) {
              deepest = depth;
              point = place;
            }
          }
        }
        const FluenceField::Value value = fluence.at(point);
        for (int c = 0; c < 3; ++c) {
          const auto phi = static_cast<double>(value.fluence[c]);
          const double current = static_cast<double>(diffusion_coefficient[c]) / 2 * value.gradient.row(c).dot(normal);
          core.exitance[i][c] = static_cast<float>(std::max(0.0, phi / 4 - current));
          core.irradiance[i][c] = static_cast<float>(std::max(0.0, phi / 4 + current));
        }
      },
      64);
  for (int c = 0; c < 3; ++c) {
    double down = 0, diffuse = 0;
    for (std::size_t i = 0; i < n; ++i) {
      const auto area = static_cast<double>(surface.areas[i]);
      down += static_cast<double>(surface.power[i][c]);
      diffuse +=
          area * static_cast<double>(core.irradiance[i][c] - surface.shell_reflection[i][c] * core.exitance[i][c]);
    }
    if (down > 0 && diffuse > least_share * down) core.scale[c] = down / diffuse;
    for (std::size_t i = 0; i < n; ++i) {
      core.exitance[i][c] *= static_cast<float>(core.scale[c]);
      core.irradiance[i][c] *= static_cast<float>(core.scale[c]);
    }
  }
  return core;
}

void spread_over_edges(const CoreSurface& surface, double reach, std::vector<Rgb>& exitance) {
  std::vector<int> present;
  for (std::size_t i = 0; i < surface.presence.size(); ++i)
    if (surface.presence[i] >= 1) present.push_back(static_cast<int>(i));
  if (present.empty() || present.size() == surface.presence.size()) return;
  VertexMatrix points(static_cast<Eigen::Index>(present.size()), 3);
  for (std::size_t k = 0; k < present.size(); ++k)
    points.row(static_cast<Eigen::Index>(k)) = surface.points[present[k]].cast<double>().transpose();
  const NearestVertexQuery query(points);
  const std::vector<Rgb> before = exitance;
  parallel_for(
      surface.presence.size(),
      [&](std::size_t i) {
        if (surface.presence[i] >= 1) return;
        const Vec3 point = surface.points[i].cast<double>();
        const int nearest = present[query.nearest(point)];
        const double distance = (surface.points[nearest].cast<double>() - point).norm();
        if (distance > reach) return;
        exitance[i] = surface.presence[i] * before[i] + (1 - surface.presence[i]) * before[nearest];
      },
      64);
}

}  // namespace shellgrid
