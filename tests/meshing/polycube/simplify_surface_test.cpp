// SPDX-License-Identifier: AGPL-3.0-or-later
#include <gtest/gtest.h>

#include <cmath>

#include "meshing/core/error.h"
#include "meshing/polycube/tetrahedralize.h"
#include "meshing/surface/repair.h"
#include "tests/support/closed_shapes.h"

namespace shellgrid {
namespace {

TEST(SimplifySurface, keeps_topology_and_volume_whatever_the_unit) {
  for (const double unit : {1e-3, 1.0, 1e6}) {
    TriangleMesh surface = shapes::rotated(shapes::torus(10, 3, 160, 80), 3);
    surface.vertices *= unit;
    surface.vertices.rowwise() += 100 * unit * Eigen::RowVector3d(1, 2, 3);
    const TriangleMesh simple = simplify_surface(surface, 2000);
    require_closed_surface(simple);
    EXPECT_LE(simple.face_count(), 2000);
    EXPECT_GE(simple.face_count(), 1998);
    EXPECT_EQ(genus(simple), 1);
    EXPECT_NEAR(enclosed_volume(simple) / enclosed_volume(surface), 1, 0.005) << unit;
    // Each vertex stays near the torus.
    double farthest = 0;
    for (int v = 0; v < simple.vertex_count(); ++v) {
      double nearest = 1e300;
      for (int w = 0; w < surface.vertex_count(); ++w)
        nearest = std::min(nearest, (surface.vertex(w) - simple.vertex(v)).norm());
      farthest = std::max(farthest, nearest / unit);
    }
    EXPECT_LT(farthest, 0.3);
  }
}

TEST(SimplifySurface, keeps_a_box_of_many_faces_exact) {
  // Flat sides and straight edges cost nothing: what is left still is the box.
  const TriangleMesh fine = [] {
    TriangleMesh mesh = shapes::box(Vec3(3, 2, 1));
    for (int round = 0; round < 5; ++round) {
      std::vector<Vec3> v;
      std::vector<Eigen::Vector3i> f;
      std::map<std::pair<int, int>, int> middle;
      for (int i = 0; i < mesh.vertex_count(); ++i) v.push_back(mesh.vertex(i));
      const auto split = [&](int a, int b) {
        const auto [at, added] = middle.try_emplace(std::minmax(a, b), static_cast<int>(v.size()));
        if (added) v.push_back((v[a] + v[b]) / 2);
        return at->second;
      };
      for (int t = 0; t < mesh.face_count(); ++t) {
        const int a = mesh.faces(t, 0), b = mesh.faces(t, 1), c = mesh.faces(t, 2);
        const int ab = split(a, b), bc = split(b, c), ca = split(c, a);
        f.insert(f.end(), {{a, ab, ca}, {b, bc, ab}, {c, ca, bc}, {ab, bc, ca}});
      }
      mesh = shapes::from_lists(v, f);
    }
    return mesh;
  }();
  ASSERT_EQ(fine.face_count(), 12288);
  const TriangleMesh simple = simplify_surface(fine, 300);
  EXPECT_LE(simple.face_count(), 300);
  EXPECT_NEAR(enclosed_volume(simple), 6, 1e-5);
}

TEST(SimplifySurface, stops_where_nothing_can_go_and_refuses_an_open_surface) {
  EXPECT_GE(simplify_surface(shapes::box(Vec3(1, 1, 1)), 1).face_count(), 4);
  TriangleMesh open = shapes::sphere(1, 2);
  open.faces.conservativeResize(open.faces.rows() - 1, 3);
  EXPECT_THROW(simplify_surface(open, 20), InputError);
}

}  // namespace
}  // namespace shellgrid
