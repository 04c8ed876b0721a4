// SPDX-License-Identifier: AGPL-3.0-or-later
#include "synthesis/shell_resampling.h"

#include <gtest/gtest.h>
#include <oneapi/tbb/global_control.h>

#include <Eigen/Geometry>

#include "meshing/core/error.h"
#include "meshing/surface/half_edges.h"
#include "synthesis/sample_check.h"
#include "tests/synthesis/synthesis_shapes.h"

namespace shellgrid {
namespace {

constexpr double voxel = 0.4, radius = 6, thickness = 2;

// The exact distance field of a sphere, and a coordinate for each vertex of a mesh of it.
struct Scene {
  TexturedMesh mesh;
  DistanceField distance;
  MaterialSample sample;

  explicit Scene(const SampleDefinition& definition) : sample(make_procedural_sample(definition)) {
    mesh.mesh = testing::sphere(radius, 4);
    mesh.normals = vertex_normals(mesh.mesh);
    const int n = mesh.mesh.vertex_count();
    mesh.directions.resize(n, 3);
    mesh.coordinate.resize(n);
    for (int v = 0; v < n; ++v) {
      const Vec3 normal = mesh.normals.row(v).transpose();
      mesh.directions.row(v) = (normal.cross(Vec3(0.1, 0.2, 1.7)).normalized()).transpose();
      mesh.coordinate[v] = Vec2f(static_cast<float>(v) * 0.37f, static_cast<float>(v) * 1.91f);
    }
    distance.frame = {Vec3(0.05, 0.02, -0.03), voxel};
    distance.inside_band = 3;
    distance.outside_band = 0.8;
    const Vec3i lower = Vec3i::Constant(-3), counts = Vec3i::Constant(6);
    distance.distance = TwoLevelGrid<float>(lower, counts, 0.8f);
    distance.nearest_vertex = TwoLevelGrid<std::int32_t>(lower, counts, -1);
    distance.nearest_point = TwoLevelGrid<Vec3f>(lower, counts, Vec3f::Zero());
    for (int i = -20; i <= 20; ++i)
      for (int j = -20; j <= 20; ++j)
        for (int k = -20; k <= 20; ++k) {
          const Vec3 p = distance.frame.to_world(Vec3i(i, j, k));
          const double d = p.norm() - radius;
          if (d < -3 || d > 0.8) continue;
          Eigen::Index nearest = 0;
          (mesh.mesh.vertices * p).maxCoeff(&nearest);
          distance.distance.set(i, j, k, static_cast<float>(d));
          distance.nearest_vertex.set(i, j, k, static_cast<std::int32_t>(nearest));
          distance.nearest_point.set(i, j, k, (radius * p.normalized()).cast<float>());
        }
  }
  ShellVolume shell(ShellStatistics* statistics = nullptr,
                    ShellCoordinates coordinates = ShellCoordinates::nearest) const {
    return resample_shell(mesh, distance, {&sample}, bottom_layer_mean(sample), thickness, coordinates, statistics);
  }
};

TEST(ShellResampling, HoldsExactlyTheGridPointsInsideTheShell) {
  const Scene scene(testing::marble(32));
  ShellStatistics statistics;
  const ShellVolume shell = scene.shell(&statistics);
  long expected = 0;
  scene.distance.distance.for_each_active([&](int i, int j, int k, float d) {
    const bool inside = d <= 0 && d >= -thickness;
    expected += inside;
    EXPECT_EQ(shell.extinction.is_active(i, j, k), inside);
    EXPECT_EQ(shell.kind.is_active(i, j, k), inside);
  });
  EXPECT_EQ(statistics.voxels, expected);
  EXPECT_GT(expected, 5000);
  EXPECT_LT(statistics.leaves, statistics.possible_leaves);
  for (int leaf = 0; leaf < shell.extinction.leaf_count(); ++leaf) {
    bool any = false;
    for (std::uint64_t word : shell.extinction.leaf_mask(leaf)) any |= word != 0;
    EXPECT_TRUE(any) << "a leaf without shell voxels";
  }
}

TEST(ShellResampling, EveryVoxelIsTheSamplesAtItsCoordinate) {
  const Scene scene(testing::bumps(32));
  const ShellVolume shell = scene.shell();
  const Vec3i n = scene.sample.size;
  shell.texture_coordinate.for_each_active([&](int i, int j, int k, const Vec3f& t) {
    const float d = scene.distance.distance.value(i, j, k);
    const int vertex = scene.distance.nearest_vertex.value(i, j, k);
    EXPECT_EQ(t.x(), scene.mesh.coordinate[vertex].x());
    EXPECT_EQ(t.y(), scene.mesh.coordinate[vertex].y());
    EXPECT_NEAR(t.z(), -d / voxel, 1e-4);
    const std::size_t at = scene.sample.index(static_cast<int>(t.x()) % n.x(), static_cast<int>(t.y()) % n.y(),
                                              std::min(n.z() - 1, static_cast<int>(t.z())));
    EXPECT_EQ(shell.extinction.value(i, j, k), scene.sample.extinction[at]);
    EXPECT_EQ(shell.albedo.value(i, j, k), scene.sample.albedo[at]);
    EXPECT_EQ(shell.kind.value(i, j, k), static_cast<int>(scene.sample.kind[at]));
    const bool surface = scene.sample.kind[at] == VoxelKind::surface;
    EXPECT_NEAR(shell.normal.value(i, j, k).norm(), surface ? 1 : 0, 1e-5);
    if (surface) {
      // The sample's upward component is the one along the mesh's normal.
      const float upward =
          static_cast<float>(scene.mesh.normals.row(vertex).dot(shell.normal.value(i, j, k).cast<double>()));
      EXPECT_NEAR(upward, -scene.sample.normal[at].z(), 1e-5);
    }
  });
}

TEST(ShellResampling, AConstantSampleGivesAConstantShell) {
  SampleDefinition definition = testing::layers(16);
  definition.pattern = LayersPattern{{{testing::marble_body(), 1}}, 0, 1};
  const Scene scene(definition);
  const ShellVolume shell = scene.shell();
  shell.extinction.for_each_active([&](int, int, int, const Vec3f& extinction) {
    EXPECT_EQ(extinction, Vec3f(testing::marble_body().extinction.matrix()));
  });
  EXPECT_NEAR((shell.core.extinction - testing::marble_body().extinction).abs().maxCoeff(), 0, 1e-5);
}

TEST(ShellResampling, SameAtAnyThreadCount) {
  const Scene scene(testing::marble(32));
  const auto run = [&](int threads) {
    const oneapi::tbb::global_control limit(oneapi::tbb::global_control::max_allowed_parallelism, threads);
    return scene.shell();
  };
  const ShellVolume one = run(1), three = run(3);
  ASSERT_EQ(one.extinction.leaf_count(), three.extinction.leaf_count());
  for (int leaf = 0; leaf < one.extinction.leaf_count(); ++leaf)
    for (int s = 0; s < 512; ++s) ASSERT_EQ(one.extinction.leaf_values(leaf)[s], three.extinction.leaf_values(leaf)[s]);
}

TEST(ShellResampling, RefusesInputsThatDoNotBelongTogether) {
  Scene scene(testing::marble(32));
  scene.sample.voxel = 0.5;
  EXPECT_THROW(scene.shell(), InputError);
  scene.sample.voxel = voxel;
  scene.distance.inside_band = 1;
  EXPECT_THROW(scene.shell(), InputError);
  scene.distance.inside_band = 3;
  scene.distance.nearest_vertex.set(0, 0, 14, 1 << 20);
  scene.distance.distance.set(0, 0, 14, -0.2f);
  EXPECT_THROW(scene.shell(), InputError);
}

}  // namespace
}  // namespace shellgrid
