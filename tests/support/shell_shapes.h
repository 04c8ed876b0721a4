// SPDX-License-Identifier: AGPL-3.0-or-later
// Shells of voxels for tests, without the stages that make real ones.
#pragma once
#include <cmath>
#include <functional>

#include "meshing/shell/shell_volume.h"

namespace shellgrid::test {

struct ShellVoxel {
  Material material;
  int kind = 1;  // 0 free space, 1 interior, 2 surface
};

// The shell of a solid with a signed distance (negative inside, mm), which lies in a box about the origin.
inline ShellVolume shell_of(const std::function<double(const Vec3&)>& distance, double half_box, double voxel,
                            double thickness, const Material& core,
                            const std::function<ShellVoxel(const Vec3& point, double depth)>& voxel_at) {
  ShellVolume shell;
  shell.frame.voxel = voxel;
  const int n = static_cast<int>(std::ceil(half_box / voxel)) + 2, leaves = (2 * n + 8) / 8;
  shell.frame.origin = Vec3::Constant(-n * voxel) + 0.3 * voxel * Vec3(1, 0.5, 0.2);
  shell.thickness = thickness;
  shell.core = core;
  const TwoLevelGrid<Vec3f> empty(Vec3i::Zero(), Vec3i::Constant(leaves), Vec3f::Zero());
  shell.texture_coordinate = shell.extinction = shell.albedo = shell.anisotropy = shell.normal = empty;
  shell.kind = TwoLevelGrid<std::int32_t>(Vec3i::Zero(), Vec3i::Constant(leaves), 1);
  for (int i = 0; i < 8 * leaves; ++i)
    for (int j = 0; j < 8 * leaves; ++j)
      for (int k = 0; k < 8 * leaves; ++k) {
        const Vec3 point = shell.frame.to_world(Vec3i(i, j, k));
        const double d = distance(point);
        if (d > 0 || d < -thickness) continue;
        const ShellVoxel value = voxel_at(point, -d);
        const bool space = value.kind == 0;
        shell.texture_coordinate.set(i, j, k, Vec3f(0, 0, static_cast<float>(-d / voxel)));
        shell.extinction.set(i, j, k, space ? Vec3f(Vec3f::Zero()) : Vec3f(value.material.extinction.matrix()));
        shell.albedo.set(i, j, k, space ? Vec3f(Vec3f::Zero()) : Vec3f(value.material.albedo.matrix()));
        shell.anisotropy.set(i, j, k, space ? Vec3f(Vec3f::Zero()) : Vec3f(value.material.anisotropy.matrix()));
        shell.normal.set(i, j, k, Vec3f::Zero());
        shell.kind.set(i, j, k, value.kind);
      }
  return shell;
}

}  // namespace shellgrid::test
