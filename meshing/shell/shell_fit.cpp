// SPDX-License-Identifier: AGPL-3.0-or-later
#include "meshing/shell/shell_fit.h"

#include <vector>

#include "meshing/surface/surface_fit.h"

namespace shellgrid {

double shell_misfit(const ShellVolume& shell, const TriangleMesh& surface) {
  constexpr std::size_t most = 500;
  const auto has_depth = [&](int i, int j, int k, const Vec3f& coordinate) {
    return coordinate.z() > 0 && shell.kind.value(i, j, k) != core_voxel_kind;
  };
  std::size_t count = 0;
  shell.texture_coordinate.for_each_active(
      [&](int i, int j, int k, const Vec3f& coordinate) { count += has_depth(i, j, k, coordinate); });
  const std::size_t stride = (count + most - 1) / most;
  std::vector<PlaceAtDistance> places;
  std::size_t at = 0;
  shell.texture_coordinate.for_each_active([&](int i, int j, int k, const Vec3f& coordinate) {
    if (!has_depth(i, j, k, coordinate) || at++ % stride != 0) return;
    places.push_back({shell.frame.to_world(Vec3i(i, j, k)), coordinate.z() * shell.frame.voxel});
  });
  return distance_deviation(places, surface, 0.9);
}

}  // namespace shellgrid
