// SPDX-License-Identifier: AGPL-3.0-or-later
#include "solvers/render/camera.h"

#include <Eigen/Geometry>
#include <cmath>
#include <numbers>

#include "meshing/core/error.h"

namespace shellgrid {

CameraRays::CameraRays(const Camera& camera) : origin_(camera.position) {
  if (!camera.position.allFinite() || !camera.look_at.allFinite() || !camera.up.allFinite())
    throw InputError("the camera's position, look_at or up is not finite");
  const Vec3 towards = camera.look_at - camera.position;
  if (!(towards.norm() > 0)) throw InputError("the camera's look_at is its position");
  axis_ = towards.normalized();
  const Vec3 right = axis_.cross(camera.up);
  if (!(right.norm() > 1e-9 * camera.up.norm())) throw InputError("the camera looks along its up vector");
  if (!(camera.fov > 0 && camera.fov < 180)) throw InputError("the camera's fov is not between 0 and 180 degrees");
  if (camera.width < 1 || camera.height < 1 || 1.0 * camera.width * camera.height > 268435456.0)
    throw InputError("the camera's resolution is not between 1×1 and 2^28 pixels");
  const Vec3 x = right.normalized(), y = axis_.cross(x);  // y points down the picture
  const double half_height = std::tan(camera.fov * std::numbers::pi / 360);
  const double pixel = 2 * half_height / camera.height;
  step_x_ = pixel * x;
  step_y_ = pixel * y;
  corner_ = axis_ - 0.5 * camera.width * step_x_ - 0.5 * camera.height * step_y_;
}

}  // namespace shellgrid
