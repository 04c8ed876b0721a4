// SPDX-License-Identifier: AGPL-3.0-or-later
// Samples at the ends of what there can be, from the archive to a shell with each kind of core: finite, or refused.
#include <gtest/gtest.h>

#include <limits>

#include "meshing/core/error.h"
#include "meshing/distance/distance_field.h"
#include "synthesis/sample_archive.h"
#include "synthesis/sample_check.h"
#include "synthesis/shell_core.h"
#include "synthesis/surface_synthesis.h"
#include "synthesis/textured_mesh.h"
#include "tests/synthesis/synthesis_shapes.h"

namespace shellgrid {
namespace {

MaterialSample block(const Vec3i& size, double voxel) {
  MaterialSample sample;
  sample.size = size;
  sample.voxel = voxel;
  sample.ior = 1.4;
  const Material m = testing::marble_body();
  sample.extinction.assign(sample.voxel_count(), m.extinction.matrix());
  sample.albedo.assign(sample.voxel_count(), m.albedo.matrix());
  sample.anisotropy.assign(sample.voxel_count(), m.anisotropy.matrix());
  sample.kind.assign(sample.voxel_count(), VoxelKind::interior);
  sample.normal.assign(sample.voxel_count(), Vec3f::Zero());
  for (std::size_t i = 0; i < static_cast<std::size_t>(size.x()) * size.y(); ++i) {
    sample.kind[i] = VoxelKind::surface;
    sample.normal[i] = Vec3f(0, 0, -1);
  }
  return sample;
}

// The chain of the stages over a ball. Throws what they throw.
void expect_finite_shells(const MaterialSample& given, double radius = 5) {
  const MaterialSample sample = restore_sample(archive_sample(given));
  check_sample(sample);
  const TriangleMesh ball = testing::sphere(radius, 4);
  TextonOptions options;
  options.texton_count = 20;
  const TextonSet textons = make_textons(sample, options);
  for (const float value : textons.features) ASSERT_TRUE(std::isfinite(value));
  const SurfaceTexture texture = synthesize_surface(ball, textons, {});
  const TexturedMesh mesh = detach_texture(attach_texture(texture, textons), "ball");
  DistanceOptions band;
  band.voxel = sample.voxel;
  band.inside_band = 4 * sample.voxel;
  band.outside_band = sample.voxel;
  DistanceStatistics unused;
  const DistanceField distance = compute_distance_field(ball, band, unused);
  for (const ShellCoordinates coordinates : {ShellCoordinates::nearest, ShellCoordinates::interpolated})
    for (int core = 0; core < 3; ++core) {
      ShellVolume shell =
          resample_shell(mesh, distance, {&sample}, bottom_layer_mean(sample), 2 * sample.voxel, coordinates);
      if (core == 1) fill_core_by_mean_values(shell, distance, 500);
      if (core == 2) fill_core_with_solid(shell, distance, sample, {});
      EXPECT_GT(shell.extinction.active_count(), 100u);
      shell.extinction.for_each_active([&](int i, int j, int k, const Vec3f& extinction) {
        ASSERT_TRUE(extinction.allFinite() && (extinction.array() >= 0).all());
        const Vec3f albedo = shell.albedo.value(i, j, k);
        ASSERT_TRUE(albedo.allFinite() && (albedo.array() >= 0).all() && (albedo.array() <= 1).all());
        ASSERT_TRUE(shell.texture_coordinate.value(i, j, k).allFinite());
      });
    }
}

constexpr double voxel = 0.5;

TEST(SynthesisStress, AConstantSample) { expect_finite_shells(block({16, 16, 4}, voxel)); }

TEST(SynthesisStress, TinySamplesWorkOrAreTooSmall) {
  for (const Vec3i& size : {Vec3i(1, 1, 1), Vec3i(2, 3, 1), Vec3i(1, 40, 2), Vec3i(4, 4, 1)}) {
    try {
      expect_finite_shells(block(size, voxel));
    } catch (const InputError& error) {
      EXPECT_NE(std::string(error.what()).find("too small"), std::string::npos) << error.what();
    }
  }
}

TEST(SynthesisStress, ASampleLargerThanTheObject) {
  MaterialSample sample = block({96, 96, 30}, voxel);
  for (std::size_t i = 0; i < sample.voxel_count(); i += 7) sample.extinction[i] *= 0.5f;
  expect_finite_shells(sample, 4);
}

TEST(SynthesisStress, TwoColoursAtAContrastOfAMillion) {
  for (const float contrast : {1e-6f, 1e6f}) {
    MaterialSample sample = block({24, 24, 4}, voxel);
    for (std::size_t i = 0; i < sample.voxel_count(); ++i)
      if (i / 5 % 2 == 0) sample.extinction[i] *= contrast;
    expect_finite_shells(sample);
  }
}

TEST(SynthesisStress, NothingButClearAndBlackMatter) {
  MaterialSample sample = block({16, 16, 4}, voxel);
  for (std::size_t i = 0; i < sample.voxel_count(); ++i) (i % 2 == 0 ? sample.extinction : sample.albedo)[i].setZero();
  expect_finite_shells(sample);
}

TEST(SynthesisStress, ASampleThatDoesNotTile) {
  MaterialSample sample = block({24, 24, 4}, voxel);
  for (std::size_t i = 0; i < sample.voxel_count(); ++i) sample.extinction[i] *= static_cast<float>(1 + i % 24);
  const SampleCheck check = check_sample(sample);
  EXPECT_FALSE(check.tilable());
  expect_finite_shells(sample);
}

TEST(SynthesisStress, NumbersThatAreNoneAreRefused) {
  const float nan = std::numeric_limits<float>::quiet_NaN(), infinite = std::numeric_limits<float>::infinity();
  for (const float bad : {nan, infinite, -1.0f}) {
    for (int field = 0; field < 3; ++field) {
      MaterialSample sample = block({8, 8, 2}, voxel);
      (field == 0 ? sample.extinction : field == 1 ? sample.albedo : sample.anisotropy)[77][1] = bad;
      EXPECT_THROW(restore_sample(archive_sample(sample)), InputError) << bad << " in field " << field;
    }
    MaterialSample sample = block({8, 8, 2}, voxel);
    sample.normal[3] = Vec3f(0, nan, -1);
    EXPECT_THROW(restore_sample(archive_sample(sample)), InputError);
  }
}

TEST(SynthesisStress, MeshesOfFewVertices) {
  // 18, 66 and 258 vertices.
  for (const int times : {1, 2, 3}) {
    const double radius = 5, edge = radius * 1.5 / std::pow(2, times);
    MaterialSample sample = block({8, 8, 4}, edge);
    for (std::size_t i = 0; i < sample.voxel_count(); i += 3) sample.extinction[i] *= 0.5f;
    const TextonSet textons = make_textons(sample, {});
    const SurfaceTexture texture = synthesize_surface(testing::sphere(radius, times), textons, {});
    for (const Vec2f& c : texture.coordinate) {
      ASSERT_TRUE(c.allFinite());
      ASSERT_TRUE(c.x() >= 0 && c.x() < 8 && c.y() >= 0 && c.y() < 8);
    }
  }
}

}  // namespace
}  // namespace shellgrid
