// SPDX-License-Identifier: AGPL-3.0-or-later
#include "solvers/diffusion/polygrid_diffusion.h"

#include <algorithm>
#include <cmath>

#include "meshing/core/error.h"
#include "solvers/diffusion/boundary_irradiance.h"
#include "solvers/diffusion/cell_coefficients.h"
#include "solvers/diffusion/surface_transfer.h"
#include "solvers/render/scene_geometry.h"

namespace shellgrid {
namespace {

std::string percent(double share) {
  char text[32];
  std::snprintf(text, sizeof text, "%.2g %%", 100 * share);
  return text;
}

// What diffusion cannot show well with this material on this grid.
void judge_material(const Polygrid& polygrid, const CellCoefficients& coefficients, DiffusionResult& result,
                    Progress& progress) {
  const std::size_t count = coefficients.absorption.size();
  Rgb strongest = Rgb::Zero();
  std::int64_t under_resolved = 0, dark = 0;
  const float h = static_cast<float>(polygrid.spacing);
  for (std::size_t k = 0; k < count; ++k) {
    const Rgb& absorption = coefficients.absorption[k];
    const Rgb& extinction = coefficients.reduced_extinction[k];
    const Rgb transport = (3 * absorption * extinction).sqrt();
    strongest = strongest.max(transport);
    under_resolved += (transport * h > 0.25f).any();
    dark += (absorption > 0.47f * extinction).any();
  }
  result.cells_per_mean_free_path = (strongest > 0).select(1 / (h * strongest.max(1e-30f)), Rgb::Zero());
  result.under_resolved = static_cast<double>(under_resolved) / static_cast<double>(count);
  result.dark = static_cast<double>(dark) / static_cast<double>(count);
  result.samples = static_cast<std::int64_t>(count);
  result.samples_from_shell = coefficients.from_shell;
  result.samples_floored = coefficients.floored;
  if (result.under_resolved > 0.01)
    progress.warn("the diffuse mean free path spans fewer than 4 cells in " + percent(result.under_resolved) +
                  " of the object: expect errors above 0.5 %; try more nodes");
  if (result.dark > 0.001)
    progress.warn("the reduced albedo is below 0.53 in " + percent(result.dark) +
                  " of the object, where diffusion's exitance turns negative");
  if (coefficients.floored > 0)
    progress.warn(std::to_string(coefficients.floored) + " of " + std::to_string(count) +
                  " material samples scatter almost nothing; light crosses them freely");
}

}  // namespace

DiffusionResult solve_polygrid_diffusion(const Polygrid& polygrid, const TriangleMesh& surface,
                                         const std::variant<const ShellVolume*, Material>& material, double ior,
                                         const std::vector<Light>& lights, const DiffusionOptions& options,
                                         Progress& progress) {
  if (!(options.tolerance > 0) || options.tolerance >= 1)
    throw InputError("tolerance " + std::to_string(options.tolerance) + ": expected more than 0 and less than 1");
  if (lights.empty()) throw InputError("scene: it has no lights");
  DiffusionResult result;

  progress.begin("light on the surface", 1);
  const SceneGeometry geometry(surface);
  SurfaceIrradiance irradiance = surface_irradiance(surface, geometry, lights, ior, options.environment_samples);
  result.light_directions = irradiance.directions;
  result.light_facing_away = irradiance.facing_away;
  result.light_occluded = irradiance.occluded;
  const SurfaceTransfer transfer(polygrid, surface);
  result.largest_distance = transfer.largest_distance();
  progress.end();

  progress.begin("system", 1);
  const CellCoefficients coefficients = std::holds_alternative<Material>(material)
                                            ? homogeneous_coefficients(polygrid, std::get<Material>(material))
                                            : sample_coefficients(polygrid, *std::get<const ShellVolume*>(material));
  judge_material(polygrid, coefficients, result, progress);
  const PolygridSystem system = assemble_polygrid_system(polygrid, coefficients, ior);
  progress.end();

  progress.begin("diffusion", 1);
  const std::size_t n = system.key.size();
  const std::vector<Rgb> point_irradiance = transfer.to_points(irradiance.values);
  std::vector<Double4> q(n, Double4{}), fluence;
  for (std::size_t u = 0; u < n; ++u) q[u] = to_double(to_lanes(point_irradiance[system.point_of_unknown[u]]));
  Multigrid multigrid(system);
  result.solve = solve_conjugate_gradients(system, multigrid, boundary_source(system, q), q, options.tolerance,
                                           options.most_iterations, fluence);
  result.energy = energy_balance(system, fluence, q);
  progress.end();

  const std::vector<Double4> exitance = boundary_exitance(system, fluence, q);
  std::vector<Rgb> point_exitance(n);
  result.fluence.resize(n);
  for (std::size_t u = 0; u < n; ++u) {
    result.fluence[system.point_of_unknown[u]] = to_rgb(fluence[u]);
    point_exitance[system.point_of_unknown[u]] = to_rgb(exitance[u]);
  }
  result.exitance = transfer.to_vertices(point_exitance);
  std::int64_t negative = 0;
  for (Rgb& value : result.exitance) {
    negative += (value < 0).any();
    value = value.max(0.0f);
  }
  result.negative_vertices = static_cast<double>(negative) / static_cast<double>(result.exitance.size());
  if (result.negative_vertices > 0.001)
    progress.warn("the exitance is negative at " + percent(result.negative_vertices) +
                  " of the vertices and was set to 0 there: the material is too dark or the grid too coarse");
  result.surface_entering = surface_integral(surface, irradiance.values);
  result.surface_leaving = surface_integral(surface, result.exitance);
  result.irradiance = std::move(irradiance.values);
  return result;
}

}  // namespace shellgrid
