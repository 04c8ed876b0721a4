// SPDX-License-Identifier: AGPL-3.0-or-later
#pragma once
#include <string>

#include "meshing/core/triangle_mesh.h"
#include "synthesis/surface_synthesis.h"

namespace shellgrid {

// What a painted mesh says of each vertex of a surface, at the nearest point: `direction_x direction_y direction_z`
// (interpolated; zero: free), `scale` (interpolated), and, with several samples, of the nearest corner `sample`, or
// else `quality` (both rounded), or else `red`, whose range 0 … 255 is parted evenly. Where the boxes of both meshes
// share less than half of their volume, the painted one is scaled and moved so that they agree, as sg-prepare does.
// name: the file's, for messages. Throws: InputError where nothing is painted, or a value is not finite or out of
// range.
SurfacePaint transfer_paint(const AttributedMesh& painted, const TriangleMesh& surface, int sample_count,
                            const std::string& name);

}  // namespace shellgrid
