// SPDX-License-Identifier: AGPL-3.0-or-later
#include "synthesis/sample_picture.h"

#include <algorithm>

#include "meshing/core/error.h"
#include "meshing/core/parallel.h"
#include "synthesis/albedo.h"
#include "synthesis/half_space_reflectance.h"

namespace shellgrid {
namespace {

const Rgb free_space_color(0.10f, 0.16f, 0.35f);
constexpr int gap = 8;

class Canvas {
 public:
  Canvas(int width, int height) : picture_{width, height, std::vector<std::uint8_t>(3ull * width * height, 255)} {}
  // Draws columns × rows cells of `scale` pixels a side, color(column, row) linear.
  template <class Color>
  void draw(int left, int top, int columns, int rows, int scale, const Color& color) {
    for (int row = 0; row < rows; ++row)
      for (int column = 0; column < columns; ++column) {
        const Rgb bytes = display_color(color(column, row));
        for (int dy = 0; dy < scale; ++dy)
          for (int dx = 0; dx < scale; ++dx)
            for (int c = 0; c < 3; ++c)
              picture_.rgb[3 * (static_cast<std::size_t>(top + row * scale + dy) * picture_.width + left +
                                column * scale + dx) +
                           c] = static_cast<std::uint8_t>(bytes[c] + 0.5f);
      }
  }
  SamplePicture take() { return std::move(picture_); }

 private:
  SamplePicture picture_;
};

}  // namespace

SamplePicture draw_sample(const MaterialSample& sample) {
  const Vec3i n = sample.size;
  const std::size_t texels = static_cast<std::size_t>(n.x()) * n.y();
  std::vector<Rgb> colors(sample.voxel_count());
  const ReflectanceInversion half_space(ReflectanceModel::transport, sample.ior);
  parallel_for(sample.voxel_count(), [&](std::size_t i) {
    colors[i] = sample.kind[i] == VoxelKind::free_space ? free_space_color : half_space.color(sample.material(i));
  });
  const bool relief = std::find(sample.kind.begin(), sample.kind.end(), VoxelKind::free_space) != sample.kind.end();
  const Vec3f light = Vec3f(-0.45f, -0.55f, -0.7f).normalized();
  std::vector<Rgb> top(texels, free_space_color);
  for (std::size_t texel = 0; texel < texels; ++texel)
    for (int z = 0; z < n.z(); ++z) {
      const std::size_t i = z * texels + texel;
      if (sample.kind[i] == VoxelKind::free_space) continue;
      const float shade = relief ? 0.35f + 0.65f * std::max(0.0f, sample.normal[i].dot(light)) : 1.0f;
      // Deep places lie in the shade of what stands around them.
      const float depth = relief ? 1.0f - 0.5f * static_cast<float>(z) / static_cast<float>(n.z()) : 1.0f;
      top[texel] = colors[i] * shade * depth;
      break;
    }
  const int scale = std::max(1, 384 / (2 * std::max(n.x(), n.y())));
  const int plane_width = 2 * n.x() * scale, plane_height = 2 * n.y() * scale;
  const int cut_width = 2 * std::max(n.x(), n.y()) * scale;
  const int right = plane_width + gap, below = plane_height + gap;
  Canvas canvas(right + std::max(plane_width, cut_width), below + 2 * n.z() * scale + gap);
  const auto texel = [&](int x, int y) { return static_cast<std::size_t>(y % n.y()) * n.x() + x % n.x(); };
  canvas.draw(0, 0, 2 * n.x(), 2 * n.y(), scale, [&](int x, int y) { return top[texel(x, y)]; });
  canvas.draw(right, 0, 2 * n.x(), 2 * n.y(), scale,
              [&](int x, int y) { return colors[n.z() / 2 * texels + texel(x, y)]; });
  // Cuts are twice as large as the layers, one period each.
  canvas.draw(0, below, n.x(), n.z(), 2 * scale,
              [&](int x, int z) { return colors[z * texels + texel(x, n.y() / 2)]; });
  canvas.draw(right, below, n.y(), n.z(), 2 * scale,
              [&](int y, int z) { return colors[z * texels + texel(n.x() / 2, y)]; });
  return canvas.take();
}

SamplePicture draw_shell(const ShellVolume& shell) {
  const ReflectanceInversion half_space(ReflectanceModel::transport, shell.ior);
  Vec3i lower = Vec3i::Constant(1 << 30), upper = -lower;
  shell.kind.for_each_active([&](int i, int j, int k, std::int32_t) {
    lower = lower.cwiseMin(Vec3i(i, j, k));
    upper = upper.cwiseMax(Vec3i(i, j, k));
  });
  if (lower.x() > upper.x()) throw InputError("the shell has no voxels");
  const Vec3i n = upper - lower + Vec3i::Ones(), middle = (lower + upper) / 2;
  const int scale = std::max(1, 400 / n.maxCoeff());
  const auto color = [&](int x, int y, int z) -> Rgb {
    if (!shell.kind.is_active(x, y, z)) return Rgb::Ones();
    if (shell.kind.value(x, y, z) == static_cast<std::int32_t>(VoxelKind::free_space)) return free_space_color;
    return half_space.color({shell.extinction.value(x, y, z).array(), shell.albedo.value(x, y, z).array(),
                             shell.anisotropy.value(x, y, z).array()});
  };
  Canvas canvas((n.x() + n.z()) * scale + gap, std::max(n.y(), n.z()) * scale);
  canvas.draw(0, 0, n.x(), n.y(), scale, [&](int x, int y) { return color(lower.x() + x, upper.y() - y, middle.z()); });
  canvas.draw(n.x() * scale + gap, 0, n.z(), n.y(), scale,
              [&](int z, int y) { return color(middle.x(), upper.y() - y, lower.z() + z); });
  return canvas.take();
}

}  // namespace shellgrid
