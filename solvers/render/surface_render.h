// SPDX-License-Identifier: AGPL-3.0-or-later
#pragma once
#include <cstdint>
#include <optional>
#include <variant>
#include <vector>

#include "meshing/core/image.h"
#include "meshing/core/progress.h"
#include "meshing/core/triangle_mesh.h"
#include "solvers/render/camera.h"
#include "solvers/render/film.h"
#include "solvers/render/floor.h"
#include "solvers/render/lights.h"

namespace shellgrid {

// A translucent object whose diffuse light is known.
struct TranslucentSurface {
  std::vector<Rgb> exitance;  // M of each vertex, W mm⁻²
  double ior = 1.5;           // refractive index inside over outside
};

// A matt object.
struct OpaqueSurface {
  Rgb reflectance = Rgb::Constant(0.5f);
};

struct RenderSettings {
  Film::Settings film;
  int environment_samples = 384;  // parallel lights an environment becomes where shadows are cast
  std::optional<Rgb> background;  // what camera rays see behind everything; absent: the environment
  std::optional<Floor> floor;
};

struct RenderStatistics {
  Film::Statistics film;
  std::int64_t mirror_rays = 0;
  std::int64_t shadow_rays = 0, shadow_rays_skipped = 0;
  std::int64_t unseen_vertices_skipped = 0;     // opaque: vertices whose faces all look away from the camera
  std::int64_t negative_exitance_vertices = 0;  // translucent: vertices with a negative exitance, shown as 0
};

struct RenderedImage {
  Image image;  // the layers of Film::develop()
  RenderStatistics statistics;
};

// The picture of a translucent surface: L(ω_o) = M F_t(η, ω_o) / (π ∫₀¹ 2μ F_t dμ) interpolated between vertices, plus
// the Fresnel mirror image of the environment, the floor and the object itself (one interreflection; the second mirror
// sees the environment). Lights without extent have no mirror image; rectangles show where they shine.
// Source: PHYSICS "Where light leaves".
// Normals are interpolated between vertices; where that turns them from the viewer, the face's is used.
// Throws: InputError if the camera is inside the object or not usable, or the exitance does not fit the mesh.
RenderedImage render_surface(const TriangleMesh& mesh, const TranslucentSurface& surface,
                             const std::vector<Light>& lights, const Camera& camera, const RenderSettings& settings,
                             Progress& progress = no_progress());

// The picture of a Lambertian surface under direct light with shadows: L = ρ E / π, point and parallel lights at each
// hit, environments at each vertex.
// Throws: as above.
RenderedImage render_surface(const TriangleMesh& mesh, const OpaqueSurface& surface, const std::vector<Light>& lights,
                             const Camera& camera, const RenderSettings& settings, Progress& progress = no_progress());

}  // namespace shellgrid
