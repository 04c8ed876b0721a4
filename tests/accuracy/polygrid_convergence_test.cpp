// SPDX-License-Identifier: AGPL-3.0-or-later
// How fast the polygrid's boundary approaches a smooth surface as nodes are refined. Between its points, which lie on
// the surface, bilinear quadrilaterals stray by the square of their size, and so does the volume that they enclose.
// SG_LONG=1 refines further and adds shapes.
#include <gtest/gtest.h>

#include <cmath>
#include <cstdio>
#include <functional>
#include <string>

#include "meshing/polycube/polygrid.h"
#include "meshing/surface/repair.h"
#include "meshing/surface/surface_quality.h"
#include "tests/support/closed_shapes.h"
#include "tests/support/timing.h"

namespace shellgrid {
namespace {

TriangleMesh bent_sphere(int subdivisions, const std::function<Vec3(const Vec3&)>& bend) {
  TriangleMesh mesh = shapes::rotated(shapes::sphere(1, subdivisions), 2);
  for (int v = 0; v < mesh.vertex_count(); ++v) mesh.vertices.row(v) = bend(mesh.vertex(v)).transpose();
  return shapes::rotated(mesh, 5);
}

// Middles of the boundary quadrilaterals' sides and of themselves.
VertexMatrix between_points(const Polygrid& grid) {
  const QuadMatrix& quads = grid.boundary_quads;
  VertexMatrix points(3 * quads.rows(), 3);
  for (Eigen::Index q = 0; q < quads.rows(); ++q) {
    const auto p = [&](int k) { return grid.points.row(quads(q, k)); };
    // Each inner side belongs to two quadrilaterals: the two that leave one corner are enough.
    points.row(3 * q) = (p(0) + p(1)) / 2;
    points.row(3 * q + 1) = (p(0) + p(3)) / 2;
    points.row(3 * q + 2) = (p(0) + p(1) + p(2) + p(3)) / 4;
  }
  return points;
}

// The boundary as triangles around each quadrilateral's middle, which has the volume of the bilinear surface.
TriangleMesh triangulated(const Polygrid& grid) {
  const Eigen::Index n = grid.points.rows(), m = grid.boundary_quads.rows();
  TriangleMesh mesh;
  mesh.vertices.resize(n + m, 3);
  mesh.vertices.topRows(n) = grid.points;
  mesh.faces.resize(4 * m, 3);
  for (Eigen::Index q = 0; q < m; ++q) {
    mesh.vertices.row(n + q).setZero();
    for (int k = 0; k < 4; ++k) {
      const std::int32_t a = grid.boundary_quads(q, k), b = grid.boundary_quads(q, (k + 1) % 4);
      mesh.vertices.row(n + q) += grid.points.row(a) / 4;
      mesh.faces.row(4 * q + k) << a, b, static_cast<std::int32_t>(n + q);
    }
  }
  return mesh;
}

// Slope of log error over log spacing, by least squares.
double order(const std::vector<double>& spacing, const std::vector<double>& error) {
  double x = 0, y = 0, xx = 0, xy = 0;
  const auto n = static_cast<double>(spacing.size());
  for (std::size_t k = 0; k < spacing.size(); ++k) {
    const double a = std::log(spacing[k]), b = std::log(error[k]);
    x += a, y += b, xx += a * a, xy += a * b;
  }
  return (n * xy - x * y) / (n * xx - x * x);
}

double root_mean_square(const std::vector<float>& values) {
  double sum = 0;
  for (const float value : values) sum += static_cast<double>(value) * value;
  return std::sqrt(sum / static_cast<double>(values.size()));
}

void expect_second_order(const std::string& name, const TriangleMesh& surface, const std::vector<double>& nodes) {
  const double volume = enclosed_volume(surface), size = std::cbrt(volume);
  std::vector<double> spacing, outward, inward, volumes;
  std::printf("%-10s %8s %9s %12s %12s %12s %12s\n", name.c_str(), "nodes", "h/size", "boundary rms", "max",
              "surface rms", "volume error");
  for (const double count : nodes) {
    PolycubeOptions options;
    options.nodes = count;
    const VoxelPolycube polycube = build_voxel_polycube(surface, options);
    const Polygrid grid = build_polygrid(polycube, surface, {});
    const TriangleMesh boundary = triangulated(grid);
    const std::vector<float> out = distances_to_surface(between_points(grid), surface);
    const std::vector<float> in = distances_to_surface(surface.vertices, boundary);
    spacing.push_back(grid.spacing / size);
    outward.push_back(root_mean_square(out) / size);
    inward.push_back(root_mean_square(in) / size);
    volumes.push_back(std::abs(enclosed_volume(boundary) / volume - 1));
    std::printf("%-10s %8ld %9.4f %12.3e %12.3e %12.3e %12.3e\n", name.c_str(),
                static_cast<long>(grid.graph.interior.rows() + grid.graph.boundary.rows()), spacing.back(),
                outward.back(), *std::max_element(out.begin(), out.end()) / size, inward.back(), volumes.back());
  }
  const double orders[] = {order(spacing, outward), order(spacing, inward), order(spacing, volumes)};
  std::printf("%-10s orders: boundary to surface %.2f, surface to boundary %.2f, volume %.2f\n", name.c_str(),
              orders[0], orders[1], orders[2]);
  for (const double found : orders) EXPECT_GE(found, 1.7) << name;
}

std::vector<double> node_counts() {
  if (test::long_form()) return {1e4, 4e4, 1.6e5, 6.4e5};
  return {2e3, 8e3, 3.2e4};
}

int subdivisions() { return test::long_form() ? 8 : 7; }

TEST(PolygridConvergence, sphere) { expect_second_order("sphere", shapes::sphere(10, subdivisions()), node_counts()); }

TEST(PolygridConvergence, torus) {
  const int fine = test::long_form() ? 2 : 1;
  expect_second_order("torus", shapes::rotated(shapes::torus(10, 4, 360 * fine, 160 * fine), 4), node_counts());
}

TEST(PolygridConvergence, ellipsoid) {
  expect_second_order("ellipsoid",
                      bent_sphere(subdivisions(), [](const Vec3& p) { return Vec3(p.cwiseProduct(Vec3(14, 10, 7))); }),
                      node_counts());
}

TEST(PolygridConvergence, waves) {
  expect_second_order(
      "waves",
      bent_sphere(subdivisions(),
                  [](const Vec3& p) {
                    return Vec3(10 * (1 + 0.12 * std::sin(3 * p.x() + 1) * std::sin(3 * p.y()) * std::cos(3 * p.z())) *
                                p);
                  }),
      node_counts());
}

}  // namespace
}  // namespace shellgrid
