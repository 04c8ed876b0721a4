// SPDX-License-Identifier: AGPL-3.0-or-later
#pragma once
#include <vector>

#include "meshing/core/triangle_mesh.h"

namespace shellgrid {

// What `exitance.ply` holds: exitance_r/g/b, irradiance_r/g/b, quality (luminance of the exitance) and colours that
// show it, its 98th percentile white. Values one a vertex, W mm⁻².
AttributedMesh exitance_mesh(const TriangleMesh& surface, const std::vector<Rgb>& exitance,
                             const std::vector<Rgb>& irradiance);

// Adds NAME_r, NAME_g, NAME_b.
void add_colour_property(AttributedMesh& mesh, const std::string& name, const std::vector<Rgb>& values);

}  // namespace shellgrid
