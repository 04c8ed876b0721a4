// SPDX-License-Identifier: AGPL-3.0-or-later
#include "synthesis/core_voxels.h"

#include <array>

namespace shellgrid {

std::vector<Vec3i> find_core_voxels(const DistanceField& distance, const ShellVolume& shell) {
  const TwoLevelGrid<float>& field = distance.distance;
  const Vec3i lower = field.lower_leaf(), counts = field.leaf_counts();
  const auto index = [&](const Vec3i& leaf) {
    const Vec3i at = leaf - lower;
    return (static_cast<std::size_t>(at.x()) * counts.y() + at.y()) * counts.z() + at.z();
  };
  // Leaves without samples lie inside or outside as a whole: inside are those that an inner sample touches, and their
  // neighbours without samples.
  const std::array<Vec3i, 6> sides = {Vec3i(-1, 0, 0), Vec3i(1, 0, 0),  Vec3i(0, -1, 0),
                                      Vec3i(0, 1, 0),  Vec3i(0, 0, -1), Vec3i(0, 0, 1)};
  std::vector<char> inside(static_cast<std::size_t>(counts.x()) * counts.y() * counts.z(), 0);
  std::vector<Vec3i> whole;
  const auto take = [&](const Vec3i& leaf) {
    if (!field.contains_leaf(leaf) || field.find_leaf(leaf) >= 0 || inside[index(leaf)]) return;
    inside[index(leaf)] = 1;
    whole.push_back(leaf);
  };
  for (int leaf = 0; leaf < field.leaf_count(); ++leaf) {
    const float* values = field.leaf_values(leaf);
    for (const Vec3i& side : sides) {
      bool inner = false;
      for (int n = 0; n < 512 && !inner; ++n) {
        const Vec3i at(n >> 6, n >> 3 & 7, n & 7);
        const int along = at.dot(side.cwiseAbs());
        inner = along == (side.sum() < 0 ? 0 : 7) && values[n] < 0;
      }
      if (inner) take(field.leaf_coordinate(leaf) + side);
    }
  }
  for (std::size_t k = 0; k < whole.size(); ++k)
    for (const Vec3i& side : sides) {
      const Vec3i leaf = whole[k];
      take(leaf + side);
    }
  std::vector<Vec3i> core;
  for (int leaf = 0; leaf < field.leaf_count(); ++leaf) {
    const Vec3i base = 8 * field.leaf_coordinate(leaf);
    const float* values = field.leaf_values(leaf);
    for (int n = 0; n < 512; ++n) {
      const Vec3i v = base + Vec3i(n >> 6, n >> 3 & 7, n & 7);
      if (values[n] < 0 && !shell.extinction.is_active(v.x(), v.y(), v.z())) core.push_back(v);
    }
  }
  for (const Vec3i& leaf : whole)
    for (int n = 0; n < 512; ++n) core.push_back(8 * leaf + Vec3i(n >> 6, n >> 3 & 7, n & 7));
  return core;
}

void allocate_core(ShellVolume& shell, const std::vector<Vec3i>& core) {
  const auto depth = static_cast<float>(shell.thickness / shell.frame.voxel + 1e6);
  for (const Vec3i& v : core) {
    shell.texture_coordinate.set(v.x(), v.y(), v.z(), Vec3f(0, 0, depth));
    shell.extinction.set(v.x(), v.y(), v.z(), Vec3f::Zero());
    shell.albedo.set(v.x(), v.y(), v.z(), Vec3f::Zero());
    shell.anisotropy.set(v.x(), v.y(), v.z(), Vec3f::Zero());
    shell.normal.set(v.x(), v.y(), v.z(), Vec3f::Zero());
    shell.kind.set(v.x(), v.y(), v.z(), core_voxel_kind);
    if (shell.surface_ior.leaf_count() > 0) shell.surface_ior.set(v.x(), v.y(), v.z(), 0.0f);
  }
}

void set_core_voxel(ShellVolume& shell, const Vec3i& voxel, const Material& material) {
  const Vec3i coordinate(voxel.x() >> 3, voxel.y() >> 3, voxel.z() >> 3);
  const int offset = shell.extinction.offset_of(voxel.x(), voxel.y(), voxel.z());
  shell.extinction.leaf_values(shell.extinction.find_leaf(coordinate))[offset] = material.extinction.matrix();
  shell.albedo.leaf_values(shell.albedo.find_leaf(coordinate))[offset] = material.albedo.matrix();
  shell.anisotropy.leaf_values(shell.anisotropy.find_leaf(coordinate))[offset] = material.anisotropy.matrix();
}

std::size_t shell_bytes(const ShellVolume& shell) {
  return shell.texture_coordinate.bytes() + shell.extinction.bytes() + shell.albedo.bytes() + shell.anisotropy.bytes() +
         shell.normal.bytes() + shell.kind.bytes() + shell.surface_ior.bytes();
}

}  // namespace shellgrid
