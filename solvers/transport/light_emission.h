// SPDX-License-Identifier: AGPL-3.0-or-later
// Light rays as lights send them towards an object.
#pragma once
#include <memory>
#include <vector>

#include "meshing/core/triangle_mesh.h"
#include "solvers/diffusion/channel_lanes.h"
#include "solvers/render/lights.h"
#include "solvers/transport/path_random.h"

namespace shellgrid {

// A ray and its power: the mean over rays of what arrives at any place is the power that arrives there, W.
struct EmittedRay {
  Vec3 origin = Vec3::Zero(), direction = Vec3(0, 0, 1);
  Double4 power = {};
};

// Chance over directions: each in proportion to a table's cell, or to a lamp, and a share evenly.
class EnvironmentSampler {
 public:
  explicit EnvironmentSampler(const EnvironmentLight& environment);
  // Towards the sky, unit.
  Vec3 direction(PathRandom& random) const;
  // Density over solid angle, sr⁻¹.
  double density(const Vec3& direction) const;
  // ∫ luminance dω, about.
  double flux() const { return flux_; }

 private:
  struct Cone {
    Vec3 axis;
    double cosine = 0, share = 0;
  };
  int cell_of(const Vec3& direction) const;

  Vec3 up_, forward_, right_;
  int columns_ = 1, rows_ = 1;
  std::vector<double> chance_, cumulative_;
  std::vector<Cone> cones_;
  double table_share_ = 0, even_share_ = 1, flux_ = 0;
};

class LightEmission {
 public:
  // `mesh` is what is to be lit. Lights without power are legal: rays have none then. Throws: InputError where a
  // light's power is beyond all numbers, or its picture damaged.
  LightEmission(const std::vector<Light>& lights, const TriangleMesh& mesh, const Vec3& centre, double radius);

  EmittedRay emit(PathRandom& random) const;

 private:
  struct Window {  // across the direction of parallel light: the rectangle behind which the object lies
    Vec3 corner, along, across;
  };
  EmittedRay emit_directional(const DirectionalLight& light, const Window& window, PathRandom& random) const;
  EmittedRay emit_point(const PointLight& light, PathRandom& random) const;
  EmittedRay emit_area(const AreaLight& light, PathRandom& random) const;
  EmittedRay emit_environment(const EnvironmentLight& light, const EnvironmentSampler& sampler,
                              PathRandom& random) const;
  // A direction from a point into the cone about the object, and its solid angle; all directions where the point is
  // within the sphere about it.
  Vec3 towards_object(const Vec3& point, PathRandom& random, double& solid_angle) const;

  std::vector<Light> lights_;
  Vec3 centre_;
  double radius_;
  std::vector<double> cumulative_, chance_;  // of the lights
  std::vector<Window> windows_;
  std::vector<EnvironmentSampler> samplers_;
  std::vector<int> part_;  // of each light, its window or sampler
};

}  // namespace shellgrid
