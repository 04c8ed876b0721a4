// SPDX-License-Identifier: AGPL-3.0-or-later
#include "meshing/surface/rewrap.h"

#include <gtest/gtest.h>

#include <algorithm>

#include "meshing/core/error.h"
#include "meshing/core/held_warnings.h"
#include "meshing/core/random.h"
#include "meshing/surface/prepare_surface.h"
#include "tests/support/closed_shapes.h"

namespace shellgrid {
namespace {

// A ball with a missing cap.
TriangleMesh open_ball() {
  const TriangleMesh ball = shapes::sphere(1, 3);
  TriangleMesh open = ball;
  Eigen::Index kept = 0;
  for (Eigen::Index f = 0; f < ball.faces.rows(); ++f)
    if (ball.corner(static_cast<int>(f), 0).z() < 0.97) open.faces.row(kept++) = ball.faces.row(f);
  open.faces.conservativeResize(kept, 3);
  return open;
}

// Triangles through each other, with doubled, turned and degenerate ones among them.
TriangleMesh heap() {
  TriangleMesh mesh =
      shapes::joined(shapes::rotated(shapes::box({2, 1, 1}), 1), shapes::rotated(shapes::box({1, 2, 1}), 2));
  mesh = shapes::joined(mesh, shapes::moved(open_ball(), {0.4, 0, 0}));
  RandomStream random(5);
  for (Eigen::Index f = 0; f < mesh.faces.rows(); ++f)
    if (random.next() < 0.5) std::swap(mesh.faces(f, 0), mesh.faces(f, 1));
  const Eigen::Index faces = mesh.faces.rows();
  mesh.faces.conservativeResize(faces + 3, 3);
  mesh.faces.row(faces) = mesh.faces.row(0);
  mesh.faces.row(faces + 1) << 0, 0, 1;
  mesh.faces.row(faces + 2) << 0, 5, 12;
  return mesh;
}

void expect_wraps(const TriangleMesh& mesh, double resolution) {
  RewrapReport report;
  const TriangleMesh wrap = rewrap_surface(mesh, resolution, report);
  EXPECT_NO_THROW(require_closed_surface(wrap));
  EXPECT_EQ(find_self_intersections(wrap).pairs, 0);
  EXPECT_LT(report.to_input, resolution);
  EXPECT_GT(report.to_input, 0);
  EXPECT_EQ(report.resolution, resolution);
}

TEST(Rewrap, MakesASurfaceOfAnything) {
  expect_wraps(open_ball(), 0.3);
  expect_wraps(heap(), 0.1);
  // Two boxes that share an edge, which then has four faces.
  expect_wraps(shapes::joined(shapes::moved(shapes::box({2, 2, 2}), {-1, -1, 0}),
                              shapes::moved(shapes::box({2, 2, 2}), {1, 1, 0})),
               0.2);
}

TEST(Rewrap, OfASolidKeepsItsVolume) {
  const TriangleMesh torus = shapes::torus(2, 0.7, 60, 30);
  RewrapReport report;
  const TriangleMesh wrap = rewrap_surface(torus, 0.2, report);
  EXPECT_EQ(genus(wrap), 1);
  EXPECT_NEAR(enclosed_volume(wrap), enclosed_volume(torus), 0.05 * enclosed_volume(torus));
  EXPECT_LT(report.from_input, 0.05);
}

TEST(Rewrap, IsTheSameAtEverySize) {
  const TriangleMesh shape = heap();
  RewrapReport one, small;
  const TriangleMesh wrap = rewrap_surface(shape, 0.25, one);
  TriangleMesh shrunk = shape;
  shrunk.vertices *= 0x1p-20;
  const TriangleMesh shrunk_wrap = rewrap_surface(shrunk, 0.25 * 0x1p-20, small);
  EXPECT_EQ(wrap.faces, shrunk_wrap.faces);
  EXPECT_EQ(wrap.vertices, (shrunk_wrap.vertices * 0x1p20).eval());
}

TEST(Rewrap, LeavesOutLesserPartsAndSaysSo) {
  RewrapReport report;
  const TriangleMesh wrap = rewrap_surface(
      shapes::joined(shapes::sphere(1, 3), shapes::moved(shapes::sphere(0.5, 3), {3, 0, 0})), 0.2, report);
  EXPECT_EQ(report.dropped_components, 1);
  EXPECT_NEAR(report.dropped_volume, 1.0 / 9, 0.01);
  EXPECT_NEAR(enclosed_volume(wrap), 4.0 / 3 * std::numbers::pi, 0.3);
}

TEST(Rewrap, WarnsWhereItFillsACavity) {
  const TriangleMesh ball = shapes::sphere(1, 4);
  TriangleMesh hollow = shapes::sphere(0.5, 3);
  hollow = shapes::joined(ball, shapes::turned_around(hollow));
  for (const bool has_cavity : {false, true}) {
    HeldWarnings progress(no_progress());
    prepare_surface(has_cavity ? hollow : ball, {.size = 20, .spacing = 1, .rewrap_share = 0.05}, progress);
    const auto says_so = [](const std::string& warning) { return warning.find("cavities") != std::string::npos; };
    EXPECT_EQ(std::any_of(progress.warnings.begin(), progress.warnings.end(), says_so), has_cavity);
  }
}

TEST(Rewrap, TakesTheInputsPlaceInPreparing) {
  const PreparedSurface result = prepare_surface(heap(), {.size = 20, .spacing = 1, .rewrap_share = 0.05});
  EXPECT_NO_THROW(require_closed_surface(result.mesh));
  EXPECT_EQ(find_self_intersections(result.mesh).pairs, 0);
  EXPECT_NEAR(result.rewrap.resolution, 1, 0.05);
  EXPECT_LT(result.rewrap.to_input, 1);
  EXPECT_NEAR(result.edges.mean, 1, 0.03);
}

TEST(Rewrap, RefusesWhatCannotBeWrapped) {
  RewrapReport report;
  EXPECT_THROW(rewrap_surface(TriangleMesh{}, 0.1, report), InputError);
  EXPECT_THROW(rewrap_surface(heap(), 1e-6, report), InputError);
  EXPECT_THROW(rewrap_surface(heap(), 10, report), InputError);
  TriangleMesh point = shapes::box({1, 1, 1});
  point.vertices.setZero();
  EXPECT_THROW(rewrap_surface(point, 0.1, report), InputError);
}

}  // namespace
}  // namespace shellgrid
