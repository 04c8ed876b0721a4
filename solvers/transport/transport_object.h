// SPDX-License-Identifier: AGPL-3.0-or-later
// An object ready for transport.
#pragma once
#include <memory>
#include <variant>

#include "meshing/core/triangle_mesh.h"
#include "solvers/transport/body_walk.h"
#include "solvers/transport/homogeneous_medium.h"

namespace shellgrid {

using TransportMedium = std::variant<HomogeneousMedium>;

// Owns what paths need to know of an object.
class TransportObject {
 public:
  // A homogeneous one. `ior` ≥ 1, inside over outside. Throws: InputError.
  TransportObject(const TriangleMesh& mesh, const Material& material, double ior);

  const TriangleMesh& mesh() const { return mesh_; }
  const TransportSurface& surface() const { return *surface_; }
  const TransportMedium& medium() const { return medium_; }
  TransportBody body() const { return {*surface_, clearance_, ior_}; }
  double ior() const { return ior_; }
  // Whether the point lies inside the outer surface.
  bool contains(const Vec3& point) const;

 private:
  TriangleMesh mesh_;
  double ior_;
  TransportMedium medium_;
  std::unique_ptr<TransportSurface> surface_;
  ClearanceGrid clearance_;
};

}  // namespace shellgrid
