// SPDX-License-Identifier: AGPL-3.0-or-later
// The core below a textured surface, as the light that comes through its shell sees it.
#pragma once
#include <vector>

#include "solvers/dipole/core_exchange.h"
#include "solvers/shell_texture/incident_light.h"

namespace shellgrid {

// The core's surface, `thickness` mm below the mesh, point by point below its vertices. What passes down through the
// sample's bottom where it stands there falls on it, per area of the core: so within a white object in even light there
// is even light, whatever its curvature. Source: [STF §7 step 1].
// coordinates: texture coordinates of the vertices, texels. Throws: InputError where they do not fit the mesh.
CoreSurface core_surface(const IncidentLight& light, const ShellTextureLookup& texture,
                         const std::vector<Vec2f>& coordinates, double thickness);

// Points beyond the core's edges, as below a convex edge of the surface, see the core beside them: they take the
// exitance of the nearest point that lies on it, if one is within `reach` mm.
void spread_over_edges(const CoreSurface& surface, double reach, std::vector<Rgb>& exitance);

}  // namespace shellgrid
