// SPDX-License-Identifier: AGPL-3.0-or-later
#include "solvers/transport/transport_object.h"

#include <cmath>

#include "meshing/core/error.h"
#include "meshing/shell/voxel_boundary.h"
#include "solvers/transport/core_voxels.h"

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

TransportObject::TransportObject(const TriangleMesh& mesh, double ior)
    : mesh_(mesh), ior_(ior), medium_(HomogeneousMedium(Material())) {
  if (!(ior >= 1) || !std::isfinite(ior)) throw InputError("the refractive index must be at least 1");
  surface_ = std::make_unique<TransportSurface>(mesh_, TriangleMesh());
}

TransportObject::TransportObject(const TriangleMesh& mesh, const Material& material, double ior)
    : TransportObject(mesh, ior) {
  medium_ = HomogeneousMedium(material);
  clearance_ = surface_clearance(mesh_, TriangleMesh());
  distance_ = std::make_unique<SurfaceDistance>(std::vector<TriangleMesh>{mesh_});
}

void TransportObject::set_free_space(const GridFrame& frame, const std::vector<Vec3i>& voxels) {
  free_space_ = voxel_boundary(frame, voxels);
  if (free_space_.face_count() > 0) surface_ = std::make_unique<TransportSurface>(mesh_, free_space_);
}

TransportObject::TransportObject(const TriangleMesh& mesh, const ShellVolume& shell, double ior,
                                 const LeafMethod* method)
    : TransportObject(mesh, ior) {
  const auto inside = [this](const Vec3& point) { return contains(point); };
  std::vector<Vec3i> free_voxels;
  medium_ = shell.core_interpolated ? ShellMedium(with_core_voxels(shell, inside), inside, &free_voxels, method)
                                    : ShellMedium(shell, inside, &free_voxels, method);
  set_free_space(shell.frame, free_voxels);
  clearance_ = surface_clearance(mesh_, free_space_);
  distance_ = std::make_unique<SurfaceDistance>(std::vector<TriangleMesh>{mesh_, free_space_});
}

TransportObject TransportObject::of_surfaces(const TriangleMesh& mesh, const ShellVolume& shell, double ior) {
  TransportObject object(mesh, ior);
  check_shell_materials(shell);
  object.set_free_space(shell.frame,
                        free_voxels_of(shell, [&object](const Vec3& point) { return object.contains(point); }));
  return object;
}

bool TransportObject::contains(const Vec3& point, SurfaceKind surface) const {
  // Fixed directions; the side of the first face in each, the majority deciding.
  constexpr int directions = 7;
  constexpr double infinite = std::numeric_limits<double>::infinity();
  const auto kind = static_cast<std::size_t>(surface);
  int votes = 0;
  for (int i = 0; i < directions; ++i) {
    const double z = 1 - (2 * i + 1.0) / directions, angle = 2.399963229728653 * i + 0.7, r = std::sqrt(1 - z * z);
    const Vec3 direction(r * std::cos(angle), r * std::sin(angle), z);
    // Past the crossings of the other surface.
    const auto first = [&](bool leaves) {
      Crossing crossing;
      std::array<bool, 2> inside = {leaves, leaves};
      Vec3 from = point;
      double way = 0;
      while (surface_->next(from, direction, infinite, inside, crossing)) {
        way += crossing.distance;
        if (crossing.surface == surface) return way;
        inside[1 - kind] = !inside[1 - kind];
        from = crossing.point;
      }
      return infinite;
    };
    const double out = first(true);
    votes += out < infinite && out < first(false);
  }
  return 2 * votes > directions;
}

}  // namespace shellgrid
