// SPDX-License-Identifier: AGPL-3.0-or-later
// From a polygrid, its surface, a material and lights to fluence and exitance.
#pragma once
#include <optional>
#include <string>
#include <variant>
#include <vector>

#include "meshing/core/progress.h"
#include "meshing/core/triangle_mesh.h"
#include "meshing/polycube/polygrid.h"
#include "meshing/shell/shell_volume.h"
#include "solvers/diffusion/beam_source.h"
#include "solvers/diffusion/core_extension.h"
#include "solvers/diffusion/diffusion_solver.h"
#include "solvers/diffusion/diffusion_validity.h"
#include "solvers/render/lights.h"

namespace shellgrid {

struct DiffusionOptions {
  std::string operator_name = "elements";  // or "paper"
  std::string source = "boundary";         // or "first-collision"
  // How the paper's operator is solved: krylov, or its own relaxation: jacobi on one level, hierarchical, or adaptive,
  // where the nodes deeper than `paper_depths` links below a level's boundary (finest first) stay on coarser levels.
  std::string paper_solver = "krylov";
  std::vector<int> paper_depths = {8, 8};
  double tolerance = 0.005;       // relative error of the exitance
  int environment_samples = 256;  // parallel lights that stand for an environment
  std::vector<Rgb> initial;       // fluence at the polygrid's points to start from; empty: cold
  bool adaptive = true;           // deep cells may stand for their children where the tolerance allows
  int beam_samples = 64;          // the same where each becomes beams through the object
};

struct DiffusionResult {
  std::vector<Rgb> fluence;         // one a point of the polygrid, W mm⁻²
  std::vector<Rgb> exitance;        // one a vertex of the surface, W mm⁻²; negative where diffusion fails
  std::vector<Rgb> irradiance;      // q, one a vertex of the surface, W mm⁻²
  EnergyBalance energy;             // with the beams'
  std::optional<BeamSource> beams;  // of the source first-collision; without its field
  SolveReport solve;
  int depth = 0;                  // cells between the surface and cells that stand for their children; 0: none does
  std::vector<int> depths_tried;  // that the error estimate found too shallow
  bool warm = false;              // started from a given fluence
  Eigen::Array3d surface_entering, surface_leaving;  // ∫ q and ∫ M over the mesh, W: near the energy's by the grid
  std::int64_t negative_vertices = 0;                // vertices with a negative M in some channel
  double least_exitance = 0;                         // the most negative M of any channel, W mm⁻²; 0: none
  double largest_distance = 0;                       // between mesh and boundary quads, mm
  Rgb cells_per_mean_free_path = Rgb::Zero();        // the least over the object, 1/(σ_tr h); 0: no absorption
  double under_resolved = 0;                         // share of samples with fewer than four cells to it
  double dark = 0;                                   // share of samples whose reduced albedo is below .53
  DiffusionRegime regime;                            // of the object under this light
  Rgb expected_error = Rgb::Zero();                  // of the exitance against transport, by the regime
  std::int64_t light_directions = 0, light_facing_away = 0, light_occluded = 0;
  std::int64_t samples_from_shell = 0, samples_floored = 0, samples = 0;
  std::optional<CoreExtension> core;  // where the core is interpolated; without its fields
};

// Solves D1–D3 on the polygrid. The irradiance is found at the surface's vertices, with shadows, and averaged over the
// hat functions of the outer points; the exitance is M of D3 at the outer points, carried to the vertices.
// With the source first-collision the refracted beams light the volume instead, q is 0 in D2 and D3, and what beams
// lose to absorption or carry through the object counts in D4; fluence and exitance are those of the diffuse light.
// The exitance is negative where diffusion fails (boundary, below a reduced albedo of .53). Elsewhere it may fall below
// 0 in deep shadow at low albedo, where less light leaves than the tolerance leaves open, and its sign with it: with
// the tolerance that goes away down to about 1e-10 of the largest, where cells are wider than the diffuse mean free
// path and trilinear elements keep to no maximum principle. Both terms of M use the averaged irradiance: with the sharp
// one, φ being smooth, a shadow's edge would show as a dark fringe on its lit side, and energy would not add up.
// `material`: the shell with its core, or one homogeneous material. `ior` ≥ 1.
// Throws: InputError, NumericalError.
DiffusionResult solve_polygrid_diffusion(const Polygrid& polygrid, const TriangleMesh& surface,
                                         const std::variant<const ShellVolume*, Material>& material, double ior,
                                         const std::vector<Light>& lights, const DiffusionOptions& options,
                                         Progress& progress = no_progress());

}  // namespace shellgrid
