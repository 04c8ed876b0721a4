// SPDX-License-Identifier: AGPL-3.0-or-later
#pragma once
#include "meshing/core/vec.h"

namespace shellgrid {

// A pinhole camera. `fov` is the vertical field of view.
struct Camera {
  Vec3 position = Vec3(0, 0, 200);  // mm
  Vec3 look_at = Vec3::Zero();      // mm
  Vec3 up = Vec3(0, 1, 0);
  double fov = 30;                // degrees
  int width = 720, height = 486;  // pixels
};

}  // namespace shellgrid
