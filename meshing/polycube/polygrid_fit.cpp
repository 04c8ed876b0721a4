// SPDX-License-Identifier: AGPL-3.0-or-later
#include "meshing/polycube/polygrid_fit.h"

#include <algorithm>
#include <vector>

#include "meshing/surface/surface_fit.h"

namespace shellgrid {

double polygrid_misfit(const Polygrid& polygrid, const TriangleMesh& surface) {
  constexpr Eigen::Index most = 2000;
  const Eigen::Index quads = polygrid.boundary_quads.rows(), stride = std::max<Eigen::Index>(1, quads / most);
  std::vector<PlaceAtDistance> places;
  for (Eigen::Index q = 0; q < quads; q += stride)
    places.push_back({polygrid.points.row(polygrid.boundary_quads(q, 0)).transpose(), 0});
  return distance_deviation(places, surface, 0.5);
}

}  // namespace shellgrid
