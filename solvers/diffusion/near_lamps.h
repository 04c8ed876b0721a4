// SPDX-License-Identifier: AGPL-3.0-or-later
// Lamps so near to the surface that their light changes within a cell: their irradiance is integrated, not sampled.
#pragma once
#include <cmath>
#include <optional>
#include <vector>

#include "meshing/core/triangle_mesh.h"
#include "meshing/polycube/polygrid.h"
#include "meshing/surface/closest_point.h"
#include "solvers/render/lights.h"
#include "solvers/render/scene_geometry.h"

namespace shellgrid {

// Where a light of one direction stands, mm; none of parallel light.
inline std::optional<Vec3> lamp_position(const SimpleLight& light) {
  if (const auto* point = std::get_if<PointLight>(&light)) return point->position;
  if (const auto* patch = std::get_if<PatchLight>(&light)) return patch->position;
  return std::nullopt;
}

// A square part of the unit square, and what is about `place` there.
struct SquarePart {
  double s = 0, t = 0, size = 1;  // its lower corner and edge
};

// A part this wide, mm, that far from a lamp is too coarse for two by two Gauss points. Parts of parts end at a
// millionth of the first.
constexpr double coarse_lamp_part = 0.7, least_lamp_part = 0x1p-20;
inline bool is_coarse(double width, double distance) { return width > coarse_lamp_part * distance; }

// Halves the unit square until no part is coarse for the lamp: distance(s, t) is its distance from a place, mm; the
// square's edge is `width` mm. leaf(part) for each, in a fixed order.
template <class Distance, class Leaf>
void for_lamp_parts(double width, const Distance& distance, const Leaf& leaf) {
  const auto visit = [&](const auto& self, const SquarePart& part) -> void {
    const double half = 0.5 * part.size;
    if (part.size <= least_lamp_part || !is_coarse(part.size * width, distance(part.s + half, part.t + half)))
      return leaf(part);
    for (int k = 0; k < 4; ++k) self(self, SquarePart{part.s + (k & 1) * half, part.t + (k >> 1) * half, half});
  };
  visit(visit, SquarePart{});
}

// The lights with each rectangle divided into ones that are one patch each: not wider than 0.4 times their distance
// from the surface, or 0.7 cells where that is more, and about `environment_samples` / 4 of them at least. Where that
// took more than `most` of one rectangle all of its are wider. `cell`: mm.
std::vector<Light> divide_rectangles(const std::vector<Light>& lights, const ClosestPointQuery& surface, double cell,
                                     int environment_samples, std::size_t most = 2048);

// What passes into the object of some lamps, W mm⁻²: means over hat functions.
struct NearLampLight {
  std::vector<Rgb> at_points;    // of the polygrid; zero but at outer ones
  std::vector<Rgb> at_vertices;  // of the surface
};

// Lights divided into those whose light may be sampled a cell apart, and lamps within four cells of the surface.
struct DividedLights {
  std::vector<Light> far;
  std::vector<SimpleLight> near;
};
DividedLights divide_lights(const std::vector<Light>& lights, const ClosestPointQuery& surface, double cell,
                            int environment_samples);

// q = ∫ L_i F_t(η, ω) (n·ω) dω over hat functions, by quadrature that is finer the nearer a lamp is, with shadows.
// `ior` ≥ 1. Source: PHYSICS D2. Same bytes at any thread count.
NearLampLight near_lamp_light(const Polygrid& polygrid, const TriangleMesh& surface, const ClosestPointQuery& query,
                              const SceneGeometry& geometry, const std::vector<SimpleLight>& lamps, double ior);

}  // namespace shellgrid
