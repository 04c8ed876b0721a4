// SPDX-License-Identifier: AGPL-3.0-or-later
#include "meshing/polycube/polygrid_hierarchy.h"

#include <gtest/gtest.h>

#include <Eigen/Geometry>
#include <map>
#include <set>

#include "meshing/core/error.h"
#include "meshing/polycube/polygrid.h"
#include "tests/support/lattice_polygrid.h"

namespace shellgrid {
namespace {

// A stair of blocks of 3³ cells, so that windows lack children.
Polygrid stair() {
  return test::lattice_polygrid({{0, 0, 0}, {1, 0, 0}, {2, 0, 0}, {1, 0, 1}, {2, 0, 1}, {2, 1, 0}}, 3);
}

TEST(PolygridHierarchy, ANodeIsTheMeanOfItsUpToEightChildren) {
  Polygrid grid = stair();
  grid.graph.interior += 0.2 * VertexMatrix::Random(grid.graph.interior.rows(), 3);
  const std::vector<PolygridLevel> levels = build_hierarchy(grid);
  ASSERT_GE(levels.size(), 2u);
  const PolygridGraph* fine = &grid.graph;
  for (const PolygridLevel& level : levels) {
    const Eigen::Index nodes = level.graph.interior.rows();
    EXPECT_LT(nodes, fine->interior.rows());
    VertexMatrix sum = VertexMatrix::Zero(nodes, 3);
    std::vector<int> children(nodes, 0);
    for (std::size_t i = 0; i < level.parent.size(); ++i) {
      sum.row(level.parent[i]) += fine->interior.row(i);
      ++children[level.parent[i]];
    }
    for (Eigen::Index p = 0; p < nodes; ++p) {
      ASSERT_GE(children[p], 1);
      ASSERT_LE(children[p], 8);
      EXPECT_LT((sum.row(p) / children[p] - level.graph.interior.row(p)).norm(), 1e-12);
    }
    fine = &level.graph;
  }
  // Four windows of the lowest slab's 9×3×3 cells have two layers of four children below three, for example.
  EXPECT_EQ(levels[0].lattice.rows(), 5 * 2 * 2 + 4 * 2 * 1 + 2 * 1 * 2);
}

TEST(PolygridHierarchy, EachSideOfACoarseNodeHasOneLink) {
  const Polygrid grid = stair();
  const PolygridGraph* fine = &grid.graph;
  for (const PolygridLevel& level : build_hierarchy(grid)) {
    const PolygridGraph& graph = level.graph;
    std::vector<int> links(graph.boundary.rows(), 0);
    for (Eigen::Index i = 0; i < graph.links.rows(); ++i)
      for (int side = 0; side < 6; ++side) {
        const std::int32_t link = graph.links(i, side);
        const double step = side & 1 ? 1 : -1;
        if (link >= 0) {
          EXPECT_EQ(level.lattice(link, side / 2) - level.lattice(i, side / 2), step);
        } else {
          ++links[-1 - link];
          EXPECT_EQ(graph.boundary_owner[-1 - link], i);
          EXPECT_GT(step * (graph.boundary(-1 - link, side / 2) - graph.interior(i, side / 2)), 0);
          EXPECT_GT(step * graph.boundary_normal(-1 - link, side / 2), 0.99);
        }
      }
    for (int count : links) EXPECT_EQ(count, 1);
    // A boundary node stands in the middle of its children.
    VertexMatrix sum = VertexMatrix::Zero(graph.boundary.rows(), 3);
    std::vector<int> children(graph.boundary.rows(), 0);
    for (std::size_t b = 0; b < level.boundary_parent.size(); ++b) {
      const std::int32_t parent = level.boundary_parent[b];
      if (parent < 0) continue;
      EXPECT_EQ(graph.boundary_owner[parent], level.parent[fine->boundary_owner[b]]);
      sum.row(parent) += fine->boundary.row(b);
      ++children[parent];
    }
    for (Eigen::Index b = 0; b < graph.boundary.rows(); ++b) {
      ASSERT_GE(children[b], 1);
      EXPECT_LT((sum.row(b) / children[b] - graph.boundary.row(b)).norm(), 1e-12);
      EXPECT_NEAR((graph.boundary.row(b) - graph.interior.row(graph.boundary_owner[b])).norm(),
                  graph.boundary_distance[b], 1e-12);
    }
    fine = &level.graph;
  }
}

TEST(PolygridHierarchy, PartsThatNearlyTouchShareNoParent) {
  // Plates of two cells with gaps of one: from the second level on two plates meet in one window.
  const Polygrid grid = test::lattice_polygrid(test::comb(4, 2, 24, 2), 1);
  std::vector<std::int32_t> node(grid.graph.interior.rows());
  for (std::size_t i = 0; i < node.size(); ++i) node[i] = static_cast<std::int32_t>(i);
  bool shared_window = false;
  int level_number = 0;
  for (const PolygridLevel& level : build_hierarchy(grid)) {
    ++level_number;
    std::map<std::int32_t, std::set<int>> plates;
    std::map<std::array<int, 3>, std::set<int>> windows;
    for (std::size_t i = 0; i < node.size(); ++i) {
      node[i] = level.parent[node[i]];
      // Above the base's topmost window.
      if (grid.cell_lattice(static_cast<Eigen::Index>(i), 2) < (4 << level_number)) continue;
      const int plate = grid.cell_lattice(static_cast<Eigen::Index>(i), 0) / 3;
      plates[node[i]].insert(plate);
      windows[{level.lattice(node[i], 0), level.lattice(node[i], 1), level.lattice(node[i], 2)}].insert(plate);
    }
    for (const auto& [parent, members] : plates) EXPECT_EQ(members.size(), 1u) << "level " << level_number;
    for (const auto& [place, members] : windows) shared_window = shared_window || members.size() > 1;
  }
  EXPECT_TRUE(shared_window);
}

TEST(PolygridHierarchy, TransfersBetweenPointsReproduceTheLattice) {
  for (const Polygrid& grid : {stair(), test::lattice_polygrid(test::comb(3, 3, 12, 3), 1)}) {
    std::vector<Vec3i> place;
    for (Eigen::Index p = 0; p < grid.points.rows(); ++p) place.push_back(grid.point_lattice.row(p).transpose());
    bool finest = true;
    const std::vector<PointTransfer> transfers = point_transfers(grid);
    ASSERT_GE(transfers.size(), 2u);
    for (const PointTransfer& transfer : transfers) {
      ASSERT_EQ(transfer.start.size(), place.size() + 1);
      std::vector<char> used(transfer.coarse_lattice.size(), 0);
      for (std::size_t p = 0; p < place.size(); ++p) {
        const std::int64_t count = transfer.start[p + 1] - transfer.start[p];
        if (finest && grid.outer_twin[p] >= 0) {
          EXPECT_EQ(count, 0);
          continue;
        }
        ASSERT_TRUE(count == 1 || count == 2 || count == 4 || count == 8);
        Vec3 mean = Vec3::Zero();
        std::set<std::int32_t> parents;
        for (std::int64_t k = transfer.start[p]; k < transfer.start[p + 1]; ++k) {
          mean += transfer.coarse_lattice[transfer.parent[k]].cast<double>() / static_cast<double>(count);
          parents.insert(transfer.parent[k]);
          used[transfer.parent[k]] = 1;
        }
        EXPECT_EQ(parents.size(), static_cast<std::size_t>(count));
        EXPECT_EQ((2 * mean - place[p].cast<double>()).norm(), 0);
      }
      for (char u : used) EXPECT_TRUE(u);
      place = transfer.coarse_lattice;
      finest = false;
    }
  }
}

TEST(PolygridHierarchy, TransfersComeFromTheHierarchyOrTheSameRule) {
  Polygrid grid = test::lattice_polygrid(test::comb(3, 3, 12, 3), 1);
  const std::vector<PointTransfer> computed = point_transfers(grid);
  grid.hierarchy = build_hierarchy(grid);
  const std::vector<PointTransfer> stored = point_transfers(grid);
  ASSERT_EQ(computed.size(), stored.size());
  for (std::size_t l = 0; l < stored.size(); ++l) {
    EXPECT_EQ(computed[l].start, stored[l].start);
    EXPECT_EQ(computed[l].parent, stored[l].parent);
    EXPECT_EQ(computed[l].coarse_lattice, stored[l].coarse_lattice);
  }
  std::swap(grid.hierarchy[0].parent.front(), grid.hierarchy[0].parent.back());
  EXPECT_THROW(point_transfers(grid), InputError);
  grid.hierarchy[0].parent.pop_back();
  EXPECT_THROW(point_transfers(grid), InputError);
}

TEST(PolygridHierarchy, AveragesAreOverTheChildrenThatThereAre) {
  const std::vector<float> values = {1, 2, 6, 5};
  EXPECT_EQ(average_children({0, 0, -1, 2}, 3, values, 0.0f), (std::vector<float>{1.5f, 0, 5}));
}

TEST(PolygridHierarchy, ALevelsViewIsClosedOctahedra) {
  Polygrid grid = stair();
  grid.hierarchy = build_hierarchy(grid);
  const AttributedMesh view = level_view(grid, 1);
  const Eigen::Index nodes = grid.hierarchy[0].graph.interior.rows();
  EXPECT_EQ(view.mesh.face_count(), 8 * nodes);
  double volume = 0;
  for (int f = 0; f < view.mesh.face_count(); ++f)
    volume += view.mesh.corner(f, 0).dot(view.mesh.corner(f, 1).cross(view.mesh.corner(f, 2))) / 6;
  EXPECT_NEAR(volume, static_cast<double>(nodes) * 4 / 3 * std::pow(0.6, 3), 1e-9);
  EXPECT_THROW(level_view(grid, 0), InputError);
  EXPECT_THROW(level_view(grid, 99), InputError);
}

}  // namespace
}  // namespace shellgrid
