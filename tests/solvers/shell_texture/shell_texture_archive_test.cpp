// SPDX-License-Identifier: AGPL-3.0-or-later
#include "solvers/shell_texture/shell_texture_archive.h"

#include <gtest/gtest.h>

#include <cmath>

#include "meshing/core/error.h"
#include "meshing/core/random.h"

namespace shellgrid {
namespace {

ShellTexture noise() {
  ShellTexture t;
  t.size = {9, 5, 3};
  t.voxel = 0.25;
  t.directions = {2, 3};
  const std::size_t voxels = 9 * 5 * 3;
  const auto value = [](std::uint64_t k) { return static_cast<float>(to_unit(hash64(1, k))); };
  for (std::size_t k = 0; k < 6 * voxels; ++k) t.single.emplace_back(value(k), value(k + 1), 0);
  for (std::size_t k = 0; k < 7 * voxels; ++k) {
    t.multiple.emplace_back(value(3 * k), 1, value(k));
    t.error.push_back(k % 5 == 0 ? -1.0f : value(k));
  }
  for (std::size_t k = 0; k < 7 * 45; ++k) t.below.emplace_back(value(k), value(5 * k), value(7 * k));
  for (std::size_t k = 0; k < voxels; ++k) t.matter.push_back(k < 4 ? 0.0f : value(k));
  t.kernels.ring = 0.25;
  t.kernels.rings = 3;
  t.kernels.first_layer = {0, 1, 3};
  for (std::size_t k = 0; k < 2 * 3 * 3; ++k) t.kernels.values.emplace_back(value(k), value(2 * k), 0);
  for (std::size_t k = 0; k < 45; ++k) t.kernels.of_texel.push_back(k % 2);
  return t;
}

TEST(ShellTextureArchive, ComesBackAsItWas) {
  const ShellTexture t = noise();
  const ShellTexture back = restore_shell_texture(archive_shell_texture(t));
  EXPECT_EQ(back.size, t.size);
  EXPECT_EQ(back.voxel, t.voxel);
  EXPECT_EQ(back.directions.rings, 2);
  EXPECT_EQ(back.directions.turns, 3);
  EXPECT_TRUE(back.single == t.single);
  EXPECT_TRUE(back.multiple == t.multiple);
  EXPECT_TRUE(back.below == t.below);
  EXPECT_EQ(back.matter, t.matter);
  EXPECT_EQ(back.kernels.ring, 0.25);
  EXPECT_EQ(back.kernels.first_layer, t.kernels.first_layer);
  EXPECT_TRUE(back.kernels.values == t.kernels.values);
  EXPECT_EQ(back.kernels.of_texel, t.kernels.of_texel);
  // The root mean square over the directions that are known.
  double sum = 0;
  int known = 0;
  for (int l = 0; l < 7; ++l)
    if (t.error[t.at(l, 8)] >= 0) sum += std::pow(t.error[t.at(l, 8)], 2), ++known;
  EXPECT_NEAR(back.error[8], std::sqrt(sum / known), 1e-6);
}

TEST(ShellTextureArchive, RefusesOtherVolumes) {
  VdbArchive archive = archive_shell_texture(noise());
  archive.metadata["size"] = "9 5 4000";
  EXPECT_THROW(restore_shell_texture(archive), InputError);
  archive = archive_shell_texture(noise());
  archive.grids.erase(archive.grids.begin() + 3);
  EXPECT_THROW(restore_shell_texture(archive), InputError);
  archive = archive_shell_texture(noise());
  archive.metadata["kind"] = "sample";
  EXPECT_THROW(restore_shell_texture(archive), InputError);
}

TEST(ShellTextureArchive, ShowsItsMatter) {
  const ShellTexture t = noise();
  const AttributedMesh view = view_shell_texture(t);
  std::size_t matter = 0;
  for (const float share : t.matter) matter += share > 0.25f;
  EXPECT_EQ(static_cast<std::size_t>(view.mesh.vertex_count()), matter);
  EXPECT_LT(view.mesh.vertices.col(2).maxCoeff(), 0);
}

}  // namespace
}  // namespace shellgrid
