// SPDX-License-Identifier: AGPL-3.0-or-later
#include "synthesis/sample_resize.h"

#include <fmt/format.h>

#include <algorithm>

#include "meshing/core/error.h"
#include "synthesis/sample_builder.h"

namespace shellgrid {
namespace {

struct Source {
  Vec3i voxel;
  bool mirrored_x = false, mirrored_y = false;
};

// A sample whose voxel (x, y, z) is the old one's at source(x, y, z).
template <class Choose>
MaterialSample gather(const MaterialSample& old, const Vec3i& size, const Choose& source) {
  if (size.cast<double>().prod() > 2e8)
    throw InputError(fmt::format("a sample of {} x {} x {} voxels is too large; expected at most 2e8", size.x(),
                                 size.y(), size.z()));
  MaterialSample result = allocate_sample(size, old.voxel, old.ior);
  if (!old.surface_ior.empty()) result.surface_ior.resize(result.voxel_count());
  for_each_voxel(result, [&](std::size_t index, const Vec3& centre) {
    const Source from = source(Vec3i(centre.cast<int>()));
    const std::size_t at = old.index(from.voxel.x(), from.voxel.y(), from.voxel.z());
    result.extinction[index] = old.extinction[at];
    result.albedo[index] = old.albedo[at];
    result.anisotropy[index] = old.anisotropy[at];
    result.kind[index] = old.kind[at];
    result.normal[index] = old.normal[at];
    if (from.mirrored_x) result.normal[index].x() *= -1;
    if (from.mirrored_y) result.normal[index].y() *= -1;
    if (!old.surface_ior.empty()) result.surface_ior[index] = old.surface_ior[at];
  });
  return result;
}

}  // namespace

MaterialSample mirror_sample(const MaterialSample& sample) {
  const Vec3i n = sample.size;
  return gather(sample, Vec3i(2 * n.x(), 2 * n.y(), n.z()), [&](const Vec3i& at) {
    const bool mirrored_x = at.x() >= n.x(), mirrored_y = at.y() >= n.y();
    return Source{
        Vec3i(mirrored_x ? 2 * n.x() - 1 - at.x() : at.x(), mirrored_y ? 2 * n.y() - 1 - at.y() : at.y(), at.z()),
        mirrored_x, mirrored_y};
  });
}

MaterialSample repeat_sample(const MaterialSample& sample, int times_x, int times_y) {
  const Vec3i n = sample.size;
  return gather(sample, Vec3i(times_x * n.x(), times_y * n.y(), n.z()),
                [&](const Vec3i& at) { return Source{Vec3i(at.x() % n.x(), at.y() % n.y(), at.z())}; });
}

MaterialSample with_layers(const MaterialSample& sample, int layers) {
  const Vec3i n = sample.size;
  MaterialSample result = gather(sample, Vec3i(n.x(), n.y(), layers),
                                 [&](const Vec3i& at) { return Source{at.cwiseMin(Vec3i(n.x(), n.y(), n.z() - 1))}; });
  // Surface voxels of the old bottom layer stay surface, their copies below are inside unless they overhang free space.
  for (int z = n.z(); z < layers; ++z)
    for (int y = 0; y < n.y(); ++y)
      for (int x = 0; x < n.x(); ++x) {
        const std::size_t i = result.index(x, y, z);
        if (result.kind[i] != VoxelKind::surface) continue;
        const auto is_free = [&](int u, int v) {
          return result.kind[result.index((u + n.x()) % n.x(), (v + n.y()) % n.y(), z)] == VoxelKind::free_space;
        };
        if (is_free(x + 1, y) || is_free(x - 1, y) || is_free(x, y + 1) || is_free(x, y - 1)) continue;
        result.kind[i] = VoxelKind::interior;
        result.normal[i].setZero();
        if (!result.surface_ior.empty()) result.surface_ior[i] = 0;
      }
  return result;
}

MaterialSample crop_sample(const MaterialSample& sample, const Vec3i& first, const Vec3i& size) {
  if ((first.array() < 0).any() || (size.array() < 1).any() || ((first + size).array() > sample.size.array()).any())
    throw InputError(fmt::format("the part from ({}, {}, {}) of {} x {} x {} reaches beyond a sample of {} x {} x {}",
                                 first.x(), first.y(), first.z(), size.x(), size.y(), size.z(), sample.size.x(),
                                 sample.size.y(), sample.size.z()));
  return gather(sample, size, [&](const Vec3i& at) { return Source{at + first}; });
}

}  // namespace shellgrid
