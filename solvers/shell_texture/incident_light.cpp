// SPDX-License-Identifier: AGPL-3.0-or-later
#include "solvers/shell_texture/incident_light.h"

#include <Eigen/Geometry>
#include <algorithm>

#include "meshing/core/error.h"

namespace shellgrid {

Mat3 TexturedFrames::frame(int vertex) const {
  const Vec3 normal = normals.row(vertex).transpose(), u = directions.row(vertex).transpose();
  Mat3 rows;
  rows.row(0) = u.transpose();
  rows.row(1) = normal.cross(u).transpose();
  rows.row(2) = normal.transpose();
  return rows;
}

IncidentLight::IncidentLight(const TexturedFrames& frames, const SceneGeometry& geometry,
                             const std::vector<Light>& lights, const LightDirections& directions, int samples)
    : frames_(frames), geometry_(geometry), lights_(simple_lights(lights, samples)), directions_(directions) {
  if (frames.normals.rows() != frames.mesh.vertex_count() || frames.directions.rows() != frames.mesh.vertex_count())
    throw InputError("the surface's frames do not have its size");
}

template <class Visit>
void IncidentLight::visit_beams(int vertex, const Visit& visit) const {
  const Vec3 normal = frames_.normals.row(vertex).transpose();
  const Vec3 origin = frames_.mesh.vertex(vertex) + geometry_.offset() * normal;
  std::int64_t traced = 0, skipped = 0;
  for (const SimpleLight& light : lights_) {
    const IncidentBeam beam = incident_beam(light, origin);
    if (!(beam.direction.dot(normal) > 0) || !(beam.irradiance > 0).any()) {
      ++skipped;
      continue;
    }
    ++traced;
    if (!geometry_.occluded(origin, beam.direction, beam.distance)) visit(beam);
  }
  statistics_.shadow_rays += traced;
  statistics_.shadow_rays_skipped += skipped;
}

std::vector<DirectionWeight> IncidentLight::at(int vertex) const {
  const Mat3 frame = frames_.frame(vertex);
  std::vector<DirectionWeight> all;
  visit_beams(vertex, [&](const IncidentBeam& beam) {
    for (DirectionWeight& one : blend_directions(directions_, (frame * beam.direction).normalized())) {
      one.weight = one.weight.cwiseProduct(beam.irradiance.matrix());
      all.push_back(one);
    }
  });
  std::stable_sort(all.begin(), all.end(),
                   [](const DirectionWeight& a, const DirectionWeight& b) { return a.direction < b.direction; });
  std::size_t count = 0;
  for (const DirectionWeight& one : all) {
    if (count > 0 && all[count - 1].direction == one.direction)
      all[count - 1].weight += one.weight;
    else
      all[count++] = one;
  }
  all.resize(count);
  return all;
}

}  // namespace shellgrid
