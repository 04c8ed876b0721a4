// SPDX-License-Identifier: AGPL-3.0-or-later
#include "synthesis/shell_core.h"

#include <gtest/gtest.h>
#include <oneapi/tbb/global_control.h>

#include "meshing/core/error.h"
#include "synthesis/core_voxels.h"
#include "tests/synthesis/synthesis_shapes.h"

namespace shellgrid {
namespace {

constexpr double voxel = 0.5, thickness = 1.5;

// A ball, hollow or not, whose shell has the matter that a function of place says.
struct Ball {
  DistanceField distance;
  ShellVolume shell;

  template <class Matter>
  explicit Ball(const Matter& matter, double radius = 7, double free_above = 1e9) {
    DistanceOptions options;
    options.voxel = voxel;
    options.inside_band = thickness + 2 * voxel;
    options.outside_band = voxel;
    DistanceStatistics statistics;
    distance = compute_distance_field(testing::sphere(radius, 4), options, statistics);
    shell.frame = distance.frame;
    shell.thickness = thickness;
    shell.ior = 1.4;
    const TwoLevelGrid<Vec3f> empty(distance.distance.lower_leaf(), distance.distance.leaf_counts(), Vec3f::Zero());
    shell.texture_coordinate = shell.extinction = shell.albedo = shell.anisotropy = shell.normal = empty;
    shell.kind = TwoLevelGrid<std::int32_t>(empty.lower_leaf(), empty.leaf_counts(), 1);
    distance.distance.for_each_active([&](int i, int j, int k, float d) {
      if (d > 0 || d < -thickness) return;
      const Material m = matter(shell.frame.to_world(Vec3i(i, j, k)));
      shell.texture_coordinate.set(i, j, k, Vec3f(0, 0, static_cast<float>(-d / voxel)));
      shell.extinction.set(i, j, k, m.extinction.matrix());
      shell.albedo.set(i, j, k, m.albedo.matrix());
      shell.anisotropy.set(i, j, k, m.anisotropy.matrix());
      shell.normal.set(i, j, k, Vec3f::Zero());
      shell.kind.set(i, j, k, shell.frame.to_world(Vec3i(i, j, k)).z() > free_above ? 0 : 1);
    });
  }
  Material at(int i, int j, int k) const {
    return {shell.extinction.value(i, j, k).array(), shell.albedo.value(i, j, k).array(),
            shell.anisotropy.value(i, j, k).array()};
  }
  template <class Visit>
  long for_each_core_voxel(const Visit& visit) const {
    long count = 0;
    shell.kind.for_each_active([&](int i, int j, int k, std::int32_t kind) {
      if (kind != core_voxel_kind) return;
      ++count;
      visit(i, j, k);
    });
    return count;
  }
};

const auto marble_everywhere = [](const Vec3&) { return testing::marble_body(); };

TEST(ShellCore, IsEveryGridPointInsideAndNoOther) {
  constexpr double radius = 14;
  Ball ball(marble_everywhere, radius);
  CoreStatistics statistics;
  fill_core_by_mean_values(ball.shell, ball.distance, 500, &statistics);
  long expected = 0;
  for (int i = -32; i <= 32; ++i)
    for (int j = -32; j <= 32; ++j)
      for (int k = -32; k <= 32; ++k) {
        const double r = ball.shell.frame.to_world(Vec3i(i, j, k)).norm();
        if (r < radius - 0.05) {
          EXPECT_TRUE(ball.shell.extinction.is_active(i, j, k));
        }
        if (r > radius) {
          EXPECT_FALSE(ball.shell.extinction.is_active(i, j, k));
        }
        expected += r < radius - thickness;
      }
  EXPECT_NEAR(static_cast<double>(statistics.voxels), static_cast<double>(expected), 0.03 * expected);
  // Leaves that the shell has are there already.
  EXPECT_GT(statistics.bytes, 15 * static_cast<std::size_t>(statistics.voxels));
  EXPECT_LE(statistics.boundary_triangles, 500);
}

TEST(ShellCore, AConstantBottomGivesTheConstant) {
  Ball ball(marble_everywhere);
  fill_core_by_mean_values(ball.shell, ball.distance);
  const long count = ball.for_each_core_voxel([&](int i, int j, int k) {
    const Material m = ball.at(i, j, k);
    EXPECT_LT((m.extinction / testing::marble_body().extinction - 1).abs().maxCoeff(), 1e-5);
    EXPECT_LT((m.albedo / testing::marble_body().albedo - 1).abs().maxCoeff(), 1e-5);
  });
  EXPECT_GT(count, 3000);
}

TEST(ShellCore, ALinearCourseGoesOnThroughTheCore) {
  const auto linear = [](const Vec3& p) {
    return testing::material(Rgb::Constant(static_cast<float>(0.1 + 0.01 * p.x())),
                             Rgb::Constant(static_cast<float>(2 + 0.1 * p.y() - 0.05 * p.z())));
  };
  Ball ball(linear);
  fill_core_by_mean_values(ball.shell, ball.distance, 4000);
  double worst = 0, worst_absorption = 0;
  ball.for_each_core_voxel([&](int i, int j, int k) {
    const Vec3 p = ball.shell.frame.to_world(Vec3i(i, j, k));
    const Material m = ball.at(i, j, k), expected = linear(p);
    worst = std::max<double>(worst, (m.scattering() - expected.scattering()).abs().maxCoeff());
    worst_absorption = std::max<double>(worst_absorption, (m.absorption() - expected.absorption()).abs().maxCoeff());
  });
  // Blocks of two voxels share a value, and the bottom's means lie half a voxel and more above the core: 0.7 mm at
  // 0.11 mm⁻² and 0.01 mm⁻².
  EXPECT_LT(worst, 0.08);
  EXPECT_LT(worst_absorption, 0.008);
  EXPECT_GT(worst, 0);
}

TEST(ShellCore, NeedsMatterAtTheShellsBottom) {
  Ball ball(marble_everywhere, 7, -100);
  EXPECT_THROW(fill_core_by_mean_values(ball.shell, ball.distance), InputError);
}

TEST(ShellCore, AThickShellLeavesNoCore) {
  Ball ball(marble_everywhere, 1.4);
  CoreStatistics statistics;
  fill_core_by_mean_values(ball.shell, ball.distance, 500, &statistics);
  EXPECT_EQ(statistics.voxels, 0);
  EXPECT_EQ(statistics.bytes, 0);
  SampleDefinition definition = testing::marble(16);
  definition.voxel = voxel;
  fill_core_with_solid(ball.shell, ball.distance, make_procedural_sample(definition), {}, &statistics);
  EXPECT_EQ(statistics.voxels, 0);
}

MaterialSample solid() {
  SampleDefinition definition = testing::cells(24);
  definition.voxel = voxel;
  definition.thickness = 12;
  return make_procedural_sample(definition);
}

// The shell shows another part of the same solid.
Material shifted(const MaterialSample& sample, const Vec3& p) {
  const Vec3i n = sample.size;
  const auto wrapped = [](double x, int size) { return ((static_cast<int>(std::lround(x)) % size) + size) % size; };
  return sample.material(sample.index(wrapped(p.x() / voxel + 7, n.x()), wrapped(p.y() / voxel + 11, n.y()),
                                      wrapped(std::abs(p.z() / voxel + 5), n.z())));
}

TEST(ShellCore, ASolidGoesOnBelowTheShellWithItsOwnStatistics) {
  const MaterialSample sample = solid();
  Ball ball([&](const Vec3& p) { return shifted(sample, p); });
  CoreStatistics statistics;
  fill_core_with_solid(ball.shell, ball.distance, sample, {}, &statistics);
  // As smooth below the shell as it is inside itself, nearly; a core that only tiles is not.
  EXPECT_GT(statistics.tiling_step, 2.5 * statistics.sample_step);
  EXPECT_LT(statistics.shell_step, 1.6 * statistics.sample_step);

  EXPECT_GT(statistics.synthesized_voxels, 1000);
  const auto moments = [](double sum, double square, double count) {
    return Vec2(sum / count, std::sqrt(square / count - sum / count * (sum / count)));
  };
  double sum = 0, square = 0;
  const long count = ball.for_each_core_voxel([&](int i, int j, int k) {
    const double x = ball.at(i, j, k).reduced_extinction()[1];
    sum += x, square += x * x;
  });
  const Vec2 core = moments(sum, square, static_cast<double>(count));
  sum = square = 0;
  for (std::size_t i = 0; i < sample.voxel_count(); ++i) {
    const double x = sample.material(i).reduced_extinction()[1];
    sum += x, square += x * x;
  }
  const Vec2 own = moments(sum, square, static_cast<double>(sample.voxel_count()));
  EXPECT_NEAR(core.x(), own.x(), 0.2 * own.y());
  EXPECT_NEAR(core.y(), own.y(), 0.15 * own.y());
}

TEST(ShellCore, EachSolidVoxelIsOneOfTheSolids) {
  const MaterialSample sample = solid();
  Ball ball([&](const Vec3& p) { return shifted(sample, p); });
  fill_core_with_solid(ball.shell, ball.distance, sample, {});
  std::map<std::array<float, 6>, int> known;
  const auto key = [](const Material& m) {
    return std::array<float, 6>{m.extinction[0], m.extinction[1], m.extinction[2],
                                m.albedo[0],     m.albedo[1],     m.albedo[2]};
  };
  for (std::size_t i = 0; i < sample.voxel_count(); ++i) ++known[key(sample.material(i))];
  ball.for_each_core_voxel([&](int i, int j, int k) { EXPECT_TRUE(known.count(key(ball.at(i, j, k)))); });
}

TEST(ShellCore, SameAtAnyThreadCount) {
  const MaterialSample sample = solid();
  const auto run = [&](int threads, bool with_solid) {
    const oneapi::tbb::global_control limit(oneapi::tbb::global_control::max_allowed_parallelism, threads);
    Ball ball([&](const Vec3& p) { return shifted(sample, p); });
    if (with_solid)
      fill_core_with_solid(ball.shell, ball.distance, sample, {});
    else
      fill_core_by_mean_values(ball.shell, ball.distance, 500);
    return ball;
  };
  for (const bool with_solid : {false, true}) {
    const Ball one = run(1, with_solid), three = run(3, with_solid);
    one.shell.extinction.for_each_active(
        [&](int i, int j, int k, const Vec3f& value) { ASSERT_EQ(value, three.shell.extinction.value(i, j, k)); });
  }
}

TEST(ShellCore, RefusesSolidsThatDoNotFit) {
  Ball ball(marble_everywhere);
  SampleDefinition definition = testing::marble(16);
  EXPECT_THROW(fill_core_with_solid(ball.shell, ball.distance, make_procedural_sample(definition), {}), InputError);
  MaterialSample hollow = solid();
  hollow.kind[hollow.index(3, 3, hollow.size.z() - 1)] = VoxelKind::free_space;
  EXPECT_THROW(fill_core_with_solid(ball.shell, ball.distance, hollow, {}), InputError);
}

}  // namespace
}  // namespace shellgrid
