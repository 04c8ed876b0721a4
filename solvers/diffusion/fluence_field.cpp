// SPDX-License-Identifier: AGPL-3.0-or-later
#include "solvers/diffusion/fluence_field.h"

#include <Eigen/LU>
#include <algorithm>
#include <utility>

#include "meshing/core/error.h"
#include "solvers/diffusion/trilinear_cell.h"

namespace shellgrid {

namespace {

constexpr int newton_steps = 12;
constexpr double converged = 1e-9;  // of a hexahedron's edges
constexpr double inside = 1e-16;    // mm², of rounding

}  // namespace

FluenceField::FluenceField(VertexMatrix points, std::vector<std::int64_t> cells, std::vector<Rgb> fluence)
    : points_(std::move(points)), cells_(std::move(cells)), fluence_(std::move(fluence)) {
  if (static_cast<std::size_t>(points_.rows()) != fluence_.size() || cells_.empty() || cells_.size() % 8 != 0)
    throw InputError("fluence: its lists do not fit its hexahedra");
  for (const std::int64_t corner : cells_)
    if (corner < 0 || corner >= points_.rows()) throw InputError("fluence: a corner is no point");
  for (const Rgb& value : fluence_)
    if (!value.isFinite().all()) throw InputError("fluence: a value is not finite");
  std::vector<Box> boxes(cells_.size() / 8);
  for (std::size_t c = 0; c < boxes.size(); ++c)
    for (int a = 0; a < 8; ++a) boxes[c].add(points_.row(cells_[8 * c + a]).transpose());
  tree_ = BoxTree(boxes);
}

FluenceField::Place FluenceField::nearest_place(std::size_t cell, const Vec3& point) const {
  CellCorners corners;
  for (int a = 0; a < 8; ++a) corners.row(a) = points_.row(cells_[8 * cell + a]);
  // Newton's steps, held within the hexahedron: of points outside not exactly the nearest place, but one of its faces.
  Vec3 at = Vec3::Constant(0.5);
  const auto miss_at = [&](const TrilinearShape& shape) -> Vec3 {
    Vec3 miss = point;
    for (int a = 0; a < 8; ++a) miss -= shape.value[a] * corners.row(a).transpose();
    return miss;
  };
  Place best{at, std::numeric_limits<double>::infinity()};
  for (int n = 0; n < newton_steps; ++n) {
    const TrilinearShape shape(at);
    const Vec3 miss = miss_at(shape);
    if (miss.squaredNorm() < best.squared_distance) best = {at, miss.squaredNorm()};
    const Mat3 jacobian = corners.transpose() * shape.gradient;
    const double volume = jacobian.determinant();
    if (!(std::abs(volume) > 0)) break;
    const Vec3 step = jacobian.inverse() * miss;
    if (!step.allFinite() || step.norm() < converged) break;
    const Vec3 next = (at + step).cwiseMax(0).cwiseMin(1);
    if ((next - at).norm() < converged) break;
    at = next;
  }
  return best;
}

FluenceField::Value FluenceField::at(const Vec3& point) const {
  double best = std::numeric_limits<double>::infinity();
  std::size_t cell = 0;
  Place place{Vec3::Zero(), best};
  tree_.search(point, best, [&](int leaf) {
    for (int slot = 0; slot < BoxTree::width; ++slot) {
      const int item = tree_.item(leaf, slot);
      if (item < 0) continue;
      const Place found = nearest_place(static_cast<std::size_t>(item), point);
      if (!(found.squared_distance < best)) continue;
      place = found;
      cell = static_cast<std::size_t>(item);
      best = found.squared_distance > inside ? found.squared_distance : -1;  // −1: nothing is nearer
    }
  });
  const TrilinearShape shape(place.reference);
  CellCorners corners;
  Eigen::Matrix<double, 3, 8> values;
  for (int a = 0; a < 8; ++a) {
    corners.row(a) = points_.row(cells_[8 * cell + a]);
    values.col(a) = fluence_[cells_[8 * cell + a]].cast<double>().matrix();
  }
  Value value;
  value.distance = std::sqrt(place.squared_distance);
  const Mat3 jacobian = corners.transpose() * shape.gradient;
  for (int a = 0; a < 8; ++a) value.fluence += static_cast<float>(shape.value[a]) * fluence_[cells_[8 * cell + a]];
  if (std::abs(jacobian.determinant()) > 0) value.gradient = values * shape.gradient * jacobian.inverse();
  if (!value.gradient.allFinite()) value.gradient.setZero();
  return value;
}

}  // namespace shellgrid
