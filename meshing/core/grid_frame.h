// SPDX-License-Identifier: AGPL-3.0-or-later
#pragma once
#include "meshing/core/vec.h"

namespace shellgrid {

// Where a regular grid lies in space. Sampling is at grid points: sample (i, j, k) stands at
// origin + voxel·(i, j, k). Axis order is (x, y, z) = (i, j, k). Signed distances on such a grid are
// negative inside the object.
struct GridFrame {
  Vec3 origin = Vec3::Zero();  // mm
  double voxel = 1;            // grid interval d_0, mm

  Vec3 to_world(const Vec3i& index) const { return origin + voxel * index.cast<double>(); }
  // Continuous index of a point.
  Vec3 to_index(const Vec3& point) const { return (point - origin) / voxel; }
};

}  // namespace shellgrid
