// SPDX-License-Identifier: AGPL-3.0-or-later
// What light reaches each place of a textured surface, in the sample's frame there.
#pragma once
#include <array>
#include <atomic>
#include <cstdint>
#include <memory>
#include <vector>

#include "meshing/core/triangle_mesh.h"
#include "solvers/diffusion/channel_lanes.h"
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

class SharedVisibility;

struct IncidentLightStatistics {
  std::int64_t shadow_rays = 0;
  std::int64_t shadow_rays_skipped = 0;  // of lights below the horizon
  std::int64_t shadow_rays_shared = 0;   // of faint lights, as places about tell
};

// Sums up lights at vertices. What hides lights is the mesh: the mesostructure's own shadows are in the shell texture
// function. Source: [STF §7].
class IncidentLight {
 public:
  // All that is given must outlive this. samples: parallel lights that stand for an environment. shared: places near
  // each other share what they see of faint ones. Throws: InputError where the frames do not have the mesh's size.
  IncidentLight(const TexturedFrames& frames, const SceneGeometry& geometry, const std::vector<Light>& lights,
                const LightDirections& directions, int samples, bool shared = true);
  ~IncidentLight();

  // Light that reaches a vertex, by the table's directions: irradiances across them. Ordered by direction, each once.
  std::vector<DirectionWeight> at(int vertex) const;

  IncidentLightStatistics statistics() const;
  // Of all light: a parallel light of no greater share is faint.
  static constexpr double faint_share = 0.01;
  const TexturedFrames& frames() const { return frames_; }
  const LightDirections& directions() const { return directions_; }

 private:
  TexturedFrames frames_;
  const SceneGeometry& geometry_;
  // Parallel lights, in blocks of as many as are blended at once; the last one's are filled up with darkness.
  struct Block {
    DirectionBlends::Numbers towards[3] = {};
    std::array<Float4, DirectionBlends::lanes> irradiance = {};
    std::uint32_t lit = 0, faint = 0;  // bits of the lights that shine; of those that share what is seen of them
  };

  std::vector<Block> parallel_;
  std::vector<SimpleLight> near_;  // of which direction and distance change from place to place
  std::unique_ptr<const SharedVisibility> visibility_;
  LightDirections directions_;
  mutable std::atomic<std::int64_t> shadow_rays_{0}, shadow_rays_skipped_{0}, shadow_rays_shared_{0};
};

}  // namespace shellgrid
