// SPDX-License-Identifier: AGPL-3.0-or-later
#pragma once
#include <atomic>
#include <cstdint>
#include <functional>
#include <optional>
#include <vector>

#include "meshing/core/progress.h"
#include "meshing/core/triangle_mesh.h"
#include "solvers/render/lights.h"
#include "solvers/render/scene_geometry.h"

namespace shellgrid {

// A table for the object to stand on. It shows shadows and reflections, and fades into the
// backdrop; it sends no light to the object.
struct Floor {
  Rgb reflectance = Rgb::Constant(0.5f);  // diffuse, 0 … 1
  double ior = 1;                         // of a polished coat; 1: matt
  double radius = 2.5;                    // to where it has faded away, in sizes of the object
};

// The floor under an object with its light worked out.
class LitFloor {
 public:
  // The plane touches the object's lowest point along `up`. Irradiance from environments is worked out on a grid around
  // the object, with shadows, and with the light that leaves the object: `radiosity(hit)` is that light's exitance,
  // W mm⁻². Parallel and point lights, whose shadows are sharp, are followed from each point that is asked for.
  // `geometry` must outlive the floor.
  LitFloor(const Floor& floor, const TriangleMesh& mesh, const SceneGeometry& geometry, const Vec3& up,
           const std::vector<Light>& lights, int environment_samples,
           const std::function<Rgb(const SceneGeometry::Hit&)>& radiosity, Progress& progress = no_progress());

  // Distance along a ray to the floor, from above.
  std::optional<double> intersect(const Vec3& origin, const Vec3& direction) const;
  // Share of the floor that is left before it fades into the backdrop, 0 … 1.
  double opacity(const Vec3& point) const;
  // Diffusely reflected radiance.
  Rgb radiance(const Vec3& point) const;
  const Vec3& normal() const { return up_; }
  const Floor& floor() const { return floor_; }
  std::int64_t shadow_rays() const { return shadow_rays_ + sharp_rays_; }
  std::int64_t shadow_rays_skipped() const { return shadow_rays_skipped_; }

 private:
  Vec3 grid_point(int i, int j) const {
    return centre_ + (i * step_ - half_width_) * right_ + (j * step_ - half_width_) * forward_;
  }

  Floor floor_;
  const SceneGeometry* geometry_;
  std::vector<SimpleLight> sharp_;
  Vec3 up_, right_, forward_, centre_;
  double size_ = 1, half_width_ = 1, step_ = 1;
  std::vector<Rgb> irradiance_;  // on the grid, row by row
  std::int64_t shadow_rays_ = 0, shadow_rays_skipped_ = 0;
  mutable std::atomic<std::int64_t> sharp_rays_{0};
};

}  // namespace shellgrid
