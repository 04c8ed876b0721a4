// SPDX-License-Identifier: AGPL-3.0-or-later
#pragma once
#include <cstdint>
#include <vector>

#include "meshing/core/triangle_mesh.h"

namespace shellgrid {

struct MeshPreview {
  int width = 0, height = 0;
  std::vector<std::uint8_t> rgb;  // width·height·3, sRGB, row 0 on top
  double least_quality = 0, most_quality = 0;
  bool coloured_by_quality = false;
};

// A small shaded picture of a mesh, or of points where it has no faces: orthographic, from the front, right and above
// (y up), light from the camera's left shoulder. Colours are the properties red, green, blue (0…255), else quality from
// blue through green to yellow, else white. Vertices that are not finite are left out.
MeshPreview draw_mesh(const AttributedMesh& mesh, int width, int height);

}  // namespace shellgrid
