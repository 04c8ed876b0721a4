// SPDX-License-Identifier: AGPL-3.0-or-later
#include "solvers/diffusion/near_lamps.h"

#include <Eigen/Geometry>
#include <algorithm>
#include <array>

#include "meshing/core/parallel.h"
#include "meshing/surface/half_edges.h"
#include "solvers/diffusion/boundary_irradiance.h"
#include "solvers/diffusion/boundary_quad.h"
#include "solvers/render/surface_render.h"
#include "solvers/scattering/fresnel.h"

namespace shellgrid {
namespace {

constexpr double near_cells = 4;
constexpr double gauss[2] = {0.5 - 0.28867513459481288225, 0.5 + 0.28867513459481288225};

// What of a lamp's light passes in at a place of the surface, W mm⁻².
class Entrance {
 public:
  Entrance(const TriangleMesh& surface, const SceneGeometry& geometry, double ior)
      : surface_(surface),
        geometry_(geometry),
        ior_(ior),
        normals_(vertex_normals(surface)),
        lift_(shadow_lift(surface, geometry)) {}

  Eigen::Array3d at(const SimpleLight& lamp, int face, const Vec3& barycentric, const Vec3& point) const {
    Vec3 normal = Vec3::Zero();
    for (int k = 0; k < 3; ++k) normal += barycentric[k] * normals_.row(surface_.faces(face, k)).transpose();
    const double length = normal.norm();
    if (!(length > 0)) return Eigen::Array3d::Zero();
    normal /= length;
    const IncidentBeam beam = incident_beam(lamp, point);
    const double cosine = normal.dot(beam.direction);
    if (!(cosine > 0) || !(beam.distance > 0)) return Eigen::Array3d::Zero();
    const Vec3 origin = point + lift_ * normal;
    if (geometry_.occluded(origin, beam.direction, beam.distance)) return Eigen::Array3d::Zero();
    return beam.irradiance.cast<double>() * (cosine * fresnel_transmittance(cosine, ior_));
  }

 private:
  const TriangleMesh& surface_;
  const SceneGeometry& geometry_;
  const double ior_;
  const VertexMatrix normals_;
  const double lift_;
};

// Power over area; of places without area nothing.
std::vector<Rgb> means(const std::vector<Eigen::Array3d>& power, const std::vector<double>& area) {
  std::vector<Rgb> result(power.size(), Rgb::Zero());
  for (std::size_t i = 0; i < power.size(); ++i)
    if (area[i] > 0) result[i] = (power[i] / area[i]).cast<float>();
  return result;
}

std::vector<Rgb> light_at_points(const Polygrid& polygrid, const ClosestPointQuery& query, const Entrance& entrance,
                                 const std::vector<SimpleLight>& lamps) {
  struct Shares {
    std::array<Eigen::Array3d, 4> power;
    std::array<double, 4> area{};
  };
  const auto quads = static_cast<std::size_t>(polygrid.boundary_quads.rows());
  std::vector<Shares> shares(quads);
  parallel_for(
      quads,
      [&](std::size_t q) {
        Shares& own = shares[q];
        own.power.fill(Eigen::Array3d::Zero());
        const auto quad = static_cast<std::int32_t>(q);
        const auto on_surface = [&](double s, double t) {
          return query.nearest(quad_point(polygrid, quad, s, t).position);
        };
        const auto enter = [&](const SimpleLight& lamp, const SurfacePoint& place, double s, double t, double share) {
          const Eigen::Array3d power = entrance.at(lamp, place.face_index, place.barycentric, place.point) *
                                       (share * quad_point(polygrid, quad, s, t).area);
          const std::array<double, 4> hat = quad_hats(s, t);
          for (std::size_t a = 0; a < 4; ++a) own.power[a] += hat[a] * power;
        };
        // Most quads are far from most lamps: their places are the same for all.
        const Vec3 middle = on_surface(0.5, 0.5).point;
        SurfacePoint places[4];
        for (int k = 0; k < 4; ++k) {
          const double s = gauss[k & 1], t = gauss[k >> 1];
          places[k] = on_surface(s, t);
          const double area = 0.25 * quad_point(polygrid, quad, s, t).area;
          for (std::size_t a = 0; a < 4; ++a) own.area[a] += area * quad_hats(s, t)[a];
        }
        const double width = quad_width(polygrid, quad);
        for (const SimpleLight& lamp : lamps) {
          const Vec3 position = *lamp_position(lamp);
          if (!is_coarse(width, (middle - position).norm())) {
            for (int k = 0; k < 4; ++k) enter(lamp, places[k], gauss[k & 1], gauss[k >> 1], 0.25);
            continue;
          }
          for_lamp_parts(
              width, [&](double s, double t) { return (on_surface(s, t).point - position).norm(); },
              [&](const SquarePart& part) {
                for (const double gs : gauss)
                  for (const double gt : gauss) {
                    const double s = part.s + gs * part.size, t = part.t + gt * part.size;
                    enter(lamp, on_surface(s, t), s, t, 0.25 * part.size * part.size);
                  }
              });
        }
      },
      64);
  std::vector<Eigen::Array3d> power(static_cast<std::size_t>(polygrid.points.rows()), Eigen::Array3d::Zero());
  std::vector<double> area(power.size(), 0.0);
  for (std::size_t q = 0; q < quads; ++q)
    for (int a = 0; a < 4; ++a) {
      const auto point = static_cast<std::size_t>(polygrid.boundary_quads(static_cast<Eigen::Index>(q), a));
      power[point] += shares[q].power[static_cast<std::size_t>(a)];
      area[point] += shares[q].area[static_cast<std::size_t>(a)];
    }
  return means(power, area);
}

// A triangle as the square's half with s + t ≤ 1 would leave parts cut; folded: (s, t) ↦ corner weights
// (1 − s, s (1 − t), s t), whose area element is 2 s of the triangle's.
std::vector<Rgb> light_at_vertices(const TriangleMesh& surface, const Entrance& entrance,
                                   const std::vector<SimpleLight>& lamps) {
  struct Shares {
    std::array<Eigen::Array3d, 3> power;
    double area = 0;
  };
  const auto faces = static_cast<std::size_t>(surface.face_count());
  std::vector<Shares> shares(faces);
  parallel_for(
      faces,
      [&](std::size_t f) {
        Shares& own = shares[f];
        own.power.fill(Eigen::Array3d::Zero());
        const int face = static_cast<int>(f);
        const Vec3 a = surface.corner(face, 0), b = surface.corner(face, 1), c = surface.corner(face, 2);
        own.area = 0.5 * (b - a).cross(c - a).norm();
        const double width = std::max({(b - a).norm(), (c - b).norm(), (a - c).norm()});
        const auto weights = [](double s, double t) { return Vec3(1 - s, s * (1 - t), s * t); };
        for (const SimpleLight& lamp : lamps) {
          const Vec3 position = *lamp_position(lamp);
          for_lamp_parts(
              width,
              [&](double s, double t) {
                const Vec3 w = weights(s, t);
                return (w[0] * a + w[1] * b + w[2] * c - position).norm();
              },
              [&](const SquarePart& part) {
                for (const double gs : gauss)
                  for (const double gt : gauss) {
                    const double s = part.s + gs * part.size, t = part.t + gt * part.size;
                    const Vec3 w = weights(s, t);
                    const Eigen::Array3d power = entrance.at(lamp, face, w, w[0] * a + w[1] * b + w[2] * c) *
                                                 (0.25 * part.size * part.size * 2 * s * own.area);
                    for (int k = 0; k < 3; ++k) own.power[static_cast<std::size_t>(k)] += w[k] * power;
                  }
              });
        }
      },
      64);
  std::vector<Eigen::Array3d> power(static_cast<std::size_t>(surface.vertex_count()), Eigen::Array3d::Zero());
  std::vector<double> area(power.size(), 0.0);
  for (std::size_t f = 0; f < faces; ++f)
    for (int k = 0; k < 3; ++k) {
      const auto vertex = static_cast<std::size_t>(surface.faces(static_cast<Eigen::Index>(f), k));
      power[vertex] += shares[f].power[static_cast<std::size_t>(k)];
      area[vertex] += shares[f].area / 3;
    }
  return means(power, area);
}

}  // namespace

std::vector<Light> divide_rectangles(const std::vector<Light>& lights, const ClosestPointQuery& surface, double cell,
                                     int environment_samples, std::size_t most) {
  std::vector<Light> result;
  for (const Light& light : lights) {
    const auto* rectangle = std::get_if<AreaLight>(&light);
    if (rectangle == nullptr) {
      result.push_back(light);
      continue;
    }
    const AreaFrame frame(*rectangle);
    const double widest = std::sqrt(rectangle->width * rectangle->height / std::max(1, environment_samples / 4));
    std::vector<AreaLight> parts;
    for (double share = 0.4;; share *= 1.5) {
      parts.assign(1, *rectangle);
      for (std::size_t k = 0; k < parts.size() && parts.size() <= most;) {
        AreaLight& part = parts[k];
        const double distance = std::sqrt(surface.nearest(part.position).squared_distance);
        const double edge = std::max(part.width, part.height);
        if (edge <= 1.01 * std::min(widest, share * std::max(distance, 1.75 * cell))) {
          ++k;
          continue;
        }
        // Into two along the longer side.
        double& side = part.width >= part.height ? part.width : part.height;
        const Vec3 shift = 0.25 * side * (part.width >= part.height ? frame.right : frame.up);
        side *= 0.5;
        AreaLight other = part;
        part.position -= shift;
        other.position += shift;
        parts.push_back(other);
      }
      if (parts.size() <= most || share > 1e6) break;
    }
    for (AreaLight& part : parts) {
      part.patches = 1;
      result.emplace_back(part);
    }
  }
  return result;
}

DividedLights divide_lights(const std::vector<Light>& lights, const ClosestPointQuery& surface, double cell,
                            int environment_samples) {
  DividedLights divided;
  for (const Light& light : lights) {
    std::vector<SimpleLight> lamps;
    if (light_position(light)) lamps = simple_lights({light}, environment_samples);
    const bool near = std::any_of(lamps.begin(), lamps.end(), [&](const SimpleLight& lamp) {
      const std::optional<Vec3> position = lamp_position(lamp);
      return position && surface.nearest(*position, near_cells * cell).face_index >= 0;
    });
    if (near)
      divided.near.insert(divided.near.end(), lamps.begin(), lamps.end());
    else
      divided.far.push_back(light);
  }
  return divided;
}

NearLampLight near_lamp_light(const Polygrid& polygrid, const TriangleMesh& surface, const ClosestPointQuery& query,
                              const SceneGeometry& geometry, const std::vector<SimpleLight>& lamps, double ior) {
  const Entrance entrance(surface, geometry, ior);
  return {light_at_points(polygrid, query, entrance, lamps), light_at_vertices(surface, entrance, lamps)};
}

}  // namespace shellgrid
