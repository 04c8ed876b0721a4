// SPDX-License-Identifier: AGPL-3.0-or-later
// The light that passes into the object at its surface.
#pragma once
#include <cstdint>
#include <vector>

#include "meshing/core/triangle_mesh.h"
#include "solvers/render/lights.h"
#include "solvers/render/scene_geometry.h"

namespace shellgrid {

// q = ∫ L_i F_t(η, ω) (n·ω) dω at each vertex, with shadows. Source: PHYSICS D2.
struct SurfaceIrradiance {
  std::vector<Rgb> values;       // one a vertex, W mm⁻²
  std::int64_t directions = 0;   // pairs of vertex and light
  std::int64_t facing_away = 0;  // of them skipped because the light stands behind the surface
  std::int64_t occluded = 0;     // of them in shadow
};

// Environments become about `environment_samples` parallel lights. Shadow rays start a twentieth of the mean edge
// above the surface, so that faces around a vertex do not shade it. `ior` ≥ 1, inside over outside.
SurfaceIrradiance surface_irradiance(const TriangleMesh& mesh, const SceneGeometry& geometry,
                                     const std::vector<Light>& lights, double ior, int environment_samples);

// How far above the surface shadow rays start, mm.
double shadow_lift(const TriangleMesh& mesh, const SceneGeometry& geometry);

}  // namespace shellgrid
