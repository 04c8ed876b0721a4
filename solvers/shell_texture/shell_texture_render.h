// SPDX-License-Identifier: AGPL-3.0-or-later
// Pictures of a shell and its core by the shell texture function.
#pragma once
#include <vector>

#include "meshing/shell/shell_volume.h"
#include "solvers/render/surface_render.h"
#include "solvers/shell_texture/body_shape.h"
#include "solvers/shell_texture/shell_curvature.h"
#include "solvers/shell_texture/spread_light.h"
#include "solvers/transport/transport_object.h"

namespace shellgrid {

// What light meets. All of it must outlive the picture.
struct ShellTextureScene {
  const TransportObject& object;  // its outer surface, and that of its shell's free space
  const ShellVolume& shell;
  TexturedFrames frames;                      // of the surface that the shell lies below
  const ShellTextureLookup& texture;          // of the sample that the shell was made of
  const std::vector<Vec2f>& coordinates;      // of the surface's vertices in the sample, texels
  const std::vector<Rgb>& core;               // exitance of the core below each vertex, W mm⁻²; empty: a black core
  const ShellCurvature* curvature = nullptr;  // of the shell; none: it is taken as flat, as in the paper
  BodyShape shape = {};  // scattered light is as much brighter; of a whole one, bends count for beams alone
};

struct ShellTextureSettings {
  RenderSettings render;
  IrradianceCorrection correction = IrradianceCorrection::kernels;
  bool outside_light = true;     // light from outside, scattered within the shell or mirrored, and what is beside it
  bool core_light = true;        // light from the core, through the shell [STF fig. 8]
  bool unscattered_core = true;  // that part of it which the shell has not scattered; the paper leaves it out
  // Matter of anisotropy g is seen as matter of g = 0 with σ_s (1 − g), and its beams as light that has been scattered:
  // with isotropic I_m, white matter in even light stays as bright as it is only so. False: as the paper has it, beams
  // by their phase function, the rest evenly by the full σ_s.
  bool similarity = true;
  int mirrors = 10;  // surfaces that a ray is mirrored or passed on by, one after another
};

struct ShellTextureStatistics {
  RenderStatistics render;
  std::int64_t marches = 0, march_steps = 0;
  std::int64_t voxels_lit = 0;      // whose irradiance was looked up
  std::int64_t leaves_lit = 0;      // of the shell's
  std::int64_t leaves_skipped = 0;  // that no ray has seen
  std::int64_t vertices_corrected = 0;
  std::int64_t vertices_lit = 0, shadow_rays = 0, shadow_rays_skipped = 0, shadow_rays_shared = 0;
};

// Rays find the mesostructure's surface within the shell, are mirrored and refracted there, and march through the
// matter: L = ∫ σ_s e^{−∫σ_t} (φ_m/4π + Σ_l p I_0 I_s) ds, with φ_m = Σ_l I_0 I_m(ω_l) + 2 M I_m(ω_b). A voxel's
// irradiance is worked out when the first ray comes by. It leaves with (1 − F)/η². Source: [STF §7, eqs. 3, 4]; in them
// F_r is a transmittance, and directions of light belong to the I. Throws: InputError if the camera is inside the
// object, or sizes do not match.
RenderedImage render_shell_texture(const ShellTextureScene& scene, const std::vector<Light>& lights,
                                   const Camera& camera, const ShellTextureSettings& settings,
                                   ShellTextureStatistics* statistics = nullptr, Progress& progress = no_progress());

}  // namespace shellgrid
