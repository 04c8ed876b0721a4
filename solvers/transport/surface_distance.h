// SPDX-License-Identifier: AGPL-3.0-or-later
#pragma once
#include <algorithm>
#include <cmath>
#include <limits>
#include <mutex>
#include <utility>
#include <vector>

#include "meshing/surface/closest_point.h"

namespace shellgrid {

// The distance to the nearest of some meshes, mm. What it needs is built when it is first asked: few objects ask.
// Thread-safe.
class SurfaceDistance {
 public:
  explicit SurfaceDistance(std::vector<TriangleMesh> meshes) : meshes_(std::move(meshes)) {}

  double at(const Vec3& point) const {
    std::call_once(built_, [this] {
      for (const TriangleMesh& mesh : meshes_)
        if (mesh.face_count() > 0) queries_.emplace_back(mesh);
    });
    double least = std::numeric_limits<double>::infinity();
    for (const ClosestPointQuery& query : queries_)
      least = std::min(least, std::sqrt(query.nearest(point).squared_distance));
    return least;
  }

 private:
  std::vector<TriangleMesh> meshes_;
  mutable std::once_flag built_;
  mutable std::vector<ClosestPointQuery> queries_;
};

}  // namespace shellgrid
