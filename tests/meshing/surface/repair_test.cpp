// SPDX-License-Identifier: AGPL-3.0-or-later
#include "meshing/surface/repair.h"

#include <gtest/gtest.h>

#include <string>

#include "meshing/core/error.h"
#include "tests/support/closed_shapes.h"

namespace shellgrid {
namespace {

using shapes::from_lists;

std::string refusal(const TriangleMesh& mesh, bool close_holes = false) {
  RepairReport report;
  try {
    repair_surface(mesh, close_holes, report);
  } catch (const InputError& error) {
    return error.what();
  }
  return "";
}

TriangleMesh without_faces(TriangleMesh mesh, int first, int count) {
  const Eigen::Index rest = mesh.faces.rows() - first - count;
  mesh.faces.middleRows(first, rest) = mesh.faces.bottomRows(rest).eval();
  mesh.faces.conservativeResize(mesh.faces.rows() - count, 3);
  return mesh;
}

TEST(Repair, LeavesASoundSurfaceAsItIs) {
  const TriangleMesh mesh = shapes::rotated(shapes::torus(2, 0.7, 20, 10), 1);
  RepairReport report;
  const TriangleMesh repaired = repair_surface(mesh, false, report);
  EXPECT_EQ(repaired.vertices, mesh.vertices);
  EXPECT_EQ(repaired.faces, mesh.faces);
  EXPECT_EQ(report.merged_vertices + report.dropped_faces + report.turned_faces + report.unreferenced_vertices, 0);
  EXPECT_EQ(genus(repaired), 1);
}

TEST(Repair, StitchesASoupOfTriangles) {
  const TriangleMesh mesh = shapes::sphere(2, 2);
  TriangleMesh soup;
  soup.vertices.resize(3 * mesh.face_count() + 2, 3);
  soup.faces.resize(mesh.face_count(), 3);
  for (int f = 0; f < mesh.face_count(); ++f)
    for (int k = 0; k < 3; ++k) {
      soup.vertices.row(3 * f + k) = mesh.corner(f, k).transpose();
      soup.faces(f, k) = 3 * f + k;
    }
  soup.vertices.bottomRows(2).setConstant(77);  // belong to no face
  RepairReport report;
  const TriangleMesh repaired = repair_surface(soup, false, report);
  EXPECT_EQ(repaired.vertex_count(), mesh.vertex_count());
  EXPECT_EQ(repaired.face_count(), mesh.face_count());
  EXPECT_EQ(genus(repaired), 0);
  EXPECT_NEAR(enclosed_volume(repaired), enclosed_volume(mesh), 1e-12);
}

TEST(Repair, TurnsAnInsideOutSphere) {
  RepairReport report;
  const TriangleMesh repaired = repair_surface(shapes::turned_around(shapes::sphere(1, 2)), false, report);
  EXPECT_GT(enclosed_volume(repaired), 0);
  EXPECT_EQ(report.turned_faces, repaired.face_count());
}

TEST(Repair, MakesFacesAgree) {
  TriangleMesh mesh = shapes::sphere(1, 3);
  RandomStream random(4);
  int turned = 0;
  for (int f = 0; f < mesh.face_count(); ++f)
    if (random.next() < 0.3) std::swap(mesh.faces(f, 0), mesh.faces(f, 1)), ++turned;
  RepairReport report;
  const TriangleMesh repaired = repair_surface(mesh, false, report);
  EXPECT_EQ(report.turned_faces, turned);
  EXPECT_NEAR(enclosed_volume(repaired), enclosed_volume(shapes::sphere(1, 3)), 1e-12);
}

TEST(Repair, DropsDoubledAndDegenerateFaces) {
  TriangleMesh mesh = shapes::sphere(1, 1);
  const Eigen::Index m = mesh.faces.rows();
  mesh.faces.conservativeResize(m + 3, 3);
  mesh.faces.row(m) = mesh.faces.row(3);
  mesh.faces.row(m + 1) << mesh.faces(5, 1), mesh.faces(5, 0), mesh.faces(5, 2);
  mesh.faces.row(m + 2) << 4, 4, 7;
  RepairReport report;
  EXPECT_EQ(repair_surface(mesh, false, report).face_count(), m);
  EXPECT_EQ(report.dropped_faces, 3);
}

TEST(Repair, FlipsAwayTrianglesWithoutArea) {
  // A box whose first top edge carries a vertex that only one side uses, mended by a flat triangle.
  TriangleMesh mesh = shapes::box({2, 2, 2});
  const int a = mesh.faces(0, 0), b = mesh.faces(0, 1), c = mesh.faces(0, 2);
  const int middle = mesh.vertex_count();
  mesh.vertices.conservativeResize(middle + 1, 3);
  mesh.vertices.row(middle) = (0.5 * (mesh.vertex(a) + mesh.vertex(b))).transpose();
  const Eigen::Index m = mesh.faces.rows();
  mesh.faces.conservativeResize(m + 2, 3);
  mesh.faces.row(0) << a, middle, c;
  mesh.faces.row(m) << middle, b, c;
  mesh.faces.row(m + 1) << a, b, middle;
  RepairReport report;
  const TriangleMesh repaired = repair_surface(mesh, false, report);
  EXPECT_EQ(report.flattened_faces, 1);
  EXPECT_EQ(repaired.face_count(), m + 2);
  EXPECT_NEAR(enclosed_volume(repaired), 8, 1e-12);
}

TEST(Repair, RefusesOpenSurfacesAndSaysWhere) {
  const TriangleMesh mesh = without_faces(shapes::sphere(1, 2), 10, 1);
  const std::string message = refusal(mesh);
  EXPECT_NE(message.find("3 boundary edges, first at ("), std::string::npos) << message;
  EXPECT_NE(message.find("try --close-holes"), std::string::npos) << message;
}

TEST(Repair, ClosesHolesOnRequest) {
  const TriangleMesh whole = shapes::sphere(1, 3);
  const TriangleMesh mesh = without_faces(without_faces(whole, 100, 4), 10, 1);
  RepairReport report;
  const TriangleMesh repaired = repair_surface(mesh, true, report);
  EXPECT_EQ(report.closed_holes, 2);
  EXPECT_EQ(genus(repaired), 0);
  EXPECT_NEAR(enclosed_volume(repaired), enclosed_volume(whole), 0.01);
  EXPECT_EQ(find_self_intersections(repaired).pairs, 0);
}

TEST(Repair, ClosesHolesBesideEarsWithoutDoublingTheirEdges) {
  // A tube, closed below by a cone; every other edge of its upper rim carries an ear that stands up.
  const int n = 8;
  std::vector<Vec3> v;
  std::vector<Eigen::Vector3i> f;
  for (int i = 0; i < n; ++i) {
    const double angle = 2 * std::numbers::pi * i / n;
    v.emplace_back(std::cos(angle), std::sin(angle), 0);
    f.emplace_back((i + 1) % n, i, n);
  }
  v.emplace_back(0, 0, -1);
  for (int i = 0; i < n; i += 2) {
    f.emplace_back(i, i + 1, static_cast<int>(v.size()));
    v.push_back(0.6 * (v[i] + v[i + 1]) + Vec3(0, 0, 0.3));
  }
  RepairReport report;
  const TriangleMesh repaired = repair_surface(from_lists(v, f), true, report);
  EXPECT_EQ(report.closed_holes, 1);
  EXPECT_EQ(repaired.vertex_count(), static_cast<int>(v.size()) + 1);  // filled by a fan
  EXPECT_EQ(genus(repaired), 0);
  EXPECT_EQ(find_self_intersections(repaired).pairs, 0);
}

TEST(Repair, RefusesTwoComponentsAndSaysWhere) {
  const std::string apart =
      refusal(shapes::joined(shapes::sphere(1, 1), shapes::moved(shapes::sphere(1, 1), {5, 0, 0})));
  EXPECT_NE(apart.find("2 components, the second at ("), std::string::npos) << apart;
  const std::string nested = refusal(shapes::joined(shapes::sphere(2, 1), shapes::sphere(1, 1)));
  EXPECT_NE(nested.find("2 components"), std::string::npos) << nested;
}

TEST(Repair, RefusesFlatMeshes) {
  const TriangleMesh square = from_lists({{0, 0, 0}, {1, 0, 0}, {1, 1, 0}, {0, 1, 0}}, {{0, 1, 2}, {0, 2, 3}});
  EXPECT_NE(refusal(square).find("flat"), std::string::npos) << refusal(square);
  EXPECT_NE(refusal(shapes::box({3, 2, 0})).find("flat"), std::string::npos) << refusal(shapes::box({3, 2, 0}));
  EXPECT_NE(refusal(shapes::box({3, 2, 1e-11})).find("flat"), std::string::npos);
}

TEST(Repair, RefusesEmptyMeshesAndBadNumbers) {
  EXPECT_NE(refusal(TriangleMesh{}).find("no faces"), std::string::npos);
  TriangleMesh mesh = shapes::sphere(1, 1);
  mesh.vertices(3, 1) = std::nan("");
  EXPECT_NE(refusal(mesh).find("not finite"), std::string::npos);
  mesh = shapes::sphere(1, 1);
  mesh.faces(2, 2) = 1000;
  EXPECT_NE(refusal(mesh).find("out of range"), std::string::npos);
  mesh = shapes::sphere(1, 0);
  mesh.vertices.setConstant(2);
  EXPECT_NE(refusal(mesh).find("degenerate"), std::string::npos);
}

TEST(Repair, RefusesNonManifoldEdgesAndVertices) {
  // Two tetrahedra that share an edge, and two that share a corner.
  const TriangleMesh edge =
      from_lists({{0, 0, 0}, {0, 0, 1}, {1, 0, 0}, {1, 1, 0}, {-1, 0, 0}, {-1, -1, 0}},
                 {{0, 2, 1}, {1, 2, 3}, {0, 1, 3}, {0, 3, 2}, {0, 4, 1}, {1, 4, 5}, {0, 1, 5}, {0, 5, 4}});
  EXPECT_NE(refusal(edge).find("1 non-manifold edge, first at (0, 0, 0.5)"), std::string::npos) << refusal(edge);
  const TriangleMesh corner =
      shapes::joined(shapes::double_cone(3, 1, 1, 1), shapes::moved(shapes::double_cone(4, 1, 1, 1), {0, 0, 2}));
  EXPECT_NE(refusal(corner).find("1 non-manifold vertex, first at (0, 0, 1)"), std::string::npos) << refusal(corner);
}

TEST(Repair, RefusesOneSidedSurfaces) {
  // A Klein bottle of 8 × 8 quadrilaterals: closed, manifold, without sides.
  std::vector<Vec3> v;
  std::vector<Eigen::Vector3i> f;
  const int n = 8;
  for (int i = 0; i < n; ++i)
    for (int j = 0; j < n; ++j) {
      const double s = 2 * std::numbers::pi * i / n, t = 2 * std::numbers::pi * j / n;
      const double r = 3 + std::cos(s / 2) * std::sin(t) - std::sin(s / 2) * std::sin(2 * t);
      v.emplace_back(r * std::cos(s), r * std::sin(s),
                     std::sin(s / 2) * std::sin(t) + std::cos(s / 2) * std::sin(2 * t));
    }
  const auto at = [&](int i, int j) { return i < n ? i * n + (j + n) % n : (n - j) % n; };
  for (int i = 0; i < n; ++i)
    for (int j = 0; j < n; ++j) {
      f.emplace_back(at(i, j), at(i + 1, j), at(i + 1, j + 1));
      f.emplace_back(at(i, j), at(i + 1, j + 1), at(i, j + 1));
    }
  const std::string message = refusal(from_lists(v, f));
  EXPECT_NE(message.find("look opposite ways"), std::string::npos) << message;
}

TEST(Repair, RefusesSelfIntersectionsAndSaysWhere) {
  // A sphere with one vertex pushed through the opposite side.
  TriangleMesh mesh = shapes::sphere(1, 2);
  mesh.vertices.row(4) << 0, 0, -1.5;
  const std::string message = refusal(mesh);
  EXPECT_NE(message.find("of triangles intersect, first at ("), std::string::npos) << message;
}

TEST(SelfIntersections, OfNeighboursFoldedOntoEachOtherDependOnTheAngle) {
  for (const double angle : {1e-3, 1e-7}) {
    // Over the same edge, one face the given angle above the other.
    const TriangleMesh fold =
        from_lists({{0, 0, 0}, {1, 0, 0}, {0.5, 1, 0}, {0.4, 0.8 * std::cos(angle), 0.8 * std::sin(angle)}},
                   {{0, 1, 2}, {1, 0, 3}});
    EXPECT_EQ(find_self_intersections(fold).pairs, 0);
    EXPECT_EQ(find_self_intersections(fold, {}, folded_flat).pairs, angle < folded_flat ? 1 : 0);
  }
}

TEST(SelfIntersections, AreNoneAmongNeighboursAndFoundAmongStrangers) {
  EXPECT_EQ(find_self_intersections(shapes::rotated(shapes::sphere(3, 3), 1)).pairs, 0);
  EXPECT_EQ(find_self_intersections(shapes::box({1, 2, 3})).pairs, 0);
  EXPECT_EQ(find_self_intersections(shapes::joined(shapes::sphere(2, 2), shapes::sphere(1, 2))).pairs, 0);
  EXPECT_GT(
      find_self_intersections(shapes::joined(shapes::sphere(1, 2), shapes::moved(shapes::sphere(1, 2), {1, 0.1, 0.2})))
          .pairs,
      10);
  // Folded flat onto its neighbour.
  const TriangleMesh fold = from_lists({{0, 0, 0}, {1, 0, 0}, {0.3, 1, 0}, {0.4, 0.5, 0}}, {{0, 1, 2}, {1, 0, 3}});
  EXPECT_EQ(find_self_intersections(fold).pairs, 1);
}

}  // namespace
}  // namespace shellgrid
