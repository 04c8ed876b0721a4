// SPDX-License-Identifier: AGPL-3.0-or-later
#include "synthesis/solid_synthesis.h"

#include <gtest/gtest.h>
#include <oneapi/tbb/global_control.h>

#include <algorithm>
#include <cmath>
#include <numeric>

#include "meshing/core/error.h"
#include "meshing/core/random.h"
#include "synthesis/albedo.h"
#include "synthesis/periodic_noise.h"
#include "synthesis/sample_check.h"
#include "synthesis/slice_windows.h"
#include "synthesis/solid_material.h"
#include "tests/synthesis/synthesis_shapes.h"

namespace shellgrid {
namespace {

// A slice of cells of a solid, each of its own grey, between dark walls.
SliceStack cells_view(int size) {
  SampleDefinition definition = testing::cells(size);
  std::get<CellsPattern>(definition.pattern).variation = 1;
  std::get<CellsPattern>(definition.pattern).cells = size / 8;
  std::get<CellsPattern>(definition.pattern).wall_width = 0.8;
  const MaterialSample sample = make_procedural_sample(definition);
  SliceStack stack{size, size, 1, {}};
  for (int i = 0; i < size * size; ++i) {
    const Rgb color = display_color(diffuse_color(sample.material(static_cast<std::size_t>(i)), 1.4)) / 255;
    stack.values.insert(stack.values.end(), {color[0], color[1], color[2]});
  }
  return stack;
}

SolidExemplar same_from_all_sides(const SliceStack& view) {
  SolidExemplar exemplar;
  exemplar.axes = {view, view, view};
  return exemplar;
}

SolidOptions small_options() {
  SolidOptions options;
  options.size = Vec3i(40, 36, 9);
  options.coarse_passes = 6;
  options.fine_passes = 4;
  return options;
}

TEST(SolidSynthesis, LooksLikeItsViewFromAllSidesMoreThanMatchedNoiseOrRandomTexels) {
  const SliceStack view = cells_view(64);
  const SolidExemplar exemplar = same_from_all_sides(view);
  const SolidOptions options = small_options();
  const SolidTexture solid = synthesize_solid(exemplar, options);
  const std::size_t count = static_cast<std::size_t>(options.size.prod());
  // The same colours anywhere: their histogram is right, their order is not. Smoothed noise has the order of its
  // values.
  std::vector<float> random, noise(3 * count);
  for (std::size_t i = 0; i < count; ++i) {
    const std::size_t texel = hash64(3, i) % view.texel_count();
    random.insert(random.end(), view.values.begin() + 3 * texel, view.values.begin() + 3 * (texel + 1));
  }
  const PeriodicNoise field(options.size.x(), options.size.y(), 5);
  std::vector<double> level(count);
  for (std::size_t i = 0; i < count; ++i)
    level[i] = field.fractal(Vec3(i % 40 + 0.5, i / 40 % 36 + 0.5, i / 40 / 36 + 0.5), 5, 2, 1);
  std::vector<std::size_t> order(count), texels(view.texel_count());
  std::iota(order.begin(), order.end(), std::size_t{0});
  std::iota(texels.begin(), texels.end(), std::size_t{0});
  std::sort(order.begin(), order.end(), [&](std::size_t a, std::size_t b) { return level[a] < level[b]; });
  std::stable_sort(texels.begin(), texels.end(),
                   [&](std::size_t a, std::size_t b) { return view.values[3 * a + 1] < view.values[3 * b + 1]; });
  for (std::size_t r = 0; r < count; ++r)
    std::copy_n(view.values.begin() + 3 * texels[r * texels.size() / count], 3, noise.begin() + 3 * order[r]);

  const SolidQuality ours = measure_solid(exemplar, options.size, solid_values(exemplar, solid), 200);
  const SolidQuality matched = measure_solid(exemplar, options.size, noise, 200);
  const SolidQuality drawn = measure_solid(exemplar, options.size, random, 200);
  double ours_in_all = 0, matched_in_all = 0;
  for (int d = 0; d < 3; ++d) {
    ours_in_all += ours.window_distance[d] + ours.coverage_distance[d];
    matched_in_all += matched.window_distance[d] + matched.coverage_distance[d];
    EXPECT_LT(ours.window_distance[d], 0.25 * drawn.window_distance[d]) << d;
    EXPECT_LT(ours.coverage_distance[d], 0.5 * drawn.coverage_distance[d]) << d;
  }
  EXPECT_LT(ours_in_all, 0.9 * matched_in_all);
  EXPECT_LT(ours.histogram_distance, 0.25);
  EXPECT_GT(texel_entropy(exemplar, solid), 0.8);
}

TEST(SolidSynthesis, IsTheSameAtAnyNumberOfThreadsAndAnotherForAnotherSeed) {
  const SolidExemplar exemplar = same_from_all_sides(cells_view(40));
  SolidOptions options = small_options();
  options.size = Vec3i(25, 18, 5);
  const SolidTexture all = synthesize_solid(exemplar, options);
  {
    const oneapi::tbb::global_control one(oneapi::tbb::global_control::max_allowed_parallelism, 1);
    const SolidTexture single = synthesize_solid(exemplar, options);
    EXPECT_EQ(all.axis, single.axis);
    EXPECT_EQ(all.texel, single.texel);
  }
  options.seed = 2;
  EXPECT_NE(all.texel, synthesize_solid(exemplar, options).texel);
}

TEST(SolidSynthesis, TheSeamLooksLikeAnyOtherPlace) {
  const SolidExemplar exemplar = same_from_all_sides(cells_view(64));
  const SolidOptions options = small_options();
  const std::vector<float> values = solid_values(exemplar, synthesize_solid(exemplar, options));
  const Vec3i n = options.size;
  std::vector<double> steps(n.x(), 0.0);
  for (int z = 0; z < n.z(); ++z)
    for (int y = 0; y < n.y(); ++y)
      for (int x = 0; x < n.x(); ++x)
        steps[x] += std::abs(values[3 * ((z * n.y() + y) * n.x() + x)] -
                             values[3 * ((z * n.y() + y) * n.x() + (x + 1) % n.x())]);
  EXPECT_LT(steps.back(), 1.3 * *std::max_element(steps.begin(), steps.end() - 1));
}

TEST(SolidSynthesis, FollowsADifferentViewForEachAxis) {
  // From the side horizontal beds, from above blotches: along z values change, along x and y hardly.
  SliceStack beds{64, 64, 1, {}}, top{64, 64, 1, {}};
  for (int v = 0; v < 64; ++v)
    for (int u = 0; u < 64; ++u) {
      beds.values.push_back(v / 4 % 2 == 0 ? 0.2f : 0.8f);
      top.values.push_back((u / 16 + v / 16) % 2 == 0 ? 0.2f : 0.8f);
    }
  SolidExemplar exemplar;
  exemplar.channels = 1;
  exemplar.axes = {beds, beds, top};
  SolidOptions options = small_options();
  options.size = Vec3i(32, 32, 16);
  const std::vector<float> values = solid_values(exemplar, synthesize_solid(exemplar, options));
  double along_x = 0, along_z = 0;
  for (int z = 0; z + 1 < 16; ++z)
    for (int y = 0; y < 32; ++y)
      for (int x = 0; x < 32; ++x) {
        const float here = values[(z * 32 + y) * 32 + x];
        along_x += std::abs(here - values[(z * 32 + y) * 32 + (x + 1) % 32]);
        along_z += std::abs(here - values[((z + 1) * 32 + y) * 32 + x]);
      }
  EXPECT_GT(along_z, 2 * along_x);
}

TEST(SolidSynthesis, AConstantViewMakesAConstantSolidAndTinyOnesAreRefused) {
  SliceStack constant{16, 12, 1, std::vector<float>(16 * 12 * 3, 0.4f)};
  SolidOptions options = small_options();
  options.size = Vec3i(8, 8, 1);
  const SolidExemplar exemplar = same_from_all_sides(constant);
  for (float value : solid_values(exemplar, synthesize_solid(exemplar, options))) EXPECT_EQ(value, 0.4f);
  SliceStack tiny{7, 9, 1, std::vector<float>(63 * 3, 0.4f)};
  EXPECT_THROW(synthesize_solid(same_from_all_sides(tiny), options), InputError);
  constant.values[5] = NAN;
  EXPECT_THROW(synthesize_solid(same_from_all_sides(constant), options), InputError);
  options.window = 4;
  EXPECT_THROW(synthesize_solid(exemplar, options), InputError);
}

TEST(SolidSynthesis, EnlargesASmallSampleAndMakesItTile) {
  // A part of a sample does not tile; a solid grown from it does, and is of the same stuff.
  SampleDefinition definition = testing::cells(32);
  definition.thickness = 8;
  const MaterialSample small = make_procedural_sample(definition);
  SolidOptions options = small_options();
  options.size = Vec3i(48, 40, 12);
  const SolidExemplar exemplar = exemplar_of_sample(small);
  const MaterialSample grown = material_of_texels(small, synthesize_solid(exemplar, options));
  ASSERT_EQ(grown.size, options.size);
  const SampleCheck check = check_sample(grown), before = check_sample(small);
  EXPECT_LT(check.seam_x, 1.3);
  EXPECT_LT(check.seam_y, 1.3);
  EXPECT_NEAR(check.mean_free_path[1] / before.mean_free_path[1], 1, 0.05);
  EXPECT_THROW(exemplar_of_sample(make_procedural_sample(testing::bumps(24))), InputError);
}

TEST(SliceWindows, TheirFeaturesKeepDistancesAndTheNearestIsFound) {
  const SliceStack view = cells_view(40);
  const SliceWindows windows(view, 3, 5, 4);
  EXPECT_EQ(windows.count(), 36 * 36);
  float distance;
  for (int window : {0, 77, 700}) {
    EXPECT_EQ(windows.nearest(windows.features(window), distance), window);
    EXPECT_EQ(distance, 0);
    // Similar ones are no farther than others that are not next to it.
    const float best = windows.distance(windows.features(window), windows.similar(window)[0]);
    for (int other = 0; other < windows.count(); other += 13) {
      const int du = std::abs(other % 36 - window % 36), dv = std::abs(other / 36 - window / 36);
      if (du > 2 || dv > 2) EXPECT_GE(windows.distance(windows.features(window), other), best);
    }
    EXPECT_EQ(windows.at(windows.centre(window) % 40, windows.centre(window) / 40, 0), window);
  }
  EXPECT_EQ(windows.moved(0, -1, 0, 0), -1);
  EXPECT_EQ(windows.moved(5, 1, 2, 0), 6 + 72);
}

TEST(SolidMaterial, AColourComesBackAsItsReflectance) {
  ColorMaterial matter;
  matter.extinction = Rgb(2, 3, 4);
  matter.anisotropy = Rgb(0, 0.5f, -0.3f);
  const ReflectanceInversion inversion(matter.model, 1.4);
  const Rgb color(0.2f, 0.5f, 0.99f);
  const Material material = material_of_color(color, matter, inversion);
  for (int c = 0; c < 3; ++c)
    EXPECT_NEAR(half_space_reflectance(material.reduced_albedo()[c], 1.4), std::min(color[c], 0.95f), 1e-4);
  EXPECT_EQ(material.extinction[2], 4);
}

}  // namespace
}  // namespace shellgrid
