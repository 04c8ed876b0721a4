// SPDX-License-Identifier: AGPL-3.0-or-later
#include "solvers/diffusion/fluence_field.h"

#include <gtest/gtest.h>

#include "meshing/core/error.h"
#include "meshing/core/random.h"
#include "tests/support/lattice_polygrid.h"

namespace shellgrid {
namespace {

struct Field {
  VertexMatrix points;
  std::vector<std::int64_t> cells;
  std::vector<Rgb> fluence;
};

// Blocks of a lattice, their inner points moved about; values linear in the place.
Field linear_field() {
  const Polygrid grid = test::lattice_polygrid({{0, 0, 0}, {1, 0, 0}, {1, 1, 0}}, 4);
  Field f{grid.points, {}, {}};
  for (Eigen::Index c = 0; c < grid.cells.rows(); ++c)
    for (int a = 0; a < 8; ++a) f.cells.push_back(grid.cells(c, a));
  const Mat3 shear = (Mat3() << 1, 0.3, -0.2, 0.1, 1.2, 0.4, 0, -0.1, 0.8).finished();
  for (Eigen::Index p = 0; p < f.points.rows(); ++p) {
    const Vec3 at = shear * f.points.row(p).transpose();
    f.points.row(p) = at.transpose();
    for (int k = 0; k < 3; ++k) f.points(p, k) += 0.02 * (to_unit(hash64(p, k)) - 0.5);
    const Vec3 x = f.points.row(p).transpose();
    f.fluence.emplace_back(static_cast<float>(5 + x.x()), static_cast<float>(7 - 2 * x.y() + x.z()),
                           static_cast<float>(9 + 3 * x.z()));
  }
  return f;
}

TEST(FluenceField, BringsLinearFieldsBack) {
  const Field f = linear_field();
  const FluenceField field(f.points, f.cells, f.fluence);
  for (std::size_t k = 0; k < 400; ++k) {
    const std::size_t cell = hash64(k, 1) % (f.cells.size() / 8);
    Vec3 x = Vec3::Zero();
    double weights = 0;
    for (int a = 0; a < 8; ++a) {
      const double weight = to_unit(hash64(k, 2 + a));
      x += weight * f.points.row(f.cells[8 * cell + a]).transpose();
      weights += weight;
    }
    x /= weights;
    const FluenceField::Value value = field.at(x);
    EXPECT_LT(value.distance, 1e-6);
    EXPECT_NEAR(value.fluence[0], 5 + x.x(), 1e-5);
    EXPECT_NEAR(value.fluence[1], 7 - 2 * x.y() + x.z(), 1e-5);
    EXPECT_TRUE(value.gradient.row(1).isApprox(Eigen::RowVector3d(0, -2, 1), 1e-3)) << value.gradient;
    EXPECT_TRUE(value.gradient.row(2).isApprox(Eigen::RowVector3d(0, 0, 3), 1e-3));
  }
}

TEST(FluenceField, AnswersOutsideByItsNearestPlace) {
  const Polygrid grid = test::lattice_polygrid({{0, 0, 0}}, 2);
  std::vector<std::int64_t> cells;
  for (Eigen::Index c = 0; c < grid.cells.rows(); ++c)
    for (int a = 0; a < 8; ++a) cells.push_back(grid.cells(c, a));
  std::vector<Rgb> fluence;
  for (Eigen::Index p = 0; p < grid.points.rows(); ++p)
    fluence.push_back(Rgb::Constant(static_cast<float>(grid.points(p, 0))));
  const FluenceField field(grid.points, cells, fluence);
  const Vec3 upper = grid.points.colwise().maxCoeff().transpose(), lower = grid.points.colwise().minCoeff().transpose();
  const Vec3 middle = (upper + lower) / 2;
  const FluenceField::Value value = field.at(Vec3(upper.x() + 0.5, middle.y(), middle.z()));
  EXPECT_NEAR(value.distance, 0.5, 1e-6);
  EXPECT_NEAR(value.fluence[0], upper.x(), 1e-5);
}

TEST(FluenceField, RefusesWhatDoesNotFit) {
  Field f = linear_field();
  EXPECT_THROW(FluenceField(f.points, {}, f.fluence), InputError);
  EXPECT_THROW(FluenceField(f.points, f.cells, std::vector<Rgb>(3, Rgb::Zero())), InputError);
  Field wrong = f;
  wrong.cells[5] = f.points.rows();
  EXPECT_THROW(FluenceField(wrong.points, wrong.cells, wrong.fluence), InputError);
  f.fluence[2][1] = std::nanf("");
  EXPECT_THROW(FluenceField(f.points, f.cells, f.fluence), InputError);
}

}  // namespace
}  // namespace shellgrid
