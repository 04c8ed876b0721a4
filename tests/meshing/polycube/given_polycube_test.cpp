// SPDX-License-Identifier: AGPL-3.0-or-later
#include "meshing/polycube/given_polycube.h"

#include <gtest/gtest.h>

#include <fstream>
#include <functional>

#include "meshing/core/error.h"
#include "meshing/formats/cube_list_file.h"
#include "meshing/polycube/counted_polycube.h"
#include "meshing/polycube/polycube_map.h"
#include "tests/meshing/polycube/shapes.h"

namespace shellgrid {
namespace {

using voxel_shapes::voxel_surface;

std::string message_of(const std::function<void()>& call) {
  try {
    call();
  } catch (const InputError& error) {
    return error.what();
  }
  return "";
}

// A ring of eight cubes around (0, 0, 0), which may lie anywhere in Z³.
CubeList ring(const Vec3i& at = Vec3i(-7, 3, 100)) {
  CubeList list;
  for (int i = -1; i <= 1; ++i)
    for (int j = -1; j <= 1; ++j)
      if (i != 0 || j != 0) list.cubes.push_back(at + Vec3i(i, j, 0));
  return list;
}

// A square ring of 24×24×8 cells with a hole of 8×8.
TriangleMesh ring_surface() {
  return voxel_surface(
      {24, 24, 8}, [](int i, int j, int) { return i < 8 || i >= 16 || j < 8 || j >= 16; }, 4);
}

TEST(GivenPolycube, CubesAreLaidOverTheBoundingBox) {
  GivenPolycubeOptions options;
  options.nodes = 8 * 64;
  const TriangleMesh surface = ring_surface();
  const GivenPolycube placed = place_given_polycube(ring(), surface, options);
  const VoxelPolycube& polycube = placed.polycube;
  EXPECT_EQ(placed.placement, CubePlacement::box);
  EXPECT_EQ(polycube.blocks.size(), 8u);
  EXPECT_EQ(polycube.cells_per_block, 4);
  EXPECT_EQ(polycube.genus, 1);
  EXPECT_EQ(polycube.object_genus, 1);
  const Vec3 centre = 0.5 * (surface.vertices.colwise().minCoeff() + surface.vertices.colwise().maxCoeff()).transpose();
  const double edge = polycube.spacing * polycube.cells_per_block;
  EXPECT_LT((polycube.origin + edge * Vec3(1.5, 1.5, 0.5) - centre).norm(), 1e-9);
  EXPECT_NEAR(edge, 8, 0.2);
  EXPECT_GT(placed.overlap, 0.9);
  EXPECT_LT(polycube.coverage_max, 0.5);
}

TEST(GivenPolycube, OriginAndEdgeOverrideThePlacement) {
  GivenPolycubeOptions options;
  options.origin = Vec3(8 + 7 * 8, 8 - 3 * 8, -100 * 8);
  options.edge = 8;
  options.grid = 3;
  const VoxelPolycube polycube = place_given_polycube(ring(), ring_surface(), options).polycube;
  EXPECT_LT(polycube.origin.norm(), 1e-9);
  EXPECT_EQ(polycube.cells_per_block, 3);
  options.origin = Vec3(1e4, 0, 0);
  EXPECT_NE(message_of([&] { place_given_polycube(ring(), ring_surface(), options); }).find("0 % of the object"),
            std::string::npos);
}

TEST(GivenPolycube, CubesThatAreNoPolycubeAreRefused) {
  const TriangleMesh surface = ring_surface();
  const auto refusal = [&](const CubeList& list) {
    return message_of([&] { place_given_polycube(list, surface, {}); });
  };
  EXPECT_NE(refusal({}).find("no cubes"), std::string::npos);
  EXPECT_NE(refusal({{{0, 0, 0}, {1, 0, 0}, {0, 0, 0}}}).find("cube 0 0 0 is listed twice"), std::string::npos);
  EXPECT_NE(refusal({{{0, 0, 0}, {1, 0, 0}, {9, 0, 0}}}).find("1 of 3 are apart"), std::string::npos);
  EXPECT_NE(refusal({{{0, 0, 0}, {1, 0, 0}, {1, 1, 0}, {1, 1, 1}, {0, 1, 1}}}).find("no manifold"), std::string::npos);
  CubeList hollow;
  for (int k = 0; k < 27; ++k)
    if (k != 13) hollow.cubes.push_back({k % 3, k / 3 % 3, k / 9});
  EXPECT_NE(refusal(hollow).find("cavity of 1 cubes"), std::string::npos);
  EXPECT_NE(refusal({{{0, 0, 0}, {2000000000, 0, 0}}}).find("at most 512"), std::string::npos);
}

TEST(GivenPolycube, AnotherGenusIsToldNotRefused) {
  CubeList list;
  for (int k = 0; k < 9; ++k) list.cubes.push_back({k % 3, k / 3, 0});
  const VoxelPolycube polycube = place_given_polycube(list, ring_surface(), {}).polycube;
  EXPECT_EQ(polycube.genus, 0);
  EXPECT_EQ(polycube.object_genus, 1);
}

TEST(GivenPolycube, AMeshOfCubesIsReadBackWhateverItsFacesAndPlace) {
  VoxelPolycube polycube;
  for (const Vec3i& c : ring({1, 1, 0}).cubes) polycube.blocks.push_back(c);
  std::sort(polycube.blocks.begin(), polycube.blocks.end(),
            [](const Vec3i& a, const Vec3i& b) { return a.y() != b.y() ? a.y() < b.y() : a.x() < b.x(); });
  polycube.origin = {-3.7, 11.3, 0.01};
  polycube.spacing = 0.37;
  polycube.cells_per_block = 4;
  TriangleMesh mesh = polycube_surface(polycube);
  const CubeList list = cubes_of_mesh(mesh);
  EXPECT_EQ(list.cubes, polycube.blocks);
  EXPECT_NEAR(list.edge, 1.48, 1e-9);
  EXPECT_LT((list.origin - polycube.origin).norm(), 1e-9);
  // A box of 2×3×5 takes the greatest cubes that fit: 30 of edge 1.
  const TriangleMesh box = voxel_surface(
      {1, 1, 1}, [](int, int, int) { return true; }, 0);
  TriangleMesh long_box = box;
  long_box.vertices = box.vertices * Eigen::DiagonalMatrix<double, 3>(2, 3, 5);
  EXPECT_EQ(cubes_of_mesh(long_box).cubes.size(), 30u);
  mesh.vertices(0, 2) += 0.3;
  EXPECT_NE(message_of([&] { cubes_of_mesh(mesh); }).find("not aligned"), std::string::npos);
  long_box.vertices = box.vertices * Eigen::DiagonalMatrix<double, 3>(2, 3.14159265, 5);
  EXPECT_NE(message_of([&] { cubes_of_mesh(long_box); }).find("no common lattice"), std::string::npos);
}

TEST(GivenPolycube, ListsOfCubesAreReadAndBrokenOnesRefusedByLine) {
  const std::string folder = testing::TempDir();
  const auto written = [&](const std::string& name, const std::string& text) {
    std::ofstream(folder + name) << text;
    return folder + name;
  };
  const std::vector<Vec3i> wanted = {{0, 0, 0}, {1, 0, -2}};
  EXPECT_EQ(read_cube_list(written("a.txt", "# two\n0 0 0\r\n\n1, 0,\t-2 # the other")).cubes, wanted);
  EXPECT_EQ(read_cube_list(written("a.json", "[[0,0,0],[1,0,-2]]")).cubes, wanted);
  const CubeList placed =
      read_cube_list(written("b.json", R"({"cubes": [[0,0,0],[1,0,-2]], "origin": [1, 2.5, -3], "edge": 4})"));
  EXPECT_EQ(placed.cubes, wanted);
  EXPECT_TRUE(placed.placed);
  EXPECT_EQ(placed.origin, Vec3(1, 2.5, -3));
  EXPECT_EQ(placed.edge, 4);
  const auto refusal = [&](const std::string& name, const std::string& text) {
    return message_of([&] { read_cube_list(written(name, text)); });
  };
  EXPECT_NE(refusal("c.txt", "0 0 0\n1 0\n").find("line 2: 2 numbers"), std::string::npos);
  EXPECT_NE(refusal("c.txt", "0 0 0\n1 0 0.5\n").find("line 2"), std::string::npos);
  EXPECT_NE(refusal("c.txt", "99999999999 0 0").find("line 1"), std::string::npos);
  EXPECT_NE(refusal("c.txt", "# nothing\n").find("no cubes"), std::string::npos);
  EXPECT_NE(refusal("c.json", "[[0,0,0],[1,0]]").find("cube 1"), std::string::npos);
  EXPECT_NE(refusal("c.json", "[[0,0,1e300]]").find("cube 0"), std::string::npos);
  EXPECT_NE(refusal("c.json", "[[0,0,18446744073709551615]]").find("cube 0"), std::string::npos);
  EXPECT_NE(refusal("c.json", "{\"cubes\": [[0,0,0]], \"edge\": 4}").find("together"), std::string::npos);
  EXPECT_NE(refusal("c.json", "{\"cubse\": []}").find("unknown key"), std::string::npos);
  EXPECT_NE(refusal("c.json", "[[0,0").find("no JSON"), std::string::npos);
  EXPECT_NE(refusal("c.doc", "0 0 0").find("unknown kind"), std::string::npos);
}

TEST(CountedPolycube, TheCountOfCubesIsMetAndNodesAreTheGraphs) {
  const TriangleMesh surface = ring_surface();
  PolycubeOptions options;
  options.blocks = 253;
  options.grid = 4;
  const VoxelPolycube polycube = build_counted_polycube(surface, options);
  EXPECT_EQ(polycube.cells_per_block, 4);
  EXPECT_EQ(polycube.genus, 1);
  EXPECT_NEAR(static_cast<double>(polycube.blocks.size()), 253, 26);
  VoxelPolycube two;
  two.blocks = {{0, 0, 0}, {1, 0, 0}};
  two.cells_per_block = 3;
  EXPECT_EQ(polygrid_nodes(two), 2 * 27 + 10 * 9);
}

}  // namespace
}  // namespace shellgrid
