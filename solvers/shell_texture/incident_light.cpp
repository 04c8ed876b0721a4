// SPDX-License-Identifier: AGPL-3.0-or-later
#include "solvers/shell_texture/incident_light.h"

#include <Eigen/Geometry>
#include <algorithm>
#include <array>
#include <utility>

#include "meshing/core/error.h"
#include "meshing/surface/box_tree.h"

namespace shellgrid {

Mat3 TexturedFrames::frame(int vertex) const {
  const Vec3 normal = normals.row(vertex).transpose(), u = directions.row(vertex).transpose();
  Mat3 rows;
  rows.row(0) = u.transpose();
  rows.row(1) = normal.cross(u).transpose();
  rows.row(2) = normal.transpose();
  return rows;
}

namespace {

// Ordered so that each so many of them that follow each other come from about the same direction: halves along the
// axis in which they differ most, again and again.
void put_together(std::vector<SimpleLight>& lights) {
  struct One {
    Vec3 from;
    std::size_t index;
  };
  std::vector<One> all;
  for (std::size_t i = 0; i < lights.size(); ++i) {
    const IncidentBeam beam = incident_beam(lights[i], Vec3::Zero());
    all.push_back({beam.direction, i});
  }
  const auto split = [&](const auto& self, std::size_t begin, std::size_t end) -> void {
    constexpr std::size_t together = SceneGeometry::most_rays;
    if (end - begin <= together) return;
    Box box;
    for (std::size_t i = begin; i < end; ++i) box.add(all[i].from);
    int axis = 0;
    (box.upper - box.lower).maxCoeff(&axis);
    std::stable_sort(all.begin() + static_cast<std::ptrdiff_t>(begin), all.begin() + static_cast<std::ptrdiff_t>(end),
                     [&](const One& a, const One& b) { return a.from[axis] < b.from[axis]; });
    const std::size_t middle = begin + ((end - begin) / 2 + together - 1) / together * together;
    self(self, begin, middle);
    self(self, middle, end);
  };
  split(split, 0, all.size());
  std::vector<SimpleLight> ordered;
  for (const One& one : all) ordered.push_back(lights[one.index]);
  lights = std::move(ordered);
}

}  // namespace

IncidentLight::IncidentLight(const TexturedFrames& frames, const SceneGeometry& geometry,
                             const std::vector<Light>& lights, const LightDirections& directions, int samples)
    : frames_(frames), geometry_(geometry), lights_(simple_lights(lights, samples)), directions_(directions) {
  put_together(lights_);
  if (frames.normals.rows() != frames.mesh.vertex_count() || frames.directions.rows() != frames.mesh.vertex_count())
    throw InputError("the surface's frames do not have its size");
}

std::vector<DirectionWeight> IncidentLight::at(int vertex) const {
  const Mat3 frame = frames_.frame(vertex);
  const Vec3 normal = frames_.normals.row(vertex).transpose();
  const Vec3 origin = frames_.mesh.vertex(vertex) + geometry_.offset() * normal;
  const int count = directions_.count();
  std::vector<Vec3f> sums(static_cast<std::size_t>(count), Vec3f::Zero());
  std::int64_t traced = 0, skipped = 0;
  std::array<IncidentBeam, SceneGeometry::most_rays> beams;
  std::array<Vec3, SceneGeometry::most_rays> ways;
  std::array<double, SceneGeometry::most_rays> distances;
  int waiting = 0;
  const auto shine = [&] {
    const std::uint32_t hidden = geometry_.occluded(origin, ways.data(), distances.data(), waiting);
    for (int k = 0; k < waiting; ++k) {
      if (hidden >> k & 1) continue;
      const DirectionBlend blend = direction_blend(directions_, (frame * ways[k]).normalized());
      for (int d = 0; d < blend.count; ++d)
        sums[blend.directions[d]] += blend.weights[d] * beams[k].irradiance.matrix();
    }
    traced += waiting;
    waiting = 0;
  };
  for (const SimpleLight& light : lights_) {
    const IncidentBeam beam = incident_beam(light, origin);
    if (!(beam.direction.dot(normal) > 0) || !(beam.irradiance > 0).any()) {
      ++skipped;
      continue;
    }
    beams[waiting] = beam;
    ways[waiting] = beam.direction;
    distances[waiting] = beam.distance;
    if (++waiting == SceneGeometry::most_rays) shine();
  }
  if (waiting > 0) shine();
  statistics_.shadow_rays += traced;
  statistics_.shadow_rays_skipped += skipped;
  const auto lit = [](const Vec3f& sum) { return (sum.array() > 0).any(); };
  std::vector<DirectionWeight> list;
  list.reserve(static_cast<std::size_t>(std::count_if(sums.begin(), sums.end(), lit)));
  for (int d = 0; d < count; ++d)
    if (lit(sums[d])) list.push_back({d, sums[d]});
  return list;
}

}  // namespace shellgrid
