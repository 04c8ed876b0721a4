// SPDX-License-Identifier: AGPL-3.0-or-later
// Where in the sample a point below a textured surface lies.
#pragma once
#include <vector>

#include "meshing/core/triangle_mesh.h"
#include "synthesis/textured_surface.h"

namespace shellgrid {

enum class ShellCoordinates {
  nearest,      // those of the nearest vertex: the paper's
  interpolated  // continued from the vertices of the triangle that the point lies below
};

// A place of the surface in the sample, and the frame in which the sample stands there.
struct SurfacePlace {
  int sample = 0;
  Vec2f coordinate = Vec2f::Zero();  // texels of that sample, not wrapped
  Vec3 u = Vec3::Zero(), v = Vec3::Zero(), normal = Vec3::Zero();
  bool coherent = false;  // all three vertices of the triangle continue each other
};

// Looks up places of a textured surface. Each vertex of a triangle says which coordinate the point has: its own plus
// the way from it in its own frame. What the vertex with the greatest barycentric weight says holds, blended with what
// those of the others say that agree with it to `reach` texels; so within a patch coordinates run at the sample's own
// scale whatever the mesh, and between patches there is an edge and no mixture. Blending is continuous across the
// edges of triangles of one patch.
// Deviates: [STF §6] takes the nearest vertex's coordinate as it is, which is `nearest`.
class SurfacePlaces {
 public:
  // sizes: each sample's n_x, n_y; voxel: a texel's length where the scale is 1, mm. The mesh must outlive this.
  SurfacePlaces(const TexturedMesh& mesh, const std::vector<Eigen::Vector2i>& sizes, double voxel);

  SurfacePlace nearest(int vertex) const;
  // point: on the surface; vertex: the one nearest to it. Where the point lies in no triangle about that vertex or its
  // neighbours, the vertex alone is continued.
  SurfacePlace interpolated(int vertex, const Vec3& point) const;

  static constexpr float reach = 1;  // as where coherence is measured

 private:
  Vec2f continued(int vertex, const Vec3& point) const;

  const TexturedMesh& mesh_;
  std::vector<Eigen::Vector2f> sizes_;
  double voxel_;
  std::vector<std::int32_t> start_, faces_;  // about each vertex
};

}  // namespace shellgrid
