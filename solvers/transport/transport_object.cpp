// SPDX-License-Identifier: AGPL-3.0-or-later
#include "solvers/transport/transport_object.h"

#include <cmath>

#include "meshing/core/error.h"

namespace shellgrid {
namespace {

constexpr int clearance_cells = 128;

ClearanceGrid surface_clearance(const TriangleMesh& outer, const TriangleMesh& free_space) {
  ClearanceGrid grid(outer.vertices.colwise().minCoeff().transpose(), outer.vertices.colwise().maxCoeff().transpose(),
                     clearance_cells);
  grid.add(outer);
  grid.add(free_space);
  grid.finish();
  return grid;
}

}  // namespace

TransportObject::TransportObject(const TriangleMesh& mesh, const Material& material, double ior)
    : mesh_(mesh), ior_(ior), medium_(HomogeneousMedium(material)) {
  if (!(ior >= 1) || !std::isfinite(ior)) throw InputError("the refractive index must be at least 1");
  surface_ = std::make_unique<TransportSurface>(mesh_, TriangleMesh());
  clearance_ = surface_clearance(mesh_, TriangleMesh());
}

bool TransportObject::contains(const Vec3& point) const {
  // Seven fixed directions; the side of the first face in each, the majority deciding.
  constexpr int directions = 7;
  int votes = 0;
  for (int i = 0; i < directions; ++i) {
    const double z = 1 - (2 * i + 1.0) / directions, angle = 2.399963229728653 * i + 0.7, r = std::sqrt(1 - z * z);
    const Vec3 direction(r * std::cos(angle), r * std::sin(angle), z);
    Crossing out, in;
    const double infinite = std::numeric_limits<double>::infinity();
    const bool leaves = surface_->next(point, direction, infinite, {true, false}, out);
    const bool enters = surface_->next(point, direction, infinite, {false, false}, in);
    votes += leaves && (!enters || out.distance < in.distance);
  }
  return 2 * votes > directions;
}

}  // namespace shellgrid
