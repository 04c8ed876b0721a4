// SPDX-License-Identifier: AGPL-3.0-or-later
#pragma once
#include "meshing/core/triangle_mesh.h"
#include "meshing/shell/shell_volume.h"

namespace shellgrid {

// By how much the depths that voxels of the shell note differ from their distances to the surface, mm: what all but a
// tenth of about 2000 of them do not exceed. That of its own surface is rounding. Throws: InputError for a surface
// without faces.
double shell_misfit(const ShellVolume& shell, const TriangleMesh& surface);

}  // namespace shellgrid
