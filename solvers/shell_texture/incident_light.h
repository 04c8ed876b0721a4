// SPDX-License-Identifier: AGPL-3.0-or-later
// What light reaches each place of a textured surface, in the sample's frame there.
#pragma once
#include <atomic>
#include <cstdint>
#include <vector>

#include "meshing/core/triangle_mesh.h"
#include "solvers/render/lights.h"
#include "solvers/render/scene_geometry.h"
#include "solvers/shell_texture/shell_texture_lookup.h"

namespace shellgrid {

// A mesh and how the sample stands on it: texture u at each vertex; texture v is normal × u.
struct TexturedFrames {
  const TriangleMesh& mesh;
  const VertexMatrix& normals;     // n×3, unit
  const VertexMatrix& directions;  // n×3, unit, tangent

  Mat3 frame(int vertex) const;  // rows u, v, normal: turns the object's directions into the sample's
};

struct IncidentLightStatistics {
  std::atomic<std::int64_t> shadow_rays{0};
  std::atomic<std::int64_t> shadow_rays_skipped{0};  // of lights below the horizon
};

// Sums up lights at vertices. What hides lights is the mesh: the mesostructure's own shadows are in the shell texture
// function. Source: [STF §7].
class IncidentLight {
 public:
  // All that is given must outlive this. samples: parallel lights that stand for an environment. Throws: InputError
  // where the frames do not have the mesh's size.
  IncidentLight(const TexturedFrames& frames, const SceneGeometry& geometry, const std::vector<Light>& lights,
                const LightDirections& directions, int samples);

  // Light that reaches a vertex, by the table's directions: irradiances across them. Ordered by direction, each once.
  std::vector<DirectionWeight> at(int vertex) const;

  const IncidentLightStatistics& statistics() const { return statistics_; }
  const TexturedFrames& frames() const { return frames_; }
  const LightDirections& directions() const { return directions_; }

 private:
  TexturedFrames frames_;
  const SceneGeometry& geometry_;
  std::vector<SimpleLight> lights_;
  LightDirections directions_;
  mutable IncidentLightStatistics statistics_;
};

}  // namespace shellgrid
