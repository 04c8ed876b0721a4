// SPDX-License-Identifier: AGPL-3.0-or-later
#include "meshing/surface/direction_field.h"

#include <gtest/gtest.h>

#include <Eigen/Geometry>
#include <algorithm>
#include <cmath>
#include <numeric>

#include "meshing/core/error.h"
#include "meshing/surface/surface_walk.h"
#include "tests/synthesis/synthesis_shapes.h"

namespace shellgrid {
namespace {

struct Field {
  TriangleMesh mesh;
  HalfEdges half_edges;
  VertexMatrix normals, directions;
  std::vector<int> indices;

  explicit Field(const TriangleMesh& m, double spacing) : mesh(m) {
    half_edges = build_half_edges(mesh);
    normals = vertex_normals(mesh);
    const VertexHierarchy hierarchy = build_vertex_hierarchy(mesh, half_edges, normals, spacing, 5, 3);
    directions = make_direction_field(mesh, normals, hierarchy, Vec3(0.2, 1, 0.1));
    indices = direction_field_indices(mesh, normals, directions);
  }
  int sum() const { return std::accumulate(indices.begin(), indices.end(), 0); }
  int singularities() const {
    return static_cast<int>(std::count_if(indices.begin(), indices.end(), [](int i) { return i != 0; }));
  }
};

TEST(DirectionField, IndicesSumToTheEulerCharacteristic) {
  EXPECT_EQ(Field(testing::sphere(10, 5), 0.4).sum(), 2);
  EXPECT_EQ(Field(testing::torus(10, 4, 160, 64), 0.4).sum(), 0);
}

TEST(DirectionField, HasFewMoreSingularitiesThanTheShapeForces) {
  EXPECT_EQ(Field(testing::sphere(10, 5), 0.4).singularities(), 2);
  EXPECT_LE(Field(testing::torus(10, 4, 160, 64), 0.4).singularities(), 4);
}

TEST(DirectionField, IsUnitAndTangent) {
  const Field field(testing::torus(10, 4, 120, 48), 0.5);
  for (int v = 0; v < field.mesh.vertex_count(); ++v) {
    EXPECT_NEAR(field.directions.row(v).norm(), 1, 1e-9);
    EXPECT_NEAR(field.directions.row(v).dot(field.normals.row(v)), 0, 1e-9);
  }
}

TEST(DirectionField, IsConstantOnAFlatPatch) {
  const Field field(testing::patch(30, 0.4), 0.4);
  const Vec3 expected = Vec3(0.2, 1, 0).normalized();
  for (int v = 0; v < field.mesh.vertex_count(); ++v)
    EXPECT_LT((field.directions.row(v).transpose() - expected).norm(), 1e-9);
}

// One constraint turns the field as a whole; several are all met, and what lies between turns smoothly.
TEST(DirectionField, TakesTheDirectionsWantedOfIt) {
  const TriangleMesh mesh = testing::torus(10, 4, 160, 64);
  const HalfEdges half_edges = build_half_edges(mesh);
  const VertexMatrix normals = vertex_normals(mesh);
  const VertexHierarchy hierarchy = build_vertex_hierarchy(mesh, half_edges, normals, 0.4, 5, 3);
  const std::vector<DirectionConstraint> wanted = {{Vec3(14, 0, 0), Vec3(0, 1, 1)}, {Vec3(-14, 0, 0), Vec3(0, 0, 1)}};
  const VertexMatrix field = make_direction_field(mesh, normals, hierarchy, Vec3(0.2, 1, 0.1), wanted);
  for (const DirectionConstraint& w : wanted) {
    Eigen::Index v = 0;
    (mesh.vertices.rowwise() - w.point.transpose()).rowwise().squaredNorm().minCoeff(&v);
    EXPECT_GT(field.row(v).dot(w.direction.normalized().transpose()), 0.999);
  }
  const std::vector<int> indices = direction_field_indices(mesh, normals, field);
  std::size_t sharp = 0;
  for (int f = 0; f < mesh.face_count(); ++f)
    for (int k = 0; k < 3; ++k) {
      const double cosine = field.row(mesh.faces(f, k)).dot(field.row(mesh.faces(f, (k + 1) % 3)));
      sharp += cosine < 0.9;
    }
  EXPECT_LT(sharp, 0.01 * 3 * mesh.face_count());
  EXPECT_EQ(std::accumulate(indices.begin(), indices.end(), 0), 0);
}

// Alike after half or quarter turns: singularities are that much milder, and add up to as many times Euler's number.
// A wish against the preferred direction turns what is about it, not its vertex alone.
TEST(DirectionField, AWishTurnsItsSurroundings) {
  const TriangleMesh ball = testing::sphere(10, 5);
  const HalfEdges half_edges = build_half_edges(ball);
  const VertexMatrix normals = vertex_normals(ball);
  const VertexHierarchy hierarchy = build_vertex_hierarchy(ball, half_edges, normals, 0.4, 5, 3);
  for (const Vec3& wish : {Vec3(0, -1, 0), Vec3(1, 0, 0)}) {
    const Vec3 place(0, 0, 10);
    const VertexMatrix field = make_direction_field(ball, normals, hierarchy, Vec3(0, 1, 0), {{place, wish}});
    double near = 0;
    int count = 0;
    for (int v = 0; v < ball.vertex_count(); ++v) {
      const double distance = (ball.vertex(v) - place).norm();
      const Vec3 n = normals.row(v).transpose();
      if (distance < 2.5) near += field.row(v).dot(wish - wish.dot(n) * n), ++count;
    }
    EXPECT_GT(near / count, 0.9) << wish.transpose();
    const std::vector<int> indices = direction_field_indices(ball, normals, field);
    EXPECT_EQ(std::accumulate(indices.begin(), indices.end(), 0), 2);
    // The rest follows smoothly.
    EXPECT_LE(std::count_if(indices.begin(), indices.end(), [](int i) { return i != 0; }), 4);
  }
  EXPECT_THROW(make_direction_field(ball, normals, hierarchy, Vec3(0, 1, 0), {{Vec3(0, 0, 1e9), Vec3(1, 0, 0)}}),
               InputError);
  EXPECT_THROW(make_direction_field(ball, normals, hierarchy, Vec3(0, 1, 0),
                                    {{Vec3(0, 0, 10), Vec3(1, 0, 0)}, {Vec3(0, 0, 10), Vec3(-1, 0, 0)}}),
               InputError);
}

TEST(DirectionField, SymmetricFieldsHaveFractionalSingularities) {
  const TriangleMesh mesh = testing::sphere(9, 5);
  const HalfEdges half_edges = build_half_edges(mesh);
  const VertexMatrix normals = vertex_normals(mesh);
  const VertexHierarchy hierarchy = build_vertex_hierarchy(mesh, half_edges, normals, 0.4, 5, 3);
  for (int symmetry : {1, 2, 4}) {
    const VertexMatrix field = make_direction_field(mesh, normals, hierarchy, Vec3(0.2, 1, 0.1), {}, symmetry);
    const std::vector<int> indices = direction_field_indices(mesh, normals, field, symmetry);
    EXPECT_EQ(std::accumulate(indices.begin(), indices.end(), 0), 2 * symmetry);
    int singular = 0;
    for (int index : indices) {
      EXPECT_LE(std::abs(index), 1);
      singular += index != 0;
    }
    EXPECT_LE(singular, 4 * symmetry);
    for (int v = 0; v < mesh.vertex_count(); ++v) {
      ASSERT_NEAR(field.row(v).norm(), 1, 1e-9);
      ASSERT_NEAR(field.row(v).dot(normals.row(v)), 0, 1e-9);
    }
  }
}

TEST(DirectionField, RefusesDirectionsAcrossTheSurface) {
  const TriangleMesh mesh = testing::torus(10, 4, 80, 32);
  const HalfEdges half_edges = build_half_edges(mesh);
  const VertexMatrix normals = vertex_normals(mesh);
  const VertexHierarchy hierarchy = build_vertex_hierarchy(mesh, half_edges, normals, 0.8, 4, 3);
  const auto refused = [&](const Vec3& direction) {
    EXPECT_THROW(make_direction_field(mesh, normals, hierarchy, Vec3(0, 1, 0), {{Vec3(14, 0, 0), direction}}),
                 InputError);
  };
  refused(Vec3(1, 0, 0));
  refused(Vec3::Zero());
  refused(Vec3(std::nan(""), 0, 1));
}

TEST(HalfEdges, RefusesThreeFacesAtAnEdgeAndFlippedFaces) {
  TriangleMesh fan;
  fan.vertices.resize(5, 3);
  fan.vertices << 0, 0, 0, 1, 0, 0, 0, 1, 0, 0, -1, 0, 0, 0, 1;
  fan.faces.resize(3, 3);
  fan.faces << 0, 1, 2, 1, 0, 3, 0, 1, 4;
  EXPECT_THROW(build_half_edges(fan), InputError);
  fan.faces.resize(2, 3);
  fan.faces << 0, 1, 2, 0, 1, 3;
  EXPECT_THROW(build_half_edges(fan), InputError);
}

TEST(SurfaceWalk, FollowsGreatCirclesOfASphere) {
  const double radius = 10;
  const TriangleMesh mesh = testing::sphere(radius, 6);
  const HalfEdges half_edges = build_half_edges(mesh);
  const VertexMatrix normals = vertex_normals(mesh);
  for (int vertex : {0, 100, 777, 4000}) {
    const Vec3 normal = mesh.vertex(vertex).normalized();
    const Vec3 direction = normal.cross(Vec3(0.3, -0.7, 0.5)).normalized();
    const SurfaceWalkEnd end =
        walk_from_vertex(mesh, half_edges, vertex, normals.row(vertex).transpose(), direction, 0.5 * radius);
    ASSERT_GE(end.face, 0);
    const Vec3 expected = radius * (std::cos(0.5) * normal + std::sin(0.5) * direction);
    EXPECT_LT((end.position - expected).norm(), 0.03 * radius);
    EXPECT_GT(end.direction.dot(std::cos(0.5) * direction - std::sin(0.5) * normal), 0.998);
  }
}

TEST(SurfaceWalk, IsExactOnAPlaneAndEndsAtItsBoundary) {
  const TriangleMesh mesh = testing::patch(20, 0.5);
  const HalfEdges half_edges = build_half_edges(mesh);
  const int middle = 10 * 21 + 10;
  for (int k = 0; k < 36; ++k) {
    const double angle = k * std::numbers::pi / 18 + 0.01;
    const Vec3 direction(std::cos(angle), std::sin(angle), 0);
    const SurfaceWalkEnd end = walk_from_vertex(mesh, half_edges, middle, Vec3(0, 0, 1), direction, 3.3);
    ASSERT_GE(end.face, 0);
    EXPECT_LT((end.position - mesh.vertex(middle) - 3.3 * direction).norm(), 1e-9);
    EXPECT_EQ(walk_from_vertex(mesh, half_edges, middle, Vec3(0, 0, 1), direction, 8).face, -1);
  }
}

TEST(VertexHierarchy, LevelsAreNestedAndThinOutFourfold) {
  const TriangleMesh mesh = testing::torus(10, 4, 200, 80);
  const HalfEdges half_edges = build_half_edges(mesh);
  const VertexMatrix normals = vertex_normals(mesh);
  const double spacing = mean_edge_length(mesh) * 0.9;
  const VertexHierarchy hierarchy = build_vertex_hierarchy(mesh, half_edges, normals, spacing, 4, 1);
  ASSERT_EQ(hierarchy.levels.size(), 4u);
  for (std::size_t l = 1; l < hierarchy.levels.size(); ++l) {
    const auto &coarse = hierarchy.levels[l].vertices, &fine = hierarchy.levels[l - 1].vertices;
    EXPECT_TRUE(std::includes(fine.begin(), fine.end(), coarse.begin(), coarse.end()));
    const double ratio = static_cast<double>(fine.size()) / static_cast<double>(coarse.size());
    EXPECT_GT(ratio, 2.5);
    EXPECT_LT(ratio, 6.5);
    for (std::int32_t v : coarse) EXPECT_EQ(hierarchy.levels[l].nearest[v], v);
  }
}

}  // namespace
}  // namespace shellgrid
