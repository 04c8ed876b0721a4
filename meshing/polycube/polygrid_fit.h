// SPDX-License-Identifier: AGPL-3.0-or-later
#pragma once
#include "meshing/core/triangle_mesh.h"
#include "meshing/polycube/polygrid.h"

namespace shellgrid {

// How far the polygrid's outer points lie off the surface, mm: what half of about 2000 of them do not exceed. Those of
// its own surface lie on it but where no valid grid could follow. Throws: InputError for a surface without faces.
double polygrid_misfit(const Polygrid& polygrid, const TriangleMesh& surface);

}  // namespace shellgrid
