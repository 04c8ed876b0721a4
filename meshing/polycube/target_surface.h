// SPDX-License-Identifier: AGPL-3.0-or-later
#pragma once
#include <array>
#include <vector>

#include "meshing/core/triangle_mesh.h"
#include "meshing/surface/closest_point.h"

namespace shellgrid {

// The surface that a grid's boundary seeks: nearest points that prefer triangles facing the same way
// as the grid, so that a thin part's two sides do not attract each other's boundary.
class TargetSurface {
 public:
  struct Nearest {
    Vec3 point = Vec3::Zero();
    Vec3 normal = Vec3::UnitZ();  // unit, outward, interpolated; faces at more than 45° to this one do not count
    Vec3 face_normal = Vec3::UnitZ();
    Vec3 barycentric = Vec3::Zero();
    int face = -1;
    double distance = 0;
  };
  struct Sample {
    Vec3 point;
    Vec3 face_normal;
  };

  explicit TargetSurface(const TriangleMesh& mesh);

  // The point of least distance.
  Nearest nearest(const Vec3& place) const { return complete(query_.nearest(place)); }
  // The point of least distance²·(2 − facing·face normal); facing is unit.
  Nearest nearest_facing(const Vec3& place, const Vec3& facing) const {
    return complete(query_.nearest_facing(place, facing));
  }
  // The same among faces that look the same way as `facing`, within 75°; where none is nearer than `limit`, among all.
  Nearest nearest_same_side(const Vec3& place, const Vec3& facing, double limit) const {
    const SurfacePoint found = query_.nearest_facing(place, facing, 0.25, limit);
    return found.face_index >= 0 ? complete(found) : nearest_facing(place, facing);
  }

  // Whether the way from a place inside the object to one of its surface's points stays inside; gaps narrower than a
  // fiftieth of it may go unseen.
  bool is_way_inside(const Vec3& inside, const Vec3& point) const;
  // As `nearest_same_side` for a place inside the object; but where the way there is longer than `sure` and leaves the
  // object, as to the other side of a gap, the nearest point of all.
  Nearest nearest_from_inside(const Vec3& place, const Vec3& facing, double limit, double sure) const;

  // The unit vector nearest to `direction` in the cone of outward normals at a place of the surface: the normals of all
  // faces nearer than `tolerance` and what lies between them, so that at an edge or a corner every inward direction
  // between its faces' counts as normal. Zero where there is no face.
  Vec3 nearest_normal(const Vec3& place, const Vec3& direction, double tolerance) const;

  // The normal that a link to a point of the surface is measured by: on an edge or a corner of the mesh the surface has
  // a cone of normals, of these the link's own direction.
  Vec3 link_normal(const Nearest& nearest, const Vec3& link) const;

  const TriangleMesh& mesh() const { return mesh_; }
  // `count` points spread evenly by area: midpoints of a systematic walk over the faces.
  std::vector<Sample> samples(int count) const;

 private:
  Nearest complete(const SurfacePoint& found) const;

  TriangleMesh mesh_;
  ClosestPointQuery query_;
  std::vector<Vec3> face_normals_;
  std::vector<std::array<Vec3, 3>> corner_normals_;
};

}  // namespace shellgrid
