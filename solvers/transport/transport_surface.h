// SPDX-License-Identifier: AGPL-3.0-or-later
// Where light crosses the surfaces of an object.
#pragma once
#include <array>
#include <memory>

#include "meshing/core/triangle_mesh.h"

namespace shellgrid {

// The object's outer surface, and, where its shell has free space, the surface of that.
enum class SurfaceKind : int { outer = 0, free_space = 1 };

struct Crossing {
  SurfaceKind surface = SurfaceKind::outer;
  int face_index = 0;
  Vec3 barycentric = Vec3::Zero();  // weights of the face's corners 0, 1, 2
  double distance = 0;              // along the ray, mm
  Vec3 point = Vec3::Zero();        // on the face, mm
  Vec3 normal = Vec3::Zero();       // of the face, unit, outward from what the surface encloses
};

// Closed surfaces that light crosses. A ray knows which of them it is inside of, and sees only the faces by which it
// may leave those and enter the others: the face that it starts from is none of them, so nothing has to be kept off the
// surface, and a start that rounding has put on the wrong side is corrected, because the ray begins a little before it.
// Queries may come from several threads.
class TransportSurface {
 public:
  // Throws: InputError if the outer mesh has no faces or a coordinate is not finite. `free_space` may have none.
  // The meshes' numbers must stay where they are, as they do when a mesh is moved.
  TransportSurface(const TriangleMesh& outer, const TriangleMesh& free_space);
  ~TransportSurface();
  TransportSurface(TransportSurface&&) noexcept;
  TransportSurface& operator=(TransportSurface&&) noexcept;

  // The nearest crossing not farther than `limit` along `direction` (unit). `inside` by SurfaceKind. Where `before` is
  // false the ray begins a little after its origin instead of a little before it.
  bool next(const Vec3& origin, const Vec3& direction, double limit, const std::array<bool, 2>& inside,
            Crossing& crossing, bool before = true) const;

  const Vec3& centre() const;  // of the outer surface's bounding box
  double radius() const;       // of a sphere about it that holds both surfaces, mm
  // How far before its start a ray begins, mm: 3e-7 of the object's longest side.
  double tolerance() const;

 private:
  struct Impl;
  std::unique_ptr<Impl> impl_;
};

}  // namespace shellgrid
