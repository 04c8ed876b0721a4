// SPDX-License-Identifier: AGPL-3.0-or-later
#include "meshing/polycube/layer_polish.h"

#include <gtest/gtest.h>

#include <Eigen/Geometry>
#include <algorithm>

#include "tests/support/closed_shapes.h"

namespace shellgrid {
namespace {

using shapes::box;
using shapes::joined;
using shapes::moved;

constexpr double edge = 6, thickness = 0.1;

// A cube of 6³ cells with its layer, in a box.
LayeredGrid cube_with_layer() {
  LayeredGrid grid = with_flat_layer(refine_blocks({Vec3i(0, 0, 0)}, static_cast<int>(edge)));
  grid.points.topRows(grid.core.points.rows()) = grid.core.points.cwiseMax(thickness).cwiseMin(edge - thickness);
  grid.core.points = grid.points.topRows(grid.core.points.rows());
  for (std::size_t o = 0; o < grid.twin.size(); ++o)
    grid.points.row(grid.core.points.rows() + static_cast<Eigen::Index>(o)) =
        grid.core.point_lattice[grid.twin[o]].cast<double>().transpose();
  return grid;
}

double worst_shape(const LayeredGrid& grid) {
  double least = 1;
  for (const LatticeHexahedron& cell : all_cells(grid)) least = std::min(least, scaled_jacobian(grid.points, cell));
  return least;
}

// The point whose place in the lattice is this one.
Eigen::Index point_at(const LayeredGrid& grid, const Vec3i& place) {
  for (std::size_t p = 0; p < grid.core.point_lattice.size(); ++p)
    if (grid.core.point_lattice[p] == place) return static_cast<Eigen::Index>(p);
  return -1;
}

Eigen::Index outer_of(const LayeredGrid& grid, Eigen::Index point) {
  const auto found = std::find(grid.twin.begin(), grid.twin.end(), static_cast<std::int32_t>(point));
  return grid.core.points.rows() + (found - grid.twin.begin());
}

class LayerPolish : public ::testing::Test {
 protected:
  TargetSurface surface{moved(box(Vec3::Constant(edge)), Vec3::Constant(edge / 2))};
  LayeredGrid grid = cube_with_layer();

  double distance(Eigen::Index p) const { return surface.nearest(grid.points.row(p).transpose()).distance; }
};

TEST_F(LayerPolish, starts_from_a_layer_on_the_surface) {
  EXPECT_GT(worst_shape(grid), 0.5);
  EXPECT_TRUE(inverted_cells(grid).empty());
  for (Eigen::Index p = grid.core.points.rows(); p < grid.points.rows(); ++p) EXPECT_LT(distance(p), 1e-12);
}

TEST_F(LayerPolish, leaves_good_grids_alone) {
  const VertexMatrix before = grid.points;
  polish_worst_cells(grid, surface, 1, thickness, 0.16, 1000);
  EXPECT_EQ(before, grid.points);
}

TEST_F(LayerPolish, mends_a_squeezed_cell) {
  const Eigen::Index p = point_at(grid, Vec3i(3, 3, 3));
  grid.points.row(p) += Eigen::RowVector3d(0.32, 0.32, 0.32);
  grid.core.points.row(p) = grid.points.row(p);
  const double before = worst_shape(grid);
  ASSERT_LT(before, 0.16);
  ASSERT_TRUE(inverted_cells(grid).empty());
  polish_worst_cells(grid, surface, 1, thickness, 0.16, 1000);
  EXPECT_GT(worst_shape(grid), 0.2);
  EXPECT_TRUE(inverted_cells(grid).empty());
  EXPECT_EQ(grid.core.points, VertexMatrix(grid.points.topRows(grid.core.points.rows())));
}

TEST_F(LayerPolish, turns_a_tilted_link_to_the_normal) {
  const Eigen::Index twin = point_at(grid, Vec3i(3, 3, 6)), outer = outer_of(grid, twin);
  grid.points.row(outer) += Eigen::RowVector3d(0.25, 0.1, 0);
  const auto cosine = [&] {
    const Vec3 link = (grid.points.row(outer) - grid.points.row(twin)).transpose();
    return link.z() / link.norm();
  };
  ASSERT_LT(cosine(), 0.5);
  polish_worst_cells(grid, surface, 1, thickness, 0.16, 1000);
  EXPECT_GT(cosine(), 0.866);
  EXPECT_LT(distance(outer), 1e-9);
  EXPECT_TRUE(inverted_cells(grid).empty());
}

TEST_F(LayerPolish, brings_a_point_back_to_the_surface) {
  const Eigen::Index outer = outer_of(grid, point_at(grid, Vec3i(3, 3, 6)));
  grid.points.row(outer) -= Eigen::RowVector3d(0, 0, 0.06);
  ASSERT_GT(distance(outer), 0.05);
  polish_worst_cells(grid, surface, 1, thickness, 0.16, 1000);
  EXPECT_LT(distance(outer), 2e-3);
}

TEST_F(LayerPolish, touches_no_more_cells_than_allowed) {
  for (int i : {1, 5}) grid.points.row(point_at(grid, Vec3i(i, i, i))) += 0.32 * Eigen::RowVector3d(1, 1, 1);
  const VertexMatrix before = grid.points;
  polish_worst_cells(grid, surface, 1, thickness, 0.16, 0);
  EXPECT_EQ(before, grid.points);
}

TEST(TargetSurface, does_not_reach_across_a_gap) {
  const TriangleMesh sheets =
      joined(moved(box(Vec3(1, 4, 4)), Vec3(0.5, 0, 0)), moved(box(Vec3(1, 4, 4)), Vec3(1.55, 0, 0)));
  const TargetSurface surface(sheets);
  const Vec3 place(0.95, 0.1, 0.2);
  EXPECT_TRUE(surface.is_way_inside(place, Vec3(1, 0.1, 0.2)));
  EXPECT_TRUE(surface.is_way_inside(place, Vec3(0, 0.1, 0.2)));
  EXPECT_FALSE(surface.is_way_inside(place, Vec3(2.05, 0.1, 0.2)));
  // What looks to the left and is nearest is the other sheet's near side.
  EXPECT_NEAR(surface.nearest_same_side(place, Vec3(-1, 0, 0), 2).point.x(), 1.05, 1e-12);
  EXPECT_NEAR(surface.nearest_from_inside(place, Vec3(-1, 0, 0), 2, 0.05).point.x(), 1, 1e-12);
}

}  // namespace
}  // namespace shellgrid
