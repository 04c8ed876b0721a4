// SPDX-License-Identifier: AGPL-3.0-or-later
#include "synthesis/scan_conversion.h"

#include <gtest/gtest.h>

#include <cmath>
#include <numbers>

#include "meshing/core/error.h"
#include "synthesis/sample_archive.h"
#include "synthesis/sample_check.h"
#include "tests/synthesis/synthesis_shapes.h"

namespace shellgrid {
namespace {

using testing::marble_body;
using testing::marble_vein;
using testing::sphere;

ScanPart ground(double level, const Material& material) {
  ScanPart part;
  part.placements[0].position = Vec3(0, 0, level);
  part.material = material;
  return part;
}

ScanPart ball(const Vec3& centre, double radius, const Material& material, int priority = 1) {
  ScanPart part;
  part.mesh = sphere(radius, 5);
  part.placements[0].position = centre;
  part.material = material;
  part.priority = priority;
  return part;
}

ScanOptions options(int size, double voxel, double thickness, double top) {
  ScanOptions result;
  result.width = result.height = size;
  result.voxel = voxel;
  result.thickness = thickness;
  result.top = top;
  return result;
}

double ball_volume(double radius) { return 4.0 / 3 * std::numbers::pi * radius * radius * radius; }

TEST(ScanConversion, ABuriedBallWeighsWhatItShould) {
  // Partial volumes: the sum of σ_a over all voxels is that of ground and ball, whatever voxels the border crosses.
  const double radius = 2.3;
  const MaterialSample sample =
      scan_convert({ground(0, marble_body()), ball({4.03, 3.91, -3.17}, radius, marble_vein())},
                   options(20, 0.4, 6.4, 0))
          .sample;
  double absorption = 0;
  for (std::size_t i = 0; i < sample.voxel_count(); ++i) absorption += sample.material(i).absorption()[1] * 0.064;
  const double body = marble_body().absorption()[1], vein = marble_vein().absorption()[1];
  EXPECT_NEAR(absorption, body * 8 * 8 * 6.4 + (vein - body) * ball_volume(radius), 0.01 * vein * ball_volume(radius));
}

TEST(ScanConversion, NormalsOfABallPointAwayFromItsCentre) {
  const Vec3 centre(4.1, 4.2, -3);
  const MaterialSample sample = scan_convert({ball(centre, 2.5, marble_body())}, options(20, 0.4, 6.4, 0)).sample;
  int surface = 0, filled = 0;
  double worst = 1;
  for (int z = 0; z < sample.size.z(); ++z)
    for (int y = 0; y < 20; ++y)
      for (int x = 0; x < 20; ++x) {
        const std::size_t i = sample.index(x, y, z);
        filled += sample.kind[i] != VoxelKind::free_space;
        if (sample.kind[i] != VoxelKind::surface) continue;
        ++surface;
        const Vec3 arm = Vec3(0.4 * (x + 0.5), 0.4 * (y + 0.5), -0.4 * (z + 0.5)) - centre;
        const Vec3f outward = Vec3(arm.x(), arm.y(), -arm.z()).normalized().cast<float>();
        worst = std::min<double>(worst, sample.normal[i].dot(outward));
      }
  EXPECT_GT(surface, 300);
  EXPECT_GT(worst, std::cos(2 * std::numbers::pi / 180));
  EXPECT_NEAR(filled * 0.064 / ball_volume(2.5), 1, 0.02);
}

TEST(ScanConversion, BodiesAcrossTheBorderComeBackOnTheOtherSideExactly) {
  // The same scene moved by 7 and 11 voxels, once across the corner.
  const auto scene = [](const Vec3& move) {
    return std::vector<ScanPart>{ground(-2, marble_body()), ball(Vec3(4.1, 3.9, -1.5) + move, 1.9, marble_vein()),
                                 ball(Vec3(2.1, 4.9, -2.5) + move, 0.9, marble_body(), 2)};
  };
  const MaterialSample here = scan_convert(scene(Vec3::Zero()), options(20, 0.5, 5, 1)).sample;
  const MaterialSample there = scan_convert(scene(Vec3(3.5 + 10, 5.5 - 30, 0)), options(20, 0.5, 5, 1)).sample;
  for (int z = 0; z < here.size.z(); ++z)
    for (int y = 0; y < 20; ++y)
      for (int x = 0; x < 20; ++x) {
        const std::size_t a = here.index(x, y, z), b = there.index((x + 7) % 20, (y + 11) % 20, z);
        ASSERT_EQ(here.kind[a], there.kind[b]);
        ASSERT_NEAR((here.extinction[a] - there.extinction[b]).norm(), 0, 1e-6);
        ASSERT_NEAR((here.normal[a] - there.normal[b]).norm(), 0, 1e-4);
      }
}

TEST(ScanConversion, HigherPrioritiesWinAndFreePartsTakeAway) {
  ScanPart dent = ball({4, 4, 0}, 1.5, {}, 1), seed = ball({4, 4, -1}, 0.7, marble_vein(), 2);
  dent.free = true;
  seed.ior = 1.4;
  const std::vector<ScanPart> parts = {ground(0, marble_body()), dent, seed};
  const MaterialSample sample = scan_convert(parts, options(20, 0.4, 4, 0.1)).sample;
  const auto at = [&](double x, double y, double z) {
    return sample.index(static_cast<int>(x / 0.4), static_cast<int>(y / 0.4), static_cast<int>((0.1 - z) / 0.4));
  };
  EXPECT_EQ(sample.kind[at(4, 4, -0.1)], VoxelKind::free_space);
  EXPECT_EQ(sample.kind[at(4.9, 4, -0.5)], VoxelKind::free_space);
  EXPECT_NEAR(sample.material(at(4, 4, -1.2)).absorption()[1], marble_vein().absorption()[1], 1e-5);
  EXPECT_NEAR(sample.material(at(4, 4, -2.5)).absorption()[1], marble_body().absorption()[1], 1e-5);
  // The index of what makes the surface, there and only there.
  EXPECT_FLOAT_EQ(sample.surface_ior[at(4, 4, -0.6)], 1.4f);
  EXPECT_FLOAT_EQ(sample.surface_ior[at(1, 1, -0.1)], 1.5f);
  EXPECT_EQ(sample.surface_ior[at(4, 4, -2.5)], 0);
  EXPECT_EQ(restore_sample(archive_sample(sample)).surface_ior, sample.surface_ior);
  // Below the dent's flank the normal points at the dent's centre.
  const Vec3f normal = sample.normal[at(4.0 - 1.3, 4, -0.9)];
  EXPECT_GT(normal.x(), 0.5f);
  EXPECT_LT(normal.z(), -0.3f);
}

TEST(ScanConversion, AFreePartOfLowerPriorityTakesNothingAway) {
  ScanPart dent = ball({4, 4, 0}, 1.5, {}, 0);
  dent.free = true;
  ScanPart flesh = ground(0, marble_body());
  flesh.priority = 1;
  const MaterialSample sample = scan_convert({flesh, dent}, options(20, 0.4, 4, 0)).sample;
  EXPECT_EQ(check_sample(sample).free_share, 0);
}

TEST(ScanConversion, PartsOfABodyOverhang) {
  const MaterialSample sample =
      scan_convert({ground(0, marble_body()), ball({4, 4, 3}, 2, marble_vein())}, options(20, 0.4, 8, 5.1)).sample;
  // A ball 1 mm above the ground: material, free space, material down its axis.
  int changes = 0;
  for (int z = 1; z < sample.size.z(); ++z)
    changes += (sample.kind[sample.index(10, 10, z)] == VoxelKind::free_space) !=
               (sample.kind[sample.index(10, 10, z - 1)] == VoxelKind::free_space);
  EXPECT_EQ(changes, 2);
}

TEST(ScanConversion, BodiesSmallerThanAPlaceOrFarAboveLeaveNoTrace) {
  const std::vector<ScanPart> parts = {ground(0, marble_body()), ball({4.02, 4.03, -1.01}, 1e-4, marble_vein()),
                                       ball({4, 4, 1e6}, 1, marble_vein()), ball({4, 4, -1e6}, 1, marble_vein())};
  const MaterialSample sample = scan_convert(parts, options(20, 0.4, 4, 0)).sample;
  for (std::size_t i = 0; i < sample.voxel_count(); ++i)
    ASSERT_NEAR(sample.extinction[i][0], marble_body().extinction[0], 1e-4);
}

TEST(ScanConversion, RefusesOpenMeshesEmptyScenesAndBodiesOutOfScale) {
  ScanPart open = ball({4, 4, -3}, 1, marble_body());
  open.mesh.faces.conservativeResize(open.mesh.face_count() - 1, 3);
  EXPECT_THROW(scan_convert({open}, options(20, 0.4, 4, 0)), InputError);
  EXPECT_THROW(scan_convert({ball({4, 4, 30}, 1, marble_body())}, options(20, 0.4, 4, 0)), InputError);
  EXPECT_THROW(scan_convert({ball({4, 4, 0}, 4000, marble_body())}, options(20, 0.4, 4, 0)), InputError);
  EXPECT_THROW(scan_convert({}, options(20, 0.4, 4, 0)), InputError);
}

}  // namespace
}  // namespace shellgrid
