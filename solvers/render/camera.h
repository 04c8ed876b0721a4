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

// Rays through the picture plane of a camera.
class CameraRays {
 public:
  // Throws: InputError if the camera looks nowhere or along its up vector, its field of view is not
  // in (0, 180) degrees, or its picture has no pixels or more than 2²⁸.
  explicit CameraRays(const Camera& camera);

  const Vec3& origin() const { return origin_; }
  // The viewing axis, unit; depth is measured along it.
  const Vec3& axis() const { return axis_; }
  // Unit direction through picture coordinates: pixel (column, row) covers [column, column + 1)×[row, row + 1), row 0
  // on top.
  Vec3 direction(double x, double y) const { return (corner_ + x * step_x_ + y * step_y_).normalized(); }

 private:
  Vec3 origin_, axis_;
  Vec3 corner_, step_x_, step_y_;  // the picture plane at distance one
};

}  // namespace shellgrid
