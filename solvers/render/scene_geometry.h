// SPDX-License-Identifier: AGPL-3.0-or-later
#pragma once
#include <cstdint>
#include <limits>
#include <memory>
#include <optional>

#include "meshing/core/triangle_mesh.h"

namespace shellgrid {

// A closed surface that rays can be shot at. Queries may come from several threads.
//
// Rays ignore the first `offset()` of their way, so a ray that starts on the surface does not hit the
// face it starts on; at grazing angles start it `offset()` above the surface.
class SceneGeometry {
 public:
  struct Hit {
    int face_index = 0;
    Vec3 barycentric = Vec3::Zero();  // weights of the face's corners 0, 1, 2
    double distance = 0;              // along the ray, mm
    Vec3 point = Vec3::Zero();        // mm
    Vec3 normal = Vec3::Zero();       // of the face, unit, outward
  };

  // Throws: InputError if the mesh has no faces or a coordinate is not finite.
  explicit SceneGeometry(const TriangleMesh& mesh);
  ~SceneGeometry();
  SceneGeometry(SceneGeometry&&) noexcept;
  SceneGeometry& operator=(SceneGeometry&&) noexcept;

  // Whether anything stands between the origin and the point at `distance` along `direction` (unit).
  bool occluded(const Vec3& origin, const Vec3& direction,
                double distance = std::numeric_limits<double>::infinity()) const;

  // The same for at most `most_rays` rays from one origin; bit i is that of ray i. Faster where they go about the same
  // way.
  static constexpr int most_rays = 8;
  std::uint32_t occluded(const Vec3& origin, const Vec3* directions, const double* distances, int count) const;

  // The nearest hit along `direction` (unit), if any.
  std::optional<Hit> intersect(const Vec3& origin, const Vec3& direction) const;

  // Whether the point lies inside the closed surface: by the side of the first face in each of seven
  // fixed directions, the majority deciding.
  bool contains(const Vec3& point) const;

  // The length a ray must travel to leave the rounding of the surface behind, mm: 2e-5 of the object.
  double offset() const;

 private:
  struct Impl;
  std::unique_ptr<Impl> impl_;
};

}  // namespace shellgrid
