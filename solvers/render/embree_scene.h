// SPDX-License-Identifier: AGPL-3.0-or-later
// Embree's device and scene for closed meshes: what every user of rays starts with.
#pragma once
#include <embree3/rtcore.h>

#include "meshing/core/triangle_mesh.h"

namespace shellgrid {

// Embree computes in float: it gets meshes centred on a box and scaled so that its longest edge is one.
class EmbreeScene {
 public:
  // The box is this mesh's. Throws: InputError for a mesh without faces or size, or with coordinates that are not
  // finite.
  explicit EmbreeScene(const TriangleMesh& box);
  ~EmbreeScene();
  EmbreeScene(const EmbreeScene&) = delete;
  EmbreeScene& operator=(const EmbreeScene&) = delete;

  // Adds a mesh under a number; `filter` may drop hits. Throws: InputError for coordinates that are not finite.
  void attach(const TriangleMesh& mesh, unsigned id, RTCFilterFunctionN filter = nullptr);
  // To be called once, after the last mesh. Throws: InternalError.
  void commit();

  RTCScene scene() const { return scene_; }
  const Vec3& centre() const { return centre_; }
  double scale() const { return scale_; }  // mm per unit of Embree's space

 private:
  RTCDevice device_ = nullptr;
  RTCScene scene_ = nullptr;
  Vec3 centre_ = Vec3::Zero();
  double scale_ = 1;
};

}  // namespace shellgrid
