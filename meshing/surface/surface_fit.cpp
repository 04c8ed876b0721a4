// SPDX-License-Identifier: AGPL-3.0-or-later
#include "meshing/surface/surface_fit.h"

#include <algorithm>
#include <cmath>

#include "meshing/core/error.h"
#include "meshing/core/parallel.h"
#include "meshing/surface/closest_point.h"

namespace shellgrid {

double distance_deviation(const std::vector<PlaceAtDistance>& places, const TriangleMesh& mesh, double share) {
  if (mesh.face_count() == 0) throw InputError("the surface has no faces");
  if (places.empty()) return 0;
  const ClosestPointQuery query(mesh);
  std::vector<double> deviation(places.size());
  parallel_for(
      places.size(),
      [&](std::size_t k) {
        deviation[k] = std::abs(std::sqrt(query.nearest(places[k].point).squared_distance) - places[k].distance);
      },
      64);
  const auto rank = static_cast<std::ptrdiff_t>(std::clamp(share, 0.0, 1.0) * static_cast<double>(places.size() - 1));
  std::nth_element(deviation.begin(), deviation.begin() + rank, deviation.end());
  return deviation[static_cast<std::size_t>(rank)];
}

}  // namespace shellgrid
