// SPDX-License-Identifier: AGPL-3.0-or-later
#include "solvers/diffusion/crease_split.h"

#include <gtest/gtest.h>

#include <cmath>

#include "solvers/diffusion/polygrid_diffusion.h"
#include "solvers/diffusion/surface_transfer.h"
#include "solvers/scattering/fresnel.h"
#include "tests/support/closed_shapes.h"
#include "tests/support/diffusion_problem.h"

namespace shellgrid {
namespace {

TEST(CreaseSplit, ASmoothSurfaceStaysAsItIs) {
  const TriangleMesh ball = shapes::sphere(5, 3);
  const CreaseSplit split(ball);
  EXPECT_EQ(split.mesh().faces, ball.faces);
  EXPECT_EQ(split.places(), ball.vertices);
  std::vector<Rgb> values;
  for (int v = 0; v < ball.vertex_count(); ++v) values.push_back(Rgb::Constant(0.1f * static_cast<float>(v)));
  const std::vector<Rgb> merged = split.merge(values);
  for (std::size_t v = 0; v < values.size(); ++v) ASSERT_EQ(merged[v][0], values[v][0]);
}

TEST(CreaseSplit, ABoxFallsIntoItsSixFaces) {
  const TriangleMesh box = shapes::box(Vec3(3, 4, 5));
  const CreaseSplit split(box);
  ASSERT_EQ(box.vertex_count(), 8);
  ASSERT_EQ(split.mesh().vertex_count(), 24);
  EXPECT_EQ(split.mesh().vertices.topRows(8), box.vertices);
  for (int f = 0; f < box.face_count(); ++f)
    for (int k = 0; k < 3; ++k) EXPECT_EQ(split.mesh().corner(f, k), box.corner(f, k));
  // Each copy's values come from its own face, off the edges; vertices get means over faces.
  std::vector<Rgb> of_axis(24, Rgb::Zero());
  for (int f = 0; f < box.face_count(); ++f) {
    const Vec3 a = box.corner(f, 0), normal = (box.corner(f, 1) - a).cross(box.corner(f, 2) - a);
    int axis;
    normal.cwiseAbs().maxCoeff(&axis);
    for (int k = 0; k < 3; ++k) {
      const int v = split.mesh().faces(f, k);
      of_axis[v] = Rgb::Zero();
      of_axis[v][axis] = 1;
      EXPECT_NEAR(split.places()(v, axis), a[axis], 1e-12);
      for (int other = 0; other < 3; ++other)
        if (other != axis) EXPECT_GT(std::abs(split.places()(v, other) - box.vertices(box.faces(f, k), other)), 0.1);
    }
  }
  // ∫ of a field is kept: one axis' faces have ab of the area.
  const Eigen::Array3d total = surface_integral(box, split.merge(of_axis));
  EXPECT_NEAR(total[0], 2 * 4 * 5, 1e-5);
  EXPECT_NEAR(total[1], 2 * 3 * 5, 1e-5);
  EXPECT_NEAR(total[2], 2 * 3 * 4, 1e-5);
}

TEST(CreaseSplit, EdgesOfThreeFacesAndFacesWithoutAreaDoNoHarm) {
  TriangleMesh fan;
  fan.vertices.resize(6, 3);
  fan.vertices << 0, 0, 0, 1, 0, 0, 0, 1, 0, 0, -1, 0.1, 0, 0, 1, 0.5, 0, 0;
  fan.faces.resize(4, 3);
  fan.faces << 0, 1, 2, 1, 0, 3, 0, 1, 4, 0, 1, 5;
  const CreaseSplit split(fan);
  EXPECT_GE(split.mesh().vertex_count(), 6);
  EXPECT_TRUE(split.places().allFinite());
  for (const Rgb& value : split.merge(std::vector<Rgb>(split.mesh().vertex_count(), Rgb::Ones())))
    EXPECT_TRUE(value.isFinite().all());
}

// Light on one face of a cube stays on it: what enters is exact, and faces that turn away get none.
TEST(CreaseSplit, LightEndsAtTheEdgeOfItsFace) {
  const double edge = 10, ior = 1.5;
  const Polygrid grid = test::cube_grid(16, edge, 0.1);
  TriangleMesh cube = shapes::box(Vec3::Constant(edge));
  cube.vertices.rowwise() -= cube.vertices.colwise().minCoeff().eval();
  const Vec3 direction = Vec3(0, -0.6, -0.8);
  const DiffusionResult r = solve_polygrid_diffusion(grid, cube, test::grey_material({0.01, 2}), ior,
                                                     {DirectionalLight{direction, Rgb::Ones()}}, {});
  double expected = 0;
  for (const double cosine : {0.6, 0.8}) expected += edge * edge * cosine * fresnel_transmittance(cosine, ior);
  EXPECT_NEAR(r.surface_entering[0], expected, 1e-4 * expected);
  EXPECT_NEAR(r.energy.entering[0], expected, 0.01 * expected);
  for (int v = 0; v < cube.vertex_count(); ++v)
    if (cube.vertices(v, 1) < 1 && cube.vertices(v, 2) < 1) EXPECT_EQ(r.irradiance[v][0], 0);
}

}  // namespace
}  // namespace shellgrid
