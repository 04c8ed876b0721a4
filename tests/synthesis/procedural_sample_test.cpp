// SPDX-License-Identifier: AGPL-3.0-or-later
#include "synthesis/procedural_sample.h"

#include <gtest/gtest.h>

#include <cmath>
#include <numbers>

#include "meshing/core/error.h"
#include "synthesis/albedo.h"
#include "synthesis/sample_builder.h"
#include "synthesis/sample_check.h"
#include "tests/synthesis/synthesis_shapes.h"

namespace shellgrid {
namespace {

using testing::bumps;
using testing::cells;
using testing::grass;
using testing::layers;
using testing::marble;
using testing::marble_body;
using testing::spots;
using testing::weave;
using testing::wood;

TEST(ProceduralSample, EveryKindTilesInBothDirections) {
  for (const SampleDefinition& definition :
       {marble(48), spots(48), layers(48), bumps(48), wood(48), cells(48), grass(48), weave(48)}) {
    const SampleCheck check = check_sample(make_procedural_sample(definition));
    EXPECT_LT(check.seam_x, 1.5);
    EXPECT_LT(check.seam_y, 1.5);
  }
}

TEST(ProceduralSample, VeinsAbsorbMoreThanTheBodyAndBothAreThere) {
  const MaterialSample sample = make_procedural_sample(marble(64));
  int body = 0, vein = 0;
  for (std::size_t i = 0; i < sample.voxel_count(); ++i) {
    const float absorption = sample.material(i).absorption()[1];
    body += absorption < 0.02f;
    vein += absorption > 0.1f;
  }
  EXPECT_GT(body, static_cast<int>(sample.voxel_count()) / 2);
  EXPECT_GT(vein, static_cast<int>(sample.voxel_count()) / 100);
}

TEST(ProceduralSample, WhatDoesNotAbsorbStaysSo) {
  const Material white = Material::from_absorption_scattering(Rgb(0, 0, 0.1f), Rgb(1, 2, 3), Rgb::Zero()),
                 vein = Material::from_absorption_scattering(Rgb(0, 0.2f, 0.3f), Rgb(1, 2, 3), Rgb::Zero());
  for (const double share : {0.0, 0.4, 1.0}) {
    const Rgb absorption = mix_like_stains(white, vein, share).absorption();
    EXPECT_EQ(absorption[0], 0);
    EXPECT_EQ(absorption[1] > 0, share > 0);
    EXPECT_NEAR(absorption[2], 0.1 * std::pow(3, share), 1e-5);
  }
}

TEST(ProceduralSample, BumpsAreNoHeightFieldAndTheirNormalsPointIntoFreeSpace) {
  const MaterialSample sample = make_procedural_sample(bumps(48));
  const Vec3i n = sample.size;
  int overhangs = 0, outwards = 0, inwards = 0;
  for (int y = 0; y < n.y(); ++y)
    for (int x = 0; x < n.x(); ++x) {
      bool material = false;
      for (int z = 0; z < n.z(); ++z) {
        const std::size_t i = sample.index(x, y, z);
        const bool free = sample.kind[i] == VoxelKind::free_space;
        overhangs += free && material;
        material |= !free;
        if (free) {
          EXPECT_EQ(sample.extinction[i].norm(), 0);
          continue;
        }
        if (sample.kind[i] != VoxelKind::surface) {
          EXPECT_EQ(sample.normal[i].norm(), 0);
          continue;
        }
        EXPECT_NEAR(sample.normal[i].norm(), 1, 1e-5);
        // Two voxels along the normal is free space; only below a ball may it be the ground.
        const Vec3i at =
            (Vec3(x + 0.5, y + 0.5, z + 0.5) + 2 * sample.normal[i].cast<double>()).array().floor().cast<int>();
        if (at.z() < 0 || at.z() >= n.z()) continue;
        const std::size_t j = sample.index((at.x() + n.x()) % n.x(), (at.y() + n.y()) % n.y(), at.z());
        ++(sample.kind[j] == VoxelKind::free_space ? outwards : inwards);
      }
    }
  EXPECT_GT(overhangs, 50);
  EXPECT_GT(outwards, 500);
  EXPECT_GT(outwards, 5 * inwards);
}

// Places where free space lies below material.
int count_overhangs(const MaterialSample& sample) {
  int overhangs = 0;
  for (std::size_t i = static_cast<std::size_t>(sample.size.x()) * sample.size.y(); i < sample.voxel_count(); ++i)
    overhangs += sample.kind[i] == VoxelKind::free_space &&
                 sample.kind[i - static_cast<std::size_t>(sample.size.x()) * sample.size.y()] != VoxelKind::free_space;
  return overhangs;
}

// Mean angle between normals and the direction in which free space grows, over the surface.
double mean_cosine_to_free_space(const MaterialSample& sample) {
  double sum = 0;
  int count = 0;
  const Vec3i n = sample.size;
  for (int z = 2; z + 2 < n.z(); ++z)
    for (int y = 0; y < n.y(); ++y)
      for (int x = 0; x < n.x(); ++x) {
        const std::size_t i = sample.index(x, y, z);
        if (sample.kind[i] != VoxelKind::surface) continue;
        Vec3f outside = Vec3f::Zero();
        for (int dz = -2; dz <= 2; ++dz)
          for (int dy = -2; dy <= 2; ++dy)
            for (int dx = -2; dx <= 2; ++dx)
              if (sample.kind[sample.index((x + dx + n.x()) % n.x(), (y + dy + n.y()) % n.y(), z + dz)] ==
                  VoxelKind::free_space)
                outside += Vec3f(dx, dy, dz);
        if (outside.norm() < 5) continue;
        sum += sample.normal[i].dot(outside.normalized());
        ++count;
      }
  return sum / count;
}

TEST(ProceduralSample, GrassAndWeaveOverhangAndTheirNormalsPointIntoFreeSpace) {
  for (const SampleDefinition& definition : {grass(48), weave(48)}) {
    const MaterialSample sample = make_procedural_sample(definition);
    EXPECT_GT(count_overhangs(sample), 100);
    EXPECT_GT(mean_cosine_to_free_space(sample), 0.7);
    // The bottom layer is all ground, so that it can give the core.
    EXPECT_NEAR(bottom_layer_mean(sample).absorption()[0], marble_body().absorption()[0], 1e-5);
  }
}

TEST(ProceduralSample, AWeaveRepeatsAfterOverPlusUnderYarns) {
  // 4 by 4 yarns over 48 texels, 2 over 2 under: moved by one yarn in x and one back in y it is the same.
  const MaterialSample sample = make_procedural_sample(weave(48));
  int differences = 0;
  for (int z = 0; z < sample.size.z(); ++z)
    for (int y = 0; y < 48; ++y)
      for (int x = 0; x < 48; ++x)
        differences += sample.kind[sample.index(x, y, z)] != sample.kind[sample.index((x + 12) % 48, (y + 36) % 48, z)];
  EXPECT_EQ(differences, 0);
  SampleDefinition odd = weave(48);
  std::get<WeavePattern>(odd.pattern).warp_count = 5;
  EXPECT_THROW(make_procedural_sample(odd), InputError);
}

TEST(ProceduralSample, WallsOfCellsFillWhatTheirWidthAndNumberSay) {
  // Voronoi cells of Poisson points have 2.91 λ^{1/3} of wall area a volume, of a near-lattice less (3 for cubes): 4
  // cells across 48 voxels of 0.4 mm are 4.8 mm wide, so 1.2 mm of wall fill up to 3 · 1.2 / 4.8 less what meets at
  // edges.
  const MaterialSample sample = make_procedural_sample(cells(48));
  double wall = 0;
  for (std::size_t i = 0; i < sample.voxel_count(); ++i) wall += sample.material(i).absorption()[1] > 0.1f;
  EXPECT_NEAR(wall / static_cast<double>(sample.voxel_count()), 0.52, 0.08);
}

TEST(ProceduralSample, GrowthRingsStandARingsWidthApart) {
  SampleDefinition definition = wood(96);
  auto& pattern = std::get<WoodPattern>(definition.pattern);
  pattern.waviness = pattern.fibres = pattern.pores = 0;
  pattern.pith_depth = 0;
  const MaterialSample sample = make_procedural_sample(definition);
  // Along y from the pith the radius is 96/π sin(π (y/96 − ½)): between radii 4 and 20 voxels are 3.2 rings of 5
  // voxels.
  std::vector<double> absorption;
  for (int y = 0; y < 96; ++y) absorption.push_back(sample.material(sample.index(7, y, 0)).absorption()[1]);
  int ends = 0;  // where late wood ends and early wood begins
  for (int y = 49; y < 94; ++y) {
    const bool steepest = absorption[y] - absorption[y + 1] > absorption[y - 1] - absorption[y] &&
                          absorption[y] - absorption[y + 1] >= absorption[y + 1] - absorption[y + 2];
    if (!steepest || absorption[y] < 2 * absorption[y + 1]) continue;
    const double radius = 96 / std::numbers::pi * std::sin(std::numbers::pi * ((y + 1) / 96.0 - 0.5));
    EXPECT_NEAR(radius / 5, std::round(radius / 5), 0.2);
    ++ends;
  }
  EXPECT_EQ(ends, 6);
}

TEST(ProceduralSample, FlatSamplesHaveSurfaceVoxelsExactlyOnTop) {
  const MaterialSample sample = make_procedural_sample(layers(16));
  for (int z = 0; z < sample.size.z(); ++z) {
    const std::size_t i = sample.index(3, 5, z);
    EXPECT_EQ(sample.kind[i], z == 0 ? VoxelKind::surface : VoxelKind::interior);
    EXPECT_LT((sample.normal[i] - (z == 0 ? Vec3f(0, 0, -1) : Vec3f(0, 0, 0))).norm(), 1e-6f);
  }
}

TEST(ProceduralSample, RefusesBumpsDeeperThanTheSample) {
  SampleDefinition definition = bumps(48);
  definition.thickness = 2;
  EXPECT_THROW(make_procedural_sample(definition), InputError);
}

MaterialSample constant_sample(int width, int depth, const Material& material, double voxel) {
  SampleDefinition definition;
  definition.width = definition.height = width;
  definition.voxel = voxel;
  definition.thickness = depth * voxel;
  definition.pattern = LayersPattern{{{material, 1}}, 0, 1};
  return make_procedural_sample(definition);
}

TEST(SampleCheck, MeasuresMeanFreePathsOfAConstantSample) {
  const SampleCheck check = check_sample(constant_sample(64, 8, marble_body(), 0.4));
  // Green: σ_a = .0041, σ_t' = 2.6241: ℓ_d = 1/√(3 · .0041 · 2.6241).
  EXPECT_NEAR(check.diffuse_mean_free_path[1], 5.566, 0.01);
  EXPECT_NEAR(check.mean_free_path[0], 1 / 2.1921, 1e-4);
  EXPECT_EQ(check.mesostructure_depth, 0);
  EXPECT_TRUE(check.complaints.empty());
}

TEST(SampleCheck, ComplainsOfSamplesTooNarrowOrTooThin) {
  // 2 ℓ_d in red is 17.0 mm: 40 voxels of 0.4 mm are 16 mm, 43 are 17.2 mm.
  EXPECT_EQ(check_sample(constant_sample(40, 8, marble_body(), 0.4)).complaints.size(), 2u);
  EXPECT_TRUE(check_sample(constant_sample(43, 8, marble_body(), 0.4)).complaints.empty());
  // Three mean free paths in red are 1.369 mm.
  EXPECT_EQ(check_sample(constant_sample(64, 3, marble_body(), 0.4)).complaints.size(), 1u);
  EXPECT_TRUE(check_sample(constant_sample(64, 4, marble_body(), 0.4)).complaints.empty());
}

TEST(SampleCheck, ComplainsOfASeam) {
  MaterialSample sample = constant_sample(48, 8, marble_body(), 0.4);
  for (int z = 0; z < 8; ++z)
    for (int y = 0; y < 48; ++y)
      for (int x = 0; x < 48; ++x) sample.extinction[sample.index(x, y, z)] *= 1 + x / 48.0f;
  const SampleCheck check = check_sample(sample);
  EXPECT_GT(check.seam_x, 10);
  EXPECT_LT(check.seam_y, 1);
  EXPECT_EQ(check.complaints.size(), 1u);
}

TEST(SampleCheck, RefusesImpossibleCoefficients) {
  MaterialSample sample = constant_sample(8, 4, marble_body(), 0.4);
  sample.albedo[17][1] = 1.01f;
  EXPECT_THROW(check_sample(sample), InputError);
  sample.albedo[17][1] = std::nanf("");
  EXPECT_THROW(check_sample(sample), InputError);
}

TEST(BottomLayerMean, AveragesAbsorptionAndScattering) {
  MaterialSample sample = constant_sample(4, 2, marble_body(), 0.4);
  const Material strong = testing::material({0.2f, 0.2f, 0.2f}, {1, 1, 1});
  for (int i = 0; i < 8; ++i) {
    sample.extinction[sample.index(i % 4, i / 4, 1)] = strong.extinction;
    sample.albedo[sample.index(i % 4, i / 4, 1)] = strong.albedo;
  }
  const Material mean = bottom_layer_mean(sample);
  EXPECT_NEAR(mean.absorption()[0], (0.2 + 0.0021) / 2, 1e-5);
  EXPECT_NEAR(mean.scattering()[2], 2, 1e-5);
}

TEST(DiffuseReflectance, MatchesPublishedMeasurementsAndInverts) {
  // [Jensen2001] figure 5 lists .83 .79 .75 for marble beside its coefficients.
  const Rgb color = diffuse_color(marble_body(), 1.5);
  EXPECT_NEAR(color[0], 0.83, 0.05);
  EXPECT_NEAR(color[1], 0.79, 0.05);
  EXPECT_NEAR(color[2], 0.75, 0.05);
  EXPECT_NEAR(diffuse_reflectance(1, 1.3), 1, 1e-12);
  for (double reflectance : {0.01, 0.3, 0.77, 0.99})
    EXPECT_NEAR(diffuse_reflectance(reduced_albedo_of_reflectance(reflectance, 1.4), 1.4), reflectance, 1e-6);
}

}  // namespace
}  // namespace shellgrid
