// SPDX-License-Identifier: AGPL-3.0-or-later
// Geometry at the ends of its ranges: units, needles, thin walls.
#include <gtest/gtest.h>

#include <cmath>

#include "meshing/core/error.h"
#include "meshing/distance/distance_field.h"
#include "meshing/surface/prepare_surface.h"
#include "tests/support/closed_shapes.h"

namespace shellgrid {
namespace {

TriangleMesh scaled(TriangleMesh mesh, double scale) {
  mesh.vertices *= scale;
  return mesh;
}

// Volume inside, counted in samples.
std::int64_t inside_samples(const DistanceField& field) {
  std::int64_t inside = 0;
  field.distance.for_each_active([&](int, int, int, float distance) { inside += distance < 0; });
  return inside;
}

TEST(GeometryStress, DistancesScaleWithTheUnit) {
  const TriangleMesh shape = shapes::rotated(shapes::torus(10, 4, 40, 20), 5);
  DistanceStatistics statistics;
  const DistanceField one = compute_distance_field(shape, {0.5, 2, 1}, statistics);
  const auto active = static_cast<double>(one.distance.active_count());
  for (double unit : {1e-6, 1e-3, 1e3, 1e6}) {
    const DistanceField other = compute_distance_field(scaled(shape, unit), {0.5 * unit, 2 * unit, unit}, statistics);
    EXPECT_NEAR(static_cast<double>(other.distance.active_count()) / active, 1, 0.01) << unit;
    EXPECT_NEAR(static_cast<double>(inside_samples(other)) / static_cast<double>(inside_samples(one)), 1, 0.01) << unit;
  }
}

TEST(GeometryStress, SignsHoldInNeedlesAndThinWalls) {
  const auto volume_in_band = [](const TriangleMesh& mesh, double voxel) {
    DistanceStatistics statistics;
    const DistanceField field = compute_distance_field(mesh, {voxel, 50, 2 * voxel}, statistics);
    return static_cast<double>(inside_samples(field)) * voxel * voxel * voxel;
  };
  // Needles a few voxels thick: what is inside, by count, is their volume.
  const TriangleMesh needle = shapes::rotated(shapes::double_cone(3, 1, 20, 20), 3);
  const double exact = 3 * std::sqrt(3.0) / 4 * 40 / 3;
  EXPECT_NEAR(volume_in_band(needle, 0.1), exact, 0.03 * exact);
  const TriangleMesh wall = shapes::rotated(shapes::box(Vec3(10, 10, 0.25)), 9);
  EXPECT_NEAR(volume_in_band(wall, 0.1), 25, 0.03 * 25);
  // A wall far thinner than a voxel: no sample beside it may be inside.
  EXPECT_NEAR(volume_in_band(shapes::rotated(shapes::box(Vec3(10, 10, 1e-4)), 9), 0.1), 0, 0.1);
}

TEST(GeometryStress, PreparingDoesNotDependOnTheUnit) {
  const TriangleMesh shape = shapes::torus(10, 4, 48, 24);
  PrepareOptions options;
  options.size = 28;
  options.spacing = 1;
  const PreparedSurface one = prepare_surface(shape, options);
  for (double unit : {1e-6, 1e-3, 1e3, 1e6}) {
    const PreparedSurface other = prepare_surface(scaled(shape, unit), options);
    EXPECT_EQ(other.genus, 1) << unit;
    EXPECT_NEAR(other.volume / one.volume, 1, 1e-3) << unit;
    EXPECT_NEAR(static_cast<double>(other.mesh.vertex_count()) / one.mesh.vertex_count(), 1, 0.02) << unit;
  }
}

TEST(GeometryStress, PreparesNeedleTrianglesEvenly) {
  // A fan of a thousand needles at each tip.
  PrepareOptions options;
  options.size = 20;
  options.spacing = 0.8;
  const PreparedSurface surface = prepare_surface(shapes::double_cone(1000, 10, 8, 8), options);
  EXPECT_EQ(surface.genus, 0);
  EXPECT_NEAR(surface.edges.mean, options.spacing, 0.1 * options.spacing);
  EXPECT_LT(surface.from_input, 0.5 * options.spacing);
}

}  // namespace
}  // namespace shellgrid
