// SPDX-License-Identifier: AGPL-3.0-or-later
#pragma once
#include <cstdint>
#include <vector>

#include "meshing/shell/shell_volume.h"
#include "synthesis/material_sample.h"

namespace shellgrid {

struct SamplePicture {
  int width = 0, height = 0;
  std::vector<std::uint8_t> rgb;  // sRGB, row 0 on top
};

// A sample to look at. Above, twice by twice so that a seam would show: left from above, shaded where there is relief;
// right its middle layer. Below, one period twice as large: cuts through the middle along x (left) and y (right), the
// top up. Free space is blue; colours are diffuse reflectances.
SamplePicture draw_sample(const MaterialSample& sample);

// Cuts through the middle of a shell, perpendicular to z and to x, y up. Voxels outside and a core that is none of the
// file's are white. Throws: InputError without voxels.
SamplePicture draw_shell(const ShellVolume& shell);

}  // namespace shellgrid
