// SPDX-License-Identifier: AGPL-3.0-or-later
// Light that enters the object as refracted beams and becomes diffuse where it first meets matter.
#pragma once
#include <cstdint>
#include <functional>
#include <vector>

#include "meshing/core/triangle_mesh.h"
#include "solvers/diffusion/cell_coefficients.h"
#include "solvers/diffusion/channel_lanes.h"
#include "solvers/render/lights.h"
#include "solvers/render/scene_geometry.h"

namespace shellgrid {

// A beam that has just passed the surface, in a point of a boundary quad.
struct EnteringBeam {
  double s = 0.5, t = 0.5;          // where in the quad: corners at (0, 0), (1, 0), (1, 1), (0, 1)
  Vec3 direction = Vec3(0, 0, -1);  // in which it travels, unit
  Double4 power = {};               // W
};

// What beams leave behind. entering = Σ source + absorbed + leaving, to rounding.
struct BeamSource {
  std::vector<Double4> source;  // ∫ Q h_i dV of each point, W: what the beams lose to scattering
  Double4 entering = {};        // W
  Double4 absorbed = {};        // W, lost to absorption on the way
  Double4 leaving = {};         // W, that passed through the object unscattered
  std::int64_t beams = 0, steps = 0;
  std::int64_t cut_off = 0;    // beams that a limit of steps or mirrorings ended
  std::int64_t lost = 0;       // beams that the cells' shapes ended
  Double4 cut_off_power = {};  // W, those rests
  int environment_lights = 0;
};

// Traces each quad's beams through the cells' σ_t': the attenuation exp(−∫σ_t' ds) along each step goes to the step's
// ends, by shape functions and such that its centroid is kept, the share σ_s'/σ_t' to the source. A beam that has lost
// all but 1e-3 ends: its rest is divided as what it has lost so far, the part for the source where it is. At the
// surface what Fresnel's equations let through leaves, the rest is mirrored; faces that are no boundary quads mirror
// all. Source: PHYSICS "Where light enters". `beams_of(quad, list)` fills the list. Same bytes at any thread count.
// Throws: InputError for a broken grid.
BeamSource trace_beams(const Polygrid& polygrid, const CellCoefficients& coefficients, double ior,
                       const std::function<void(std::int32_t quad, std::vector<EnteringBeam>& list)>& beams_of);

// The lights' beams, with shadows: four from each boundary quad for a light of one direction; an environment becomes
// about `environment_samples` parallel lights (fewer where that made more than two million beams), each of which
// meets every quad in one of the four places in turn. Normals are the mesh's at the nearest point.
// In a thin object beams go far and are mirrored often; where all together would take more than about `most_steps`,
// there are fewer: one or two a quad, down to 16 parallel lights for an environment, which meet every seventh quad.
BeamSource first_collision_source(const Polygrid& polygrid, const CellCoefficients& coefficients,
                                  const TriangleMesh& surface, const SceneGeometry& geometry,
                                  const std::vector<Light>& lights, double ior, int environment_samples,
                                  double most_steps = 1e7);

}  // namespace shellgrid
