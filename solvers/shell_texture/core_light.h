// SPDX-License-Identifier: AGPL-3.0-or-later
// The core below a textured surface, as the light that comes through its shell sees it.
#pragma once
#include <array>
#include <vector>

#include "solvers/diffusion/fluence_field.h"
#include "solvers/dipole/core_exchange.h"
#include "solvers/shell_texture/shell_curvature.h"
#include "solvers/shell_texture/spread_light.h"
#include "solvers/shell_texture/vertex_buckets.h"

namespace shellgrid {

// The areas `thickness` mm below those of the surface's vertices, mm²; 0 where the surface bends more than that.
std::vector<float> core_areas(const TexturedFrames& frames, double thickness);

// The core's surface without light: points, areas and presence, `thickness` mm below the mesh. pieces: as in
// core_surface.
CoreSurface bare_core(const TexturedFrames& frames, double thickness, const VertexBuckets* pieces = nullptr);

// The core's surface, `thickness` mm below the mesh, point by point below its vertices. What passes down through the
// sample's bottom where it stands there falls on it, per area of the core: so within a white object in even light there
// is even light, whatever its curvature. Source: [STF §7 step 1].
// coordinates: texture coordinates of the vertices, texels. pieces: one point for each, rather than for each vertex:
// its vertices share the light of one in their middle, each through its own texel. curvature: of the shell; none: it is
// taken as flat. Throws: InputError where they do not fit the mesh.
CoreSurface core_surface(const TexturedFrames& frames, const SpreadLight& light, const ShellTextureLookup& texture,
                         const std::vector<Vec2f>& coordinates, double thickness, const VertexBuckets* pieces = nullptr,
                         const ShellCurvature* curvature = nullptr);

// Values of pieces at the vertices: the mean of the pieces that face the same way within 1½ edges, by area and
// nearness.
std::vector<Rgb> at_vertices(const TexturedFrames& frames, const VertexBuckets& pieces, const std::vector<Rgb>& values);
// The same in the middles of finer pieces.
std::vector<Rgb> at_pieces(const VertexBuckets& pieces, const VertexBuckets& finer, const std::vector<Rgb>& values);

// A core's surface in pieces as one in larger pieces.
CoreSurface merged(const CoreSurface& surface, const VertexBuckets& pieces, const VertexBuckets& larger);

// The core's light from a solved diffusion of the whole object.
struct CoreDiffusion {
  std::vector<Rgb> exitance;    // M of each point, into the shell, W mm⁻²
  std::vector<Rgb> irradiance;  // from the shell, W mm⁻²
  // What the shell texture function sends down, over what diffusion does, of all of the core: M is in these units.
  std::array<double, 3> scale = {1, 1, 1};
};

// M = φ/4 − D/2 ∂φ/∂n, the part of diffuse light that goes outwards through the core's surface: bounces between shell
// and core, curvature and thin places are in φ. Where the shell leaves no core, M is that of the middle between its
// sides. Diffusion errs where light enters; so all light is scaled by what the shell texture function sends down, of
// which the shell's return of M is no part. Source: PHYSICS §2, the partial currents; [Diffusion].
// diffusion_coefficient: D of the core, 1/(3 σ_t'), mm. Throws: InputError where sizes do not match.
CoreDiffusion core_from_fluence(const TexturedFrames& frames, const CoreSurface& surface, double thickness,
                                const FluenceField& fluence, const Rgb& diffusion_coefficient);

// Points beyond the core's edges, as below a convex edge of the surface, see the core beside them: they take the
// exitance of the nearest point that lies on it, if one is within `reach` mm.
void spread_over_edges(const CoreSurface& surface, double reach, std::vector<Rgb>& exitance);

}  // namespace shellgrid
