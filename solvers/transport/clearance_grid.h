// SPDX-License-Identifier: AGPL-3.0-or-later
#pragma once
#include <cstdint>
#include <functional>
#include <vector>

#include "meshing/core/triangle_mesh.h"

namespace shellgrid {

// For each point of a box, how far it surely is from obstacles: a light path that ends before needs no look at them.
// A regular grid whose cells hold a lower bound of the distance from anywhere in them, in quarters of a cell.
class ClearanceGrid {
 public:
  ClearanceGrid() = default;
  // Over the box from `lower` to `upper` (mm), `longest` cells along its longest side.
  ClearanceGrid(const Vec3& lower, const Vec3& upper, int longest);

  // Obstacles: triangles, or boxes. Then `finish`, once.
  void add(const TriangleMesh& mesh);
  void add_box(const Vec3& lower, const Vec3& upper);
  void finish();

  // mm; 0 where an obstacle may be near, and outside the box.
  double at(const Vec3& point) const {
    const Vec3 cell = (point - lower_) * per_cell_;
    const int i = static_cast<int>(cell.x()), j = static_cast<int>(cell.y()), k = static_cast<int>(cell.z());
    if (!(static_cast<unsigned>(i) < static_cast<unsigned>(count_.x()) &&
          static_cast<unsigned>(j) < static_cast<unsigned>(count_.y()) &&
          static_cast<unsigned>(k) < static_cast<unsigned>(count_.z())))
      return 0;
    return quarter_ * static_cast<double>(steps_[index(i, j, k)]);
  }
  bool contains(const Vec3& point) const {
    return (point.array() >= lower_.array()).all() && (point.array() <= upper_.array()).all();
  }

 private:
  std::size_t index(int i, int j, int k) const {
    return (static_cast<std::size_t>(i) * count_.y() + j) * count_.z() + k;
  }
  void mark(const Vec3& from, const Vec3& to, const std::function<bool(const Vec3& centre)>& touches);

  Vec3 lower_ = Vec3::Zero(), upper_ = Vec3::Zero();
  Vec3i count_ = Vec3i::Zero();
  double cell_ = 1, per_cell_ = 1, quarter_ = 0.25;
  std::vector<std::uint8_t> steps_;  // while obstacles are added: 1 where there is one
};

}  // namespace shellgrid
