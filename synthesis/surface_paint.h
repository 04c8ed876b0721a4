// SPDX-License-Identifier: AGPL-3.0-or-later
#pragma once
#include <string>

#include "meshing/core/triangle_mesh.h"
#include "synthesis/surface_synthesis.h"

namespace shellgrid {

// How a painted mesh lies on a surface.
struct PaintFit {
  bool moved = false;           // scaled and moved onto it
  double median = 0, most = 0;  // distance of the surface's vertices from it, mm
};

// What a painted mesh says of each vertex of a surface, at the nearest point: `direction_x direction_y direction_z`
// (interpolated; zero: free), `scale` (interpolated), and, with several samples, of the nearest corner `sample`, or
// else `quality` (both rounded), or else `red`, whose range 0 … 255 is parted evenly. The painted mesh is taken where
// it lies or scaled and moved so that both boxes agree, as sg-prepare does: whichever is nearer to the surface. name:
// the file's, for messages. Throws: InputError as require_paint, and where half of the surface is farther from the
// painted mesh than 3 % of its size.
SurfacePaint transfer_paint(const AttributedMesh& painted, const TriangleMesh& surface, int sample_count,
                            const std::string& name, PaintFit* fit = nullptr);

// Throws: InputError where nothing is painted, or a value is not finite or out of range; also a painted scale times
// `scale`.
void require_paint(const AttributedMesh& painted, int sample_count, const std::string& name, double scale = 1);

}  // namespace shellgrid
