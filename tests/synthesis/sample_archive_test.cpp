// SPDX-License-Identifier: AGPL-3.0-or-later
#include "synthesis/sample_archive.h"

#include <gtest/gtest.h>

#include <Eigen/LU>
#include <algorithm>
#include <filesystem>

#include "meshing/core/error.h"
#include "meshing/surface/half_edges.h"
#include "synthesis/textured_mesh.h"
#include "tests/synthesis/synthesis_shapes.h"

namespace shellgrid {
namespace {

// Writes an archive to a file of its own and reads it back.
VdbArchive through_file(const VdbArchive& archive) {
  const auto path =
      std::filesystem::temp_directory_path() /
      ("shellgrid_" + std::string(::testing::UnitTest::GetInstance()->current_test_info()->name()) + ".vdb");
  write_vdb(path.string(), archive);
  const VdbArchive read = read_vdb(path.string());
  std::filesystem::remove(path);
  return read;
}

TEST(SampleArchive, SamplesComeBackBitForBit) {
  const MaterialSample sample = make_procedural_sample(testing::bumps(33));
  const MaterialSample back = restore_sample(through_file(archive_sample(sample)));
  EXPECT_EQ(back.size, sample.size);
  EXPECT_EQ(back.voxel, sample.voxel);
  EXPECT_EQ(back.ior, sample.ior);
  EXPECT_TRUE(back.extinction == sample.extinction);
  EXPECT_TRUE(back.albedo == sample.albedo);
  EXPECT_TRUE(back.anisotropy == sample.anisotropy);
  EXPECT_TRUE(back.normal == sample.normal);
  EXPECT_TRUE(back.kind == sample.kind);
}

TEST(SampleArchive, TextonsComeBackBitForBit) {
  TextonOptions options;
  options.texton_count = 25;
  options.symmetry = 4;
  SampleDefinition wide = testing::marble(40);
  wide.width = 48;
  const MaterialSample first = make_procedural_sample(testing::marble(40)), second = make_procedural_sample(wide);
  const TextonSet set = make_textons({&first, &second}, options);
  const TextonSet back = restore_textons(through_file(archive_textons(set)));
  EXPECT_EQ(back.layers.symmetry, set.layers.symmetry);
  EXPECT_EQ(back.layers.sample_count, set.layers.sample_count);
  EXPECT_EQ(back.texel_count(), set.texel_count());
  EXPECT_EQ(back.voxel, set.voxel);
  EXPECT_TRUE(back.features == set.features);
  EXPECT_TRUE(back.textons == set.textons);
  EXPECT_TRUE(back.color == set.color);
  ASSERT_EQ(back.levels.size(), set.levels.size());
  for (std::size_t l = 0; l < set.levels.size(); ++l) {
    EXPECT_TRUE(back.levels[l].appearance == set.levels[l].appearance);
    EXPECT_TRUE(back.levels[l].candidates == set.levels[l].candidates);
  }
}

TEST(SampleArchive, RefusesCandidatesAndKindsOutOfRange) {
  VdbArchive archive = archive_textons(make_textons(make_procedural_sample(testing::marble(32)), {}));
  for (VdbArchive::Entry& entry : archive.grids)
    if (entry.name == "candidate_1_0") std::get<TwoLevelGrid<std::int32_t>>(entry.grid).set(3, 4, 0, 32 * 32);
  EXPECT_THROW(restore_textons(archive), InputError);
  VdbArchive sample = archive_sample(make_procedural_sample(testing::layers(8)));
  for (VdbArchive::Entry& entry : sample.grids)
    if (entry.name == "kind") std::get<TwoLevelGrid<std::int32_t>>(entry.grid).set(3, 4, 0, 7);
  EXPECT_THROW(restore_sample(sample), InputError);
}

TEST(SampleArchive, ImportsADensityWithItsFreeSpace) {
  VdbArchive archive;
  archive.frame = {Vec3(5, 6, 7), 0.25};
  TwoLevelGrid<float> density(Vec3i(-2, -2, -2), Vec3i(4, 4, 4), 0.0f);
  for (int i = -5; i < 3; ++i)
    for (int j = 1; j < 7; ++j)
      for (int k = -3; k < 2; ++k) density.set(i, j, k, k == -3 ? 0.0f : 0.5f + 0.1f * static_cast<float>(i));
  archive.grids.push_back({"density", density});
  VolumeImport options;
  options.extinction_scale = 4;
  options.albedo = Rgb(0.9f, 0.8f, 0.7f);
  const MaterialSample sample = import_sample(archive, options);
  EXPECT_EQ(sample.size, Vec3i(8, 6, 5));
  EXPECT_EQ(sample.voxel, 0.25);
  EXPECT_EQ(sample.kind[sample.index(6, 0, 0)], VoxelKind::free_space);
  EXPECT_EQ(sample.kind[sample.index(6, 0, 1)], VoxelKind::surface);
  EXPECT_GT(-sample.normal[sample.index(6, 0, 1)].z(), 0.9f);
  EXPECT_EQ(sample.kind[sample.index(6, 0, 3)], VoxelKind::interior);
  EXPECT_NEAR(sample.extinction[sample.index(6, 0, 3)][0], 4 * 0.6, 1e-5);
  EXPECT_EQ(sample.albedo[sample.index(6, 0, 3)], Vec3f(0.9f, 0.8f, 0.7f));
  archive.grids[0].name = "temperature";
  EXPECT_THROW(import_sample(archive, options), InputError);
}

TEST(SampleViews, AreClosedAndFaceOutwards) {
  const auto check = [](const TriangleMesh& mesh) {
    const HalfEdges half_edges = build_half_edges(mesh);
    EXPECT_EQ(std::count(half_edges.twin.begin(), half_edges.twin.end(), -1), 0);
    double volume = 0;
    for (int f = 0; f < mesh.face_count(); ++f) {
      Mat3 corners;
      for (int k = 0; k < 3; ++k) corners.col(k) = mesh.corner(f, k);
      volume += corners.determinant() / 6;
    }
    EXPECT_GT(volume, 0);
  };
  const MaterialSample sample = make_procedural_sample(testing::bumps(32));
  check(view_sample(sample).mesh);
  check(view_sample(make_procedural_sample(testing::layers(16))).mesh);
  check(view_textons(make_textons(sample, {})).mesh);
}

}  // namespace
}  // namespace shellgrid
