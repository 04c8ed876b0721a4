// SPDX-License-Identifier: AGPL-3.0-or-later
#include "solvers/diffusion/boundary_irradiance.h"

#include <algorithm>
#include <cmath>

#include "meshing/core/parallel.h"
#include "meshing/surface/half_edges.h"
#include "solvers/render/surface_render.h"
#include "solvers/scattering/fresnel.h"

namespace shellgrid {

double shadow_lift(const TriangleMesh& mesh, const SceneGeometry& geometry) {
  double edges = 0;
  for (int f = 0; f < mesh.face_count(); ++f) edges += (mesh.corner(f, 1) - mesh.corner(f, 0)).norm();
  return std::max(0.05 * edges / std::max(1, mesh.face_count()), geometry.offset());
}

SurfaceIrradiance surface_irradiance(const TriangleMesh& mesh, const SceneGeometry& geometry,
                                     const std::vector<Light>& lights, double ior, int environment_samples) {
  const std::vector<SimpleLight> simple = simple_lights(lights, environment_samples);
  const VertexMatrix normals = vertex_normals(mesh);
  const double lift = shadow_lift(mesh, geometry);

  SurfaceIrradiance result;
  const auto count = static_cast<std::size_t>(mesh.vertex_count());
  result.values.assign(count, Rgb::Zero());
  struct Counts {
    std::int64_t facing_away = 0, occluded = 0;
    Counts operator+(const Counts& o) const { return {facing_away + o.facing_away, occluded + o.occluded}; }
  };
  const Counts counts = parallel_sum(
      count, Counts{},
      [&](std::size_t v) {
        Counts own;
        const Vec3 point = mesh.vertex(static_cast<int>(v)), normal = normals.row(v).transpose();
        const Vec3 origin = point + lift * normal;
        Eigen::Array3d sum = Eigen::Array3d::Zero();
        for (const SimpleLight& light : simple) {
          const IncidentBeam beam = incident_beam(light, point);
          const double cosine = normal.dot(beam.direction);
          if (!(cosine > 0)) {
            ++own.facing_away;
            continue;
          }
          if (geometry.occluded(origin, beam.direction, beam.distance)) {
            ++own.occluded;
            continue;
          }
          sum += beam.irradiance.cast<double>() * (cosine * fresnel_transmittance(cosine, ior));
        }
        result.values[v] = sum.cast<float>();
        return own;
      },
      256);
  result.directions = static_cast<std::int64_t>(count * simple.size());
  result.facing_away = counts.facing_away;
  result.occluded = counts.occluded;
  return result;
}

}  // namespace shellgrid
