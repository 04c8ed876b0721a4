// SPDX-License-Identifier: AGPL-3.0-or-later
#include "meshing/polycube/polygrid.h"

#include <gtest/gtest.h>

#include <Eigen/Geometry>

#include <oneapi/tbb/global_control.h>
#include <map>

#include "meshing/core/error.h"
#include "meshing/core/random.h"
#include "meshing/polycube/block_grid.h"
#include "meshing/polycube/boundary_layer.h"
#include "meshing/polycube/hexahedra_optimization.h"
#include "meshing/polycube/target_surface.h"
#include "meshing/polycube/tetrahedralize.h"
#include "meshing/surface/repair.h"
#include "tests/meshing/polycube/shapes.h"

namespace shellgrid {
namespace {

namespace shapes = voxel_shapes;

struct Case {
  const char* name;
  TriangleMesh (*make)();
  int genus;
  double coverage;  // most, in cells
};

TriangleMesh make_sphere() { return voxel_shapes::sphere(10); }
TriangleMesh make_torus() { return voxel_shapes::torus(10, 4); }
TriangleMesh make_slab() { return voxel_shapes::box(40, 30, 2); }
TriangleMesh make_cube() { return voxel_shapes::box(10, 10, 10); }

class PolygridOfShape : public testing::TestWithParam<Case> {
 protected:
  struct Built {
    TriangleMesh surface;
    VoxelPolycube polycube;
    Polygrid polygrid;
    PolygridQuality quality;
  };
  static Built build() {
    Built built;
    built.surface = GetParam().make();
    PolycubeOptions options;
    options.nodes = 2e4;
    options.blocks = 2500;
    built.polycube = build_voxel_polycube(built.surface, options);
    built.polygrid = build_polygrid(built.polycube, built.surface, {});
    built.quality = measure_polygrid(built.polygrid, built.polycube, built.surface);
    return built;
  }
  // Each shape is built once for all tests.
  static const Built& built() {
    static std::map<std::string, Built> cache;
    const auto found = cache.find(GetParam().name);
    return found != cache.end() ? found->second : cache.emplace(GetParam().name, build()).first->second;
  }
  const TriangleMesh& surface_ = built().surface;
  const VoxelPolycube& polycube_ = built().polycube;
  const Polygrid& polygrid_ = built().polygrid;
  const PolygridQuality& quality_ = built().quality;
};

// The determinant of the three edges at a corner of a VTK hexahedron, written out independently.
double vtk_corner_determinant(const Polygrid& grid, Eigen::Index cell, int k) {
  constexpr int next[8][3] = {{1, 3, 4}, {2, 0, 5}, {3, 1, 6}, {0, 2, 7}, {7, 5, 0}, {4, 6, 1}, {5, 7, 2}, {6, 4, 3}};
  Mat3 edges;
  for (int n = 0; n < 3; ++n)
    edges.col(n) = (grid.points.row(grid.cells(cell, next[k][n])) - grid.points.row(grid.cells(cell, k))).transpose();
  return edges.determinant();
}

TEST_P(PolygridOfShape, has_positive_jacobians_at_every_corner) {
  for (Eigen::Index c = 0; c < polygrid_.cells.rows(); ++c)
    for (int k = 0; k < 8; ++k) ASSERT_GT(vtk_corner_determinant(polygrid_, c, k), 0) << "cell " << c;
  EXPECT_EQ(quality_.inverted_cells, 0);
}

TEST_P(PolygridOfShape, keeps_the_genus) {
  EXPECT_EQ(polycube_.object_genus, GetParam().genus);
  EXPECT_EQ(polycube_.genus, GetParam().genus);
  std::map<std::pair<int, int>, int> edges;
  std::map<int, int> points;
  for (Eigen::Index q = 0; q < polygrid_.boundary_quads.rows(); ++q)
    for (int k = 0; k < 4; ++k) {
      const int a = polygrid_.boundary_quads(q, k), b = polygrid_.boundary_quads(q, (k + 1) % 4);
      ++edges[{std::min(a, b), std::max(a, b)}];
      ++points[a];
    }
  for (const auto& [edge, uses] : edges) ASSERT_EQ(uses, 2);
  const long euler =
      static_cast<long>(points.size()) - static_cast<long>(edges.size()) + polygrid_.boundary_quads.rows();
  EXPECT_EQ(euler, 2 - 2 * GetParam().genus);
}

TEST_P(PolygridOfShape, links_each_outer_point_to_one_twin) {
  std::map<int, int> uses;
  std::map<int, int> on_quads;
  for (Eigen::Index q = 0; q < polygrid_.boundary_quads.rows(); ++q)
    for (int k = 0; k < 4; ++k) ++on_quads[polygrid_.boundary_quads(q, k)];
  for (std::size_t p = 0; p < polygrid_.outer_twin.size(); ++p) {
    const int twin = polygrid_.outer_twin[p];
    EXPECT_EQ(twin >= 0, on_quads.contains(static_cast<int>(p)));
    if (twin < 0) continue;
    EXPECT_EQ(polygrid_.outer_twin[twin], -1);
    EXPECT_EQ(polygrid_.point_lattice.row(p), polygrid_.point_lattice.row(twin));
    EXPECT_NEAR(polygrid_.point_normal.row(p).norm(), 1, 1e-9);
    ++uses[twin];
  }
  for (const auto& [twin, count] : uses) EXPECT_EQ(count, 1);
}

TEST_P(PolygridOfShape, has_a_symmetric_graph_of_six_links_and_one) {
  const PolygridGraph& graph = polygrid_.graph;
  std::vector<int> boundary_uses(graph.boundary.rows(), 0);
  for (Eigen::Index i = 0; i < graph.links.rows(); ++i)
    for (int side = 0; side < 6; ++side) {
      const int link = graph.links(i, side);
      if (link >= 0) {
        ASSERT_LT(link, graph.interior.rows());
        ASSERT_EQ(graph.links(link, side ^ 1), i);
      } else {
        ++boundary_uses[-1 - link];
        EXPECT_EQ(graph.boundary_owner[-1 - link], i);
      }
      EXPECT_TRUE(std::isfinite(graph.weights(i, side)));
    }
  for (int uses : boundary_uses) EXPECT_EQ(uses, 1);
}

TEST_P(PolygridOfShape, reaches_the_surface) {
  const TargetSurface target(surface_);
  const double size = (surface_.vertices.colwise().maxCoeff() - surface_.vertices.colwise().minCoeff()).maxCoeff();
  long outer = 0, off = 0;
  double farthest = 0;
  for (std::size_t p = 0; p < polygrid_.outer_twin.size(); ++p)
    if (polygrid_.outer_twin[p] >= 0) {
      const double distance = target.nearest(polygrid_.points.row(p).transpose()).distance;
      ++outer;
      off += distance > 1e-4 * size;
      farthest = std::max(farthest, distance / polygrid_.spacing);
    }
  EXPECT_EQ(off, quality_.off_surface);
  EXPECT_NEAR(farthest, quality_.boundary_distance_max, 1e-9);
  EXPECT_LT(off, 0.02 * outer);
  EXPECT_LT(farthest, 1.0);
  EXPECT_LT(quality_.coverage_max, GetParam().coverage);
}

TEST_P(PolygridOfShape, links_no_outer_point_against_the_normal) {
  // From the points alone: the facet under each outer point, and its side on which the twin stands.
  const TargetSurface target(surface_);
  const double size = (surface_.vertices.colwise().maxCoeff() - surface_.vertices.colwise().minCoeff()).maxCoeff();
  long reversed = 0, on_surface = 0;
  for (std::size_t p = 0; p < polygrid_.outer_twin.size(); ++p) {
    if (polygrid_.outer_twin[p] < 0) continue;
    const Vec3 place = polygrid_.points.row(p).transpose();
    const TargetSurface::Nearest nearest = target.nearest(place);
    if (nearest.distance > 1e-4 * size) continue;
    ++on_surface;
    reversed += (place - polygrid_.points.row(polygrid_.outer_twin[p]).transpose()).dot(nearest.face_normal) <= 0;
  }
  EXPECT_GT(on_surface, 0);
  EXPECT_EQ(reversed, 0);
  EXPECT_LT(quality_.link_angle_mean, 5);
}

TEST_P(PolygridOfShape, is_the_same_at_one_thread) {
  const oneapi::tbb::global_control one(oneapi::tbb::global_control::max_allowed_parallelism, 1);
  const Built rebuilt = build();
  ASSERT_EQ(rebuilt.polycube.blocks.size(), polycube_.blocks.size());
  const Polygrid& again = rebuilt.polygrid;
  EXPECT_EQ(again.points, polygrid_.points);
  EXPECT_EQ(again.cells, polygrid_.cells);
  EXPECT_EQ(again.graph.weights, polygrid_.graph.weights);
}

TEST_P(PolygridOfShape, falls_back_on_a_valid_lattice) {
  const double unit = polycube_.spacing * polycube_.cells_per_block;
  TriangleMesh scaled = surface_;
  scaled.vertices.rowwise() -= polycube_.origin.transpose();
  scaled.vertices /= unit;
  const LayeredGrid grid = layer_on_lattice(polycube_.blocks, polycube_.cells_per_block, TargetSurface(scaled),
                                            polycube_.cells_per_block, 0.1);
  EXPECT_TRUE(inverted_cells(grid).empty());
  EXPECT_EQ(grid.layer.size(), static_cast<std::size_t>(polygrid_.boundary_quads.rows()));
}

TEST_P(PolygridOfShape, does_not_depend_on_the_unit) {
  TriangleMesh small = surface_;
  small.vertices /= 1024;
  PolycubeOptions options;
  options.nodes = 2e4;
  options.blocks = 2500;
  const VoxelPolycube polycube = build_voxel_polycube(small, options);
  const Polygrid grid = build_polygrid(polycube, small, {});
  ASSERT_EQ(grid.cells, polygrid_.cells);
  EXPECT_LT((1024 * grid.points - polygrid_.points).cwiseAbs().maxCoeff(), 1e-9 * polygrid_.spacing);
}

INSTANTIATE_TEST_SUITE_P(Shapes, PolygridOfShape,
                         testing::Values(Case{"sphere", make_sphere, 0, 0.5}, Case{"torus", make_torus, 1, 0.5},
                                         Case{"double_torus", voxel_shapes::double_torus, 2, 1.5},
                                         Case{"slab", make_slab, 0, 2}, Case{"cube", make_cube, 0, 1},
                                         Case{"branching", voxel_shapes::branching, 0, 1.5}),
                         [](const auto& info) { return info.param.name; });

// Polycubes that are not of the surface at all: no fit is to be had, and the grid must be valid all the same.
TEST(Polygrid, is_valid_whatever_the_polycube) {
  struct Mismatch {
    TriangleMesh surface, other;
  };
  const Mismatch cases[] = {{voxel_shapes::torus(10, 4), voxel_shapes::sphere(13)},
                            {voxel_shapes::sphere(10), voxel_shapes::double_torus()},
                            {voxel_shapes::branching(), voxel_shapes::torus(10, 3)},
                            {voxel_shapes::box(20, 20, 0.5), voxel_shapes::branching()}};
  for (const Mismatch& mismatch : cases) {
    PolycubeOptions options;
    options.nodes = 1500;
    options.blocks = 200;
    VoxelPolycube polycube = build_voxel_polycube(mismatch.other, options);
    const Vec3 middle =
        0.5 *
        (mismatch.surface.vertices.colwise().maxCoeff() + mismatch.surface.vertices.colwise().minCoeff()).transpose();
    const Vec3 other =
        0.5 * (mismatch.other.vertices.colwise().maxCoeff() + mismatch.other.vertices.colwise().minCoeff()).transpose();
    polycube.origin += middle - other;
    const Polygrid grid = build_polygrid(polycube, mismatch.surface, {});
    const PolygridQuality quality = measure_polygrid(grid, polycube, mismatch.surface);
    EXPECT_EQ(quality.inverted_cells, 0);
    EXPECT_TRUE(grid.points.allFinite());
    EXPECT_TRUE(grid.graph.weights.allFinite());
  }
}

TEST(Polygrid, refuses_a_polycube_of_another_size_or_place) {
  const TriangleMesh sphere = voxel_shapes::sphere(10);
  PolycubeOptions options;
  options.nodes = 1500;
  options.blocks = 200;
  const VoxelPolycube polycube = build_voxel_polycube(sphere, options);
  for (double factor : {0.001, 0.2, 5.0, 1000.0}) {
    TriangleMesh other = sphere;
    other.vertices *= factor;
    EXPECT_THROW(build_polygrid(polycube, other, {}), InputError) << factor;
  }
  TriangleMesh moved = sphere;
  moved.vertices.col(1).array() += 40;
  EXPECT_THROW(build_polygrid(polycube, moved, {}), InputError);
}

// Blocks scattered at random, made a manifold: corners of every kind, some of which see not all their faces.
TEST(Polygrid, lays_a_valid_layer_on_any_lattice) {
  RandomStream random(11, 3);
  for (int trial = 0; trial < 12; ++trial) {
    std::vector<Vec3i> blocks;
    for (int k = 0; k < 5; ++k)
      for (int j = 0; j < 5; ++j)
        for (int i = 0; i < 5; ++i)
          if (random.next() < 0.6) blocks.push_back({i, j, k});
    blocks = fill_to_visible(blocks);
    TriangleMesh surface = voxel_shapes::sphere(2.5);
    surface.vertices.rowwise() += Vec3::Constant(2.5).transpose();
    const LayeredGrid grid = layer_on_lattice(blocks, 1 + trial % 2, TargetSurface(surface), 1 + trial % 2, 0.1);
    EXPECT_TRUE(inverted_cells(grid).empty()) << trial;
  }
}

TEST(TargetSurface, takes_every_direction_between_the_faces_of_an_edge_for_a_normal) {
  const TargetSurface box(voxel_shapes::box(2, 2, 2));
  const Vec3 at_edge(2, 2, 1), at_face(2, 1.2, 1), at_corner(2, 2, 2);
  const Vec3 between = Vec3(1, 0.3, 0).normalized();
  EXPECT_LT((box.nearest_normal(at_edge, between, 1e-6) - between).norm(), 1e-9);
  EXPECT_LT((box.nearest_normal(at_face, between, 1e-6) - Vec3::UnitX()).norm(), 1e-9);
  const Vec3 oblique = Vec3(0.2, 0.5, 0.9).normalized();
  EXPECT_LT((box.nearest_normal(at_corner, oblique, 1e-6) - oblique).norm(), 1e-9);
  // Outside the cone: the nearest of its sides.
  EXPECT_LT((box.nearest_normal(at_edge, Vec3(0.5, 0.5, 5).normalized(), 1e-6) - Vec3(1, 1, 0).normalized()).norm(),
            1e-9);
  EXPECT_EQ(box.nearest_normal(Vec3(1, 1, 1), between, 1e-6), Vec3(Vec3::Zero()));
}

TEST(HexahedraOptimization, keeps_a_box_and_mends_a_folded_corner) {
  std::vector<LatticeHexahedron> cells = {{0, 1, 2, 3, 4, 5, 6, 7}};
  VertexMatrix points(8, 3);
  for (int k = 0; k < 8; ++k) points.row(k) << (k & 1), (k >> 1 & 1), (k >> 2);
  const VertexMatrix box = points;
  HexahedraOptimization optimization(cells, {Vec3i::Zero()}, {1.0});
  EXPECT_NEAR(optimization.minimize(points, 10, 0), 1, 1e-12);
  EXPECT_LT((points - box).norm(), 1e-6);
  points.row(7) << -0.5, -0.5, -0.5;
  EXPECT_LT(optimization.least_corner_jacobian(points), 0);
  optimization.minimize(points, 200, 0.1);
  EXPECT_GT(optimization.least_corner_jacobian(points), 0.5);
}

// An odd number of cells, one of them judged inside too, far from the origin.
TEST(HexahedraOptimization, comes_to_the_same_in_single_precision) {
  const LatticeGrid grid = refine_blocks({{0, 0, 0}, {1, 0, 0}, {1, 1, 0}}, 3);
  VertexMatrix start = grid.points;
  RandomStream random(5, 9);
  for (Eigen::Index i = 0; i < start.size(); ++i) start.data()[i] += 300 + 0.2 * (random.next() - 0.5);
  VertexMatrix results[2];
  double energies[2];
  for (int single = 0; single < 2; ++single) {
    HexahedraOptimization optimization(grid.cells, grid.cell_lattice, std::vector<double>(grid.cells.size(), 1.0));
    optimization.single_precision = single == 1;
    optimization.inside.assign(grid.cells.size(), 0);
    optimization.inside[4] = 1;
    optimization.cell_weight.assign(grid.cells.size(), 1.0);
    optimization.cell_weight[7] = 3;
    optimization.plane_attractions.push_back({0, start.row(0).transpose(), Vec3::UnitX(), 10, 0.5});
    results[single] = start;
    energies[single] = optimization.minimize(results[single], 200, 0);
    EXPECT_LT(energies[single], 1.001 * (static_cast<double>(grid.cells.size()) + 4)) << "an undistorted grid";
  }
  EXPECT_NEAR(energies[0], energies[1], 1e-4 * energies[0]);
  EXPECT_LT((results[0] - results[1]).cwiseAbs().maxCoeff(), 0.02);
}

TEST(HexahedraOptimization, measures_a_box_and_sees_a_folded_cell) {
  VertexMatrix points(8, 3);
  for (int k = 0; k < 8; ++k) points.row(k) << (k & 1), (k >> 1 & 1), (k >> 2);
  const LatticeHexahedron cell = {0, 1, 2, 3, 4, 5, 6, 7};
  EXPECT_NEAR(least_jacobian(points, cell), 1, 1e-12);
  EXPECT_NEAR(scaled_jacobian(points, cell), 1, 1e-12);
  points.row(7) << 0.2, 0.2, 0.2;
  EXPECT_LT(least_jacobian(points, cell), 0);
}

// The bound that spares the Gauss points never claims more than they give.
TEST(HexahedraOptimization, bounds_the_jacobian_from_below) {
  RandomStream random(5, 9);
  int spared = 0;
  for (int trial = 0; trial < 2000; ++trial) {
    VertexMatrix points(8, 3);
    const double noise = 0.8 * random.next();
    for (int k = 0; k < 8; ++k)
      points.row(k) << (k & 1) + noise * (random.next() - 0.5), (k >> 1 & 1) + noise * (random.next() - 0.5),
          (k >> 2) + noise * (random.next() - 0.5);
    const LatticeHexahedron cell = {0, 1, 2, 3, 4, 5, 6, 7};
    const double exact = least_jacobian(points, cell);
    for (double enough : {0.0, 0.3}) {
      const double bound = least_jacobian(points, cell, enough);
      EXPECT_LE(bound, exact + 1e-14);
      if (bound <= enough) EXPECT_EQ(bound, exact);
      spared += bound != exact;
    }
  }
  EXPECT_GT(spared, 500);
}

TEST(HexahedraOptimization, sees_a_cell_inverted_between_its_corners) {
  // Positive at the corners, negative inside: of random cells, the first such one.
  std::vector<LatticeHexahedron> cells = {{0, 1, 2, 3, 4, 5, 6, 7}};
  VertexMatrix points(8, 3);
  double corners = 0, inside = 0;
  for (std::uint64_t seed = 0; seed < 1000000 && !(corners > 0.01 && inside < -0.005); ++seed) {
    RandomStream random(7, seed);
    for (int k = 0; k < 8; ++k)
      points.row(k) << (k & 1) + 1.4 * random.next(), (k >> 1 & 1) + 1.4 * random.next(),
          (k >> 2) + 1.4 * random.next();
    corners = 1e300;
    for (double determinant : corner_jacobians(points, cells[0])) corners = std::min(corners, determinant);
    inside = least_jacobian(points, cells[0]);
  }
  ASSERT_GT(corners, 0);
  ASSERT_LT(inside, 0);
  HexahedraOptimization optimization(cells, {Vec3i::Zero()}, {1.0});
  EXPECT_GT(optimization.least_corner_jacobian(points), 0);
  optimization.inside = {1};
  EXPECT_LT(optimization.least_corner_jacobian(points), 0);
  optimization.minimize(points, 200, 0.1);
  EXPECT_GT(least_jacobian(points, cells[0]), 0.5);
}

TEST(BlockGrid, counts_the_euler_characteristic_of_simple_bodies) {
  BlockGrid grid(Vec3i::Constant(7));
  for (int i = 2; i <= 4; ++i)
    for (int j = 2; j <= 4; ++j) grid.filled[grid.index(i, j, 3)] = 1;
  EXPECT_EQ(boundary_euler_characteristic(grid), 2);
  EXPECT_EQ(count_singularities(grid).corners, 8);
  EXPECT_FALSE(is_simple_flip(grid, {3, 3, 3}));  // would drill a hole
  EXPECT_TRUE(is_simple_flip(grid, {2, 2, 3}));
  EXPECT_TRUE(is_simple_flip(grid, {3, 3, 4}));
  EXPECT_FALSE(is_simple_flip(grid, {1, 1, 3}));  // would touch along an edge only
  grid.filled[grid.index(3, 3, 3)] = 0;
  EXPECT_EQ(boundary_euler_characteristic(grid), 0);
  EXPECT_FALSE(is_simple_flip(grid, {3, 3, 3}));
}

TEST(Tetrahedralize, fills_a_closed_surface_and_returns_its_boundary) {
  const TriangleMesh surface = voxel_shapes::torus(10, 4);
  const TetrahedralizeResult result = tetrahedralize(surface, {});
  EXPECT_FALSE(result.simplified);
  const TriangleMesh boundary = boundary_of(result.mesh);
  EXPECT_EQ(boundary.face_count(), surface.face_count());
  EXPECT_NEAR(enclosed_volume(boundary), enclosed_volume(surface), 1e-9 * enclosed_volume(surface));
  EXPECT_EQ(genus(boundary), 1);
}

TEST(Tetrahedralize, simplifies_a_heavy_surface_without_changing_its_genus) {
  const TriangleMesh surface = voxel_shapes::torus(10, 4, 120, 60);
  TetrahedralizeOptions options;
  options.proxy_faces = 3000;
  const TetrahedralizeResult result = tetrahedralize(surface, options);
  EXPECT_TRUE(result.simplified);
  EXPECT_LE(result.surface_faces, 3000);
  const TriangleMesh boundary = boundary_of(result.mesh);
  EXPECT_EQ(genus(boundary), 1);
  EXPECT_NEAR(enclosed_volume(boundary), enclosed_volume(surface), 0.01 * enclosed_volume(surface));
}

TEST(Tetrahedralize, fills_a_surface_as_finely_as_asked) {
  const TriangleMesh surface = voxel_shapes::torus(10, 4, 60, 26);
  const std::int64_t plain = tetrahedralize(surface, {}).mesh.tetrahedra.rows();
  std::int64_t counts[2];
  for (int k = 0; k < 2; ++k) {
    TetrahedralizeOptions options;
    options.spacing = k == 0 ? 1.2 : 0.6;
    const TetrahedralizeResult result = tetrahedralize(surface, options);
    counts[k] = result.mesh.tetrahedra.rows();
    EXPECT_LT(result.volume / static_cast<double>(counts[k]), 0.18 * std::pow(options.spacing, 3));
    EXPECT_NEAR(result.volume, enclosed_volume(surface), 1e-9 * result.volume);
    EXPECT_EQ(boundary_of(result.mesh).face_count(), surface.face_count());
  }
  EXPECT_GT(counts[0], 2 * plain);
  EXPECT_GT(counts[1], 4 * counts[0]);
  TetrahedralizeOptions fine;
  fine.spacing = 1e-4;
  EXPECT_THROW(tetrahedralize(surface, fine), InputError);
}

TEST(Tetrahedralize, refuses_a_surface_that_crosses_itself) {
  const TriangleMesh a = voxel_shapes::box(2, 2, 2);
  TriangleMesh both;
  both.vertices.resize(2 * a.vertices.rows(), 3);
  both.vertices << a.vertices, (a.vertices.rowwise() + Eigen::RowVector3d(1, 0.7, 0.9));
  both.faces.resize(2 * a.faces.rows(), 3);
  both.faces << a.faces, (a.faces.array() + a.vertex_count()).matrix();
  EXPECT_THROW(tetrahedralize(both, {}), InputError);
}

TEST(VoxelPolycube, takes_smaller_blocks_where_the_object_is_thinner_than_their_samples) {
  PolycubeOptions options;
  options.nodes = 2000;
  options.anneal_sweeps = 20;
  const VoxelPolycube plate = build_voxel_polycube(voxel_shapes::box(300, 300, 0.3), options);
  EXPECT_EQ(plate.genus, 0);
  EXPECT_LE(plate.coverage_max, 2.5 * plate.cells_per_block);
  const VoxelPolycube rod = build_voxel_polycube(voxel_shapes::box(100, 1, 1), options);
  EXPECT_EQ(rod.genus, 0);
  EXPECT_LE(rod.coverage_max, 2.5 * rod.cells_per_block);
}

TEST(VoxelPolycube, refuses_what_it_cannot_raster) {
  EXPECT_THROW(build_voxel_polycube(voxel_shapes::box(1000, 1000, 1e-4), {}), InputError);  // of 1e7 blocks and more
  TriangleMesh inside_out = voxel_shapes::box(1, 1, 1);
  inside_out.faces.col(1).swap(inside_out.faces.col(2));
  EXPECT_THROW(build_voxel_polycube(inside_out, {}), InputError);
}

}  // namespace
}  // namespace shellgrid
