// SPDX-License-Identifier: AGPL-3.0-or-later
#include "synthesis/solid_material.h"

#include <algorithm>
#include <cmath>

#include "meshing/core/error.h"
#include "synthesis/albedo.h"
#include "synthesis/sample_builder.h"
#include "synthesis/slice_windows.h"

namespace shellgrid {
namespace {

// The voxel of a sample that a texel of its slices perpendicular to `axis` shows.
Vec3i voxel_of(const Vec3i& size, int axis, std::int32_t texel) {
  const int width = size[column_axis(axis)], height = size[row_axis(axis)];
  Vec3i voxel;
  voxel[column_axis(axis)] = texel % width;
  voxel[row_axis(axis)] = texel / width % height;
  voxel[axis] = texel / width / height;
  return voxel;
}

}  // namespace

Material material_of_color(const Rgb& color, const ColorMaterial& matter, const ReflectanceInversion& inversion) {
  const Rgb reduced = inversion.reduced_albedo(Rgb(color.max(0.0f).min(static_cast<float>(matter.brightest))));
  Material material;
  material.extinction = matter.extinction;
  material.anisotropy = matter.anisotropy;
  // α' = α (1 − g) / (1 − α g).
  material.albedo = reduced / (1 - matter.anisotropy + reduced * matter.anisotropy);
  return material;
}

MaterialSample material_of_colors(const Vec3i& size, const std::vector<Rgb>& colors, double voxel, double ior,
                                  const ColorMaterial& matter) {
  MaterialSample sample = allocate_sample(size, voxel, ior);
  if (colors.size() != sample.voxel_count()) throw InternalError("a colour for each voxel is needed");
  const ReflectanceInversion inversion(matter.model, ior);
  for_each_voxel(sample, [&](std::size_t index, const Vec3&) {
    store_material(sample, index, material_of_color(colors[index], matter, inversion));
  });
  mark_surface(sample);
  return sample;
}

SolidExemplar exemplar_of_sample(const MaterialSample& sample) {
  if (std::find(sample.kind.begin(), sample.kind.end(), VoxelKind::free_space) != sample.kind.end())
    throw InputError("the sample holds free space, which a solid does not; mirror it instead to make it tile");
  SolidExemplar exemplar;
  exemplar.channels = 6;
  std::vector<Eigen::Array<float, 6, 1>> looks(sample.voxel_count());
  for_each_voxel(sample, [&](std::size_t index, const Vec3&) {
    const Material material = sample.material(index);
    looks[index].head<3>() = display_color(diffuse_color(material, sample.ior)) / 255;
    // A factor of e in extinction weighs as much as from black to a middle grey.
    looks[index].tail<3>() = 0.5f * material.reduced_extinction().max(1e-6f).log();
  });
  for (int d = 0; d < 3; ++d) {
    SliceStack& stack = exemplar.axes[d];
    stack.width = sample.size[column_axis(d)], stack.height = sample.size[row_axis(d)], stack.slices = sample.size[d];
    for (std::size_t t = 0; t < stack.texel_count(); ++t) {
      const Vec3i voxel = voxel_of(sample.size, d, static_cast<std::int32_t>(t));
      const auto& look = looks[sample.index(voxel.x(), voxel.y(), voxel.z())];
      stack.values.insert(stack.values.end(), look.data(), look.data() + 6);
    }
  }
  return exemplar;
}

MaterialSample material_of_texels(const MaterialSample& sample, const SolidTexture& solid) {
  MaterialSample result = allocate_sample(solid.size, sample.voxel, sample.ior);
  for_each_voxel(result, [&](std::size_t index, const Vec3&) {
    const Vec3i voxel = voxel_of(sample.size, solid.axis[index], solid.texel[index]);
    store_material(result, index, sample.material(sample.index(voxel.x(), voxel.y(), voxel.z())));
  });
  mark_surface(result);
  return result;
}

}  // namespace shellgrid
