// SPDX-License-Identifier: AGPL-3.0-or-later
// An object ready for transport.
#pragma once
#include <memory>
#include <variant>

#include "meshing/core/triangle_mesh.h"
#include "solvers/transport/body_walk.h"
#include "solvers/transport/homogeneous_medium.h"
#include "solvers/transport/shell_medium.h"
#include "solvers/transport/surface_distance.h"

namespace shellgrid {

using TransportMedium = std::variant<HomogeneousMedium, ShellMedium>;

// Owns what paths need to know of an object.
class TransportObject {
 public:
  // A homogeneous one. `ior` ≥ 1, inside over outside. Throws: InputError.
  TransportObject(const TriangleMesh& mesh, const Material& material, double ior);

  // A shell of voxels over its core, which is homogeneous or, interpolated, made of voxels too. Where the shell has
  // free space, the surface of that is the object's, too. `method`: nothing, or one for all leaves. Throws: InputError.
  TransportObject(const TriangleMesh& mesh, const ShellVolume& shell, double ior, const LeafMethod* method = nullptr);

  // The surfaces alone, for rays of sight: no `medium`, no `body`. Throws: InputError.
  static TransportObject of_surfaces(const TriangleMesh& mesh, const ShellVolume& shell, double ior);

  const TriangleMesh& mesh() const { return mesh_; }
  const TriangleMesh& free_space() const { return free_space_; }  // its surface; no faces where there is none
  const TransportSurface& surface() const { return *surface_; }
  const TransportMedium& medium() const { return medium_; }
  TransportBody body() const { return {*surface_, clearance_, ior_, distance_.get()}; }
  double ior() const { return ior_; }
  // Whether the point lies inside the outer surface, or the surface of free space.
  bool contains(const Vec3& point, SurfaceKind surface = SurfaceKind::outer) const;
  // Notes of a path that begins outside the object whether it begins in free space that reaches out of it.
  void begin(LightPath& path) const {
    const double radius = surface_->radius();
    if (free_space_.face_count() > 0 && (path.point - surface_->centre()).squaredNorm() < radius * radius)
      path.inside[1] = contains(path.point, SurfaceKind::free_space);
  }

 private:
  TransportObject(const TriangleMesh& mesh, double ior);
  void set_free_space(const GridFrame& frame, const std::vector<Vec3i>& voxels);

  TriangleMesh mesh_, free_space_;
  double ior_;
  TransportMedium medium_;
  std::unique_ptr<TransportSurface> surface_;
  ClearanceGrid clearance_;
  std::unique_ptr<SurfaceDistance> distance_;
};

}  // namespace shellgrid
