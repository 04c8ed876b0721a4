// SPDX-License-Identifier: AGPL-3.0-or-later
#include "solvers/diffusion/polygrid_diffusion.h"

#include <fmt/format.h>

#include <algorithm>
#include <cmath>
#include <cstdio>
#include <limits>

#include "meshing/core/error.h"
#include "solvers/diffusion/boundary_irradiance.h"
#include "solvers/diffusion/cell_coefficients.h"
#include "solvers/diffusion/crease_split.h"
#include "solvers/diffusion/near_lamps.h"
#include "solvers/diffusion/paper_operator.h"
#include "solvers/diffusion/surface_transfer.h"
#include "solvers/render/scene_geometry.h"
#include "solvers/scattering/fresnel.h"

namespace shellgrid {
namespace {

// Of the polygrid's graph: core cells and boundary quads.
double node_count(const Polygrid& polygrid) {
  return static_cast<double>(std::count(polygrid.cell_layer.begin(), polygrid.cell_layer.end(), 0) +
                             polygrid.boundary_quads.rows());
}

std::string percent(double share) {
  char text[32];
  std::snprintf(text, sizeof text, share < 0.1 ? "%.2g %%" : "%.0f %%", 100 * share);
  return text;
}

// What diffusion cannot show well with this material on this grid. Needs the fluence.
void judge_material(const Polygrid& polygrid, const CellCoefficients& coefficients, DiffusionResult& result,
                    Progress& progress) {
  const std::size_t count = coefficients.absorption.size();
  Rgb strongest = Rgb::Zero();
  std::int64_t under_resolved = 0, dark = 0;
  const float h = static_cast<float>(polygrid.spacing);
  std::vector<float> reaches(count);  // cells per mean free path, inverse
  for (std::size_t k = 0; k < count; ++k) {
    const Rgb& absorption = coefficients.absorption[k];
    const Rgb& extinction = coefficients.reduced_extinction[k];
    const Rgb transport = (3 * absorption * extinction).sqrt();
    strongest = strongest.max(transport);
    under_resolved += (transport * h > 0.25f).any();
    reaches[k] = transport.maxCoeff() * h;
    dark += (absorption > 0.47f * extinction).any();
  }
  result.cells_per_mean_free_path = (strongest > 0).select(1 / (h * strongest.max(1e-30f)), Rgb::Zero());
  result.under_resolved = static_cast<double>(under_resolved) / static_cast<double>(count);
  result.dark = static_cast<double>(dark) / static_cast<double>(count);
  result.samples = static_cast<std::int64_t>(count);
  result.samples_from_shell = coefficients.from_shell;
  result.samples_floored = coefficients.floored;
  if (coefficients.core) {
    result.core = coefficients.core;
    result.core->absorption.clear();
    result.core->reduced_extinction.clear();
  }
  result.regime = diffusion_regime(polygrid, coefficients, result.fluence);
  result.expected_error = expected_diffusion_error(result.regime, result.beams.has_value());
  Eigen::Array<bool, 3, 1> lit;
  for (int c = 0; c < 3; ++c) lit[c] = result.energy.entering[c] > 0;
  if (!lit.any()) return;  // black, and right
  if (result.beams) {
    const auto middle = reaches.begin() + static_cast<std::ptrdiff_t>(count / 2);
    std::nth_element(reaches.begin(), middle, reaches.end());
    if (*middle > 3)
      throw NumericalError(
          fmt::format("in most of the object a cell is {:.3g} times as wide as light reaches: less would leave than "
                      "does; try more nodes (method.nodes), a smaller object or a higher albedo, or sg-reference",
                      *middle));
  }
  if (result.under_resolved > 0.01) {
    const auto rank = reaches.begin() + static_cast<std::ptrdiff_t>(0.99 * static_cast<double>(count - 1));
    std::nth_element(reaches.begin(), rank, reaches.end());
    const double nodes = node_count(polygrid);
    progress.warn(
        fmt::format("the diffuse mean free path spans fewer than 4 cells in {} of the object: expect errors "
                    "above 0.5 %; 4 cells would take {:.1g} nodes (method.nodes), this grid has {:.2g}",
                    percent(result.under_resolved), nodes * std::pow(*rank / 0.25, 3), nodes));
  }
  const std::string beyond = diffusion_warning(result.regime, result.beams.has_value(), lit);
  if (!beyond.empty())
    progress.warn(beyond);
  else if (result.dark > 0.001)
    progress.warn("the reduced albedo is below 0.53 in " + percent(result.dark) + " of the object, where diffusion" +
                  (result.beams ? " is off by a sixth and more" : "'s exitance turns negative"));
  if (coefficients.floored > 0)
    progress.warn(
        fmt::format("{} of the material scatters almost nothing, as the free space between bumps does; light "
                    "crosses it freely, and the surface looks smooth over it",
                    percent(static_cast<double>(coefficients.floored) / static_cast<double>(count))));
  if (!result.beams) return;
  double cut_off = 0;
  for (int c = 0; c < 3; ++c)
    if (result.beams->entering[c] > 0)
      cut_off = std::max(cut_off, result.beams->cut_off_power[c] / result.beams->entering[c]);
  if (cut_off > 1e-3)
    progress.warn(percent(cut_off) + " of the beams' light was cut off on its way and left where it was");
}

// The least distance of a lamp, as far as it has a place, from the surface.
double distance_of(const Light& light, const ClosestPointQuery& surface) {
  double square = std::numeric_limits<double>::infinity();
  if (!light_position(light)) return square;
  for (const SimpleLight& lamp : simple_lights({light}, 256))
    if (const std::optional<Vec3> position = lamp_position(lamp))
      square = std::min(square, surface.nearest(*position).squared_distance);
  return std::sqrt(square);
}

// All of a near lamp's light enters, spread over the nearest points.
void warn_of_near_lamps(const std::vector<Light>& lights, const Polygrid& polygrid, const ClosestPointQuery& surface,
                        Progress& progress) {
  for (std::size_t k = 0; k < lights.size(); ++k) {
    const double distance = distance_of(lights[k], surface);
    if (distance < least_lamp_part * polygrid.spacing)
      progress.warn(fmt::format("lights[{}] stands on the surface: how much of its light enters is chance", k));
    else if (distance < 2 * polygrid.spacing)
      progress.warn(fmt::format(
          "lights[{}] stands {:.3g} mm from the surface and cells are {:.3g} mm wide: all of its light enters, but its "
          "spot is shown as wide as a cell; try more nodes (method.nodes), or sg-reference",
          k, distance, polygrid.spacing));
  }
}

// Says what is wrong with a solution; refuses one that is no picture of anything.
void judge_solution(const Polygrid& polygrid, const DiffusionOptions& options, const DiffusionResult& result,
                    Progress& progress) {
  if (!(std::max({result.energy.entering[0], result.energy.entering[1], result.energy.entering[2]}) > 0))
    return;  // black, and right
  const double negative = static_cast<double>(result.negative_vertices) / static_cast<double>(result.exitance.size());
  if (options.operator_name == "paper") {
    const double defect = std::max(
        {result.energy.relative_defect[0], result.energy.relative_defect[1], result.energy.relative_defect[2]});
    progress.warn("the paper's boundary condition does not conserve energy: the balance is off by " + percent(defect) +
                  ", and the exitance is negative at " + percent(negative) + " of the vertices");
    return;
  }
  bool impossible = false;
  for (int c = 0; c < 3; ++c) impossible |= result.energy.leaving[c] < -1e-6 * result.energy.entering[c];
  if (impossible)
    throw NumericalError(
        "less than no light leaves: the exitance is negative at " + percent(negative) +
        " of the vertices; the grid's cells are wider than the light's reach, or the material is too "
        "dark for diffusion; try more nodes (method.nodes), a smaller object or a higher albedo, or sg-reference");
  // In deep shadow a small error of the whole is more than what leaves there.
  double size = 0;
  for (const Rgb& value : result.exitance) size = std::max<double>(size, value.square().maxCoeff());
  const double error = std::max(options.tolerance, result.solve.estimated_error) * std::sqrt(size);
  if (result.least_exitance < -error)
    progress.warn("the exitance is negative at " + std::to_string(result.negative_vertices) + " of " +
                  std::to_string(result.exitance.size()) + " vertices (pictures show 0 there): " +
                  (result.dark > 0.001             ? "the reduced albedo is below 0.53 in places"
                   : result.under_resolved > 0.001 ? "the grid is too coarse for the light's reach (method.nodes)"
                                                   : "diffusion does not hold where the object, or a clear part of "
                                                     "it, is few mean free paths thick"));
  double lost = 0;
  for (int c = 0; c < 3; ++c)
    if (result.surface_entering[c] > 0)
      lost = std::max(lost, std::abs(1 - result.energy.entering[c] / result.surface_entering[c]));
  if (lost > 0.02)
    progress.warn(fmt::format(
        "the grid receives {} less or more light than the surface, from which it stays up to {:.3g} mm away, its cells "
        "{:.3g} mm wide; try more nodes (method.nodes) than its {:.2g}",
        percent(lost), result.largest_distance, polygrid.spacing, node_count(polygrid)));
}

// What either operator yields: at the polygrid's points.
struct PointFields {
  std::vector<Rgb> fluence, exitance;
};

// The least depth at which deep cells have been seen to keep to a tolerance; 0: at none.
int first_depth(double tolerance) {
  return tolerance >= 0.03 ? 1 : tolerance >= 0.003 ? 2 : tolerance >= 0.001 ? 3 : 0;
}

PointFields solve_elements(const Polygrid& polygrid, const CellCoefficients& coefficients, double ior,
                           const std::vector<Rgb>& irradiance, const BeamSource* beams, const DiffusionOptions& options,
                           DiffusionResult& result) {
  SolverParameters parameters;
  parameters.depth = options.adaptive && extinction_contrast(coefficients) <= parameters.rough_contrast
                         ? first_depth(options.tolerance)
                         : 0;
  std::unique_ptr<DiffusionSolver> solver;
  DiffusionLight light;
  for (;; parameters.depth = parameters.depth < 3 ? parameters.depth + 1 : 0) {
    solver.reset();
    solver = std::make_unique<DiffusionSolver>(polygrid, parameters);
    solver->set_material(coefficients, ior, options.tolerance);
    light = {};
    if (beams)
      light = solver->source_light(beams->source);
    else
      light.irradiance = solver->to_outer(irradiance);
    result.warm = !options.initial.empty();
    if (result.warm) solver->set_initial(options.initial);
    result.solve = solver->solve(light, options.tolerance, result.warm);
    result.depth = solver->skipped() > 0 ? parameters.depth : 0;
    if (result.depth == 0 || result.solve.estimated_error <= options.tolerance) break;
    result.depths_tried.push_back(result.depth);
  }
  result.energy = solver->energy(light);
  if (beams) {
    EnergyBalance& energy = result.energy;
    energy.entering = beams->entering;
    energy.leaving += beams->leaving;
    energy.absorbed += beams->absorbed;
    energy.relative_defect = safe_quotient(energy.entering - energy.leaving - energy.absorbed, energy.entering);
    for (int c = 0; c < 4; ++c) energy.relative_defect[c] = std::abs(energy.relative_defect[c]);
  }
  const std::vector<Double4> fluence = solver->fluence(), exitance = solver->exitance(light);
  PointFields fields{std::vector<Rgb>(fluence.size()), std::vector<Rgb>(fluence.size(), Rgb::Zero())};
  for (std::size_t p = 0; p < fluence.size(); ++p) fields.fluence[p] = to_rgb(fluence[p]);
  for (std::size_t s = 0; s < exitance.size(); ++s)
    fields.exitance[solver->grid().outer_point[s]] = to_rgb(exitance[s]);
  return fields;
}

PointFields solve_paper(const Polygrid& polygrid, const CellCoefficients& coefficients, double ior,
                        const std::vector<Rgb>& irradiance, const DiffusionOptions& options, DiffusionResult& result) {
  // The cells' shapes are checked, and measured, by the assembly that this operator does without.
  const PolygridSystem measured = assemble_polygrid_system(polygrid, coefficients, ior);
  const Eigen::Index cores = polygrid.graph.interior.rows(), quads = polygrid.boundary_quads.rows();

  PaperProblem problem = paper_problem(polygrid, coefficients, irradiance);
  problem.boundary_factor = polynomial_boundary_factor(ior);
  problem.tolerance = std::min(1e-4, 0.01 * options.tolerance);
  if (options.paper_solver != "krylov") problem.method = PaperMethod::relaxation;
  if (options.paper_solver == "adaptive") problem.depths = options.paper_depths;
  std::span<const PolygridLevel> levels = polygrid.hierarchy;
  if (options.paper_solver == "jacobi") levels = {};
  const PaperSolution solution = solve_paper_operator(polygrid.graph, problem, levels);
  result.solve.iterations = solution.iterations;
  result.solve.tolerance = options.tolerance;
  result.solve.residual_history = solution.residual_history;
  result.solve.estimated_error = solution.residual;
  result.solve.unknowns = static_cast<std::size_t>(cores);
  result.solve.level_sizes = {static_cast<std::size_t>(cores)};
  for (const PolygridLevel& level : polygrid.hierarchy)
    result.solve.level_sizes.push_back(static_cast<std::size_t>(level.graph.interior.rows()));

  // Cells' and quads' values averaged to their corners.
  const std::size_t n = static_cast<std::size_t>(polygrid.points.rows());
  PointFields fields{std::vector<Rgb>(n, Rgb::Zero()), std::vector<Rgb>(n, Rgb::Zero())};
  std::vector<float> count(n, 0.0f);
  for (Eigen::Index i = 0; i < cores; ++i)
    for (int a = 0; a < 8; ++a) {
      fields.fluence[polygrid.cells(i, a)] += solution.interior[i];
      ++count[polygrid.cells(i, a)];
    }
  // [Diffusion eq. 3] with eq. 2: −C κ ∂φ/∂n = (φ − q)/2, times the mean transmittance.
  const auto passed = static_cast<float>(diffuse_fresnel(ior).exit_normalization);
  for (Eigen::Index k = 0; k < quads; ++k)
    for (int a = 0; a < 4; ++a) {
      const std::int32_t point = polygrid.boundary_quads(k, a);
      fields.fluence[point] += solution.boundary[k];
      fields.exitance[point] += 0.5f * passed * (solution.boundary[k] - problem.boundary_light[k]);
      ++count[point];
    }
  for (std::size_t i = 0; i < n; ++i) {
    if (count[i] == 0) continue;
    fields.fluence[i] /= count[i];
    fields.exitance[i] /= count[i];
  }
  for (std::size_t u = 0; u < n; ++u) {
    const std::int32_t point = measured.point_of_unknown[u];
    result.energy.entering += measured.boundary_area[u] * to_double(to_lanes(irradiance[point]));
    result.energy.leaving += measured.boundary_area[u] * to_double(to_lanes(fields.exitance[point]));
    result.energy.absorbed += measured.absorption[u] * to_double(to_lanes(fields.fluence[point]));
  }
  result.energy.relative_defect =
      safe_quotient(result.energy.entering - result.energy.leaving - result.energy.absorbed, result.energy.entering);
  for (int c = 0; c < 4; ++c) result.energy.relative_defect[c] = std::abs(result.energy.relative_defect[c]);
  return fields;
}

}  // namespace

DiffusionResult solve_polygrid_diffusion(const Polygrid& polygrid, const TriangleMesh& surface,
                                         const std::variant<const ShellVolume*, Material>& material, double ior,
                                         const std::vector<Light>& lights, const DiffusionOptions& options,
                                         Progress& progress) {
  if (!(options.tolerance > 0) || options.tolerance >= 1)
    throw InputError("tolerance " + std::to_string(options.tolerance) + ": expected more than 0 and less than 1");
  if (options.operator_name != "elements" && options.operator_name != "paper")
    throw InputError("operator " + options.operator_name + ": expected elements or paper");
  if (options.paper_solver != "krylov" && options.paper_solver != "jacobi" && options.paper_solver != "hierarchical" &&
      options.paper_solver != "adaptive")
    throw InputError("paper's solver " + options.paper_solver + ": expected krylov, jacobi, hierarchical or adaptive");
  if (options.source != "boundary" && options.source != "first-collision")
    throw InputError("source " + options.source + ": expected boundary or first-collision");
  const bool beams = options.source == "first-collision";
  if (beams && options.operator_name != "elements")
    throw InputError("source first-collision: only the operator elements takes it");
  if (!options.initial.empty() && options.operator_name != "elements")
    throw InputError("initial fluence: only the operator elements takes it");
  DiffusionResult result;

  progress.begin("light on the surface", 1);
  const SceneGeometry geometry(surface);
  for (const Light& light : lights)
    if (const std::optional<Vec3> place = light_position(light); place && geometry.contains(*place))
      throw InputError("lights: a light stands inside the object");
  const CreaseSplit split(surface);
  const ClosestPointQuery query(split.mesh());
  const std::vector<Light> parts = divide_rectangles(lights, query, polygrid.spacing, options.environment_samples);
  const DividedLights divided = divide_lights(parts, query, polygrid.spacing, options.environment_samples);
  SurfaceIrradiance irradiance =
      surface_irradiance(split.mesh(), geometry, divided.far, ior, options.environment_samples);
  result.light_directions = irradiance.directions;
  result.light_facing_away = irradiance.facing_away;
  result.light_occluded = irradiance.occluded;
  SurfaceTransfer transfer(polygrid, split.mesh(), &split.places());
  result.largest_distance = transfer.largest_distance();
  const double size = (surface.vertices.colwise().maxCoeff() - surface.vertices.colwise().minCoeff()).norm();
  if (result.largest_distance > std::max(0.1 * size, 10 * polygrid.spacing))
    throw InputError(fmt::format("polygrid: the surface is another object's: it lies up to {:.3g} mm away",
                                 result.largest_distance));
  std::vector<Rgb> point_irradiance = transfer.to_points(irradiance.values);
  if (!divided.near.empty()) {
    const NearLampLight near = near_lamp_light(polygrid, split.mesh(), query, geometry, divided.near, ior);
    for (std::size_t p = 0; p < near.at_points.size(); ++p) point_irradiance[p] += near.at_points[p];
    for (std::size_t v = 0; v < near.at_vertices.size(); ++v) irradiance.values[v] += near.at_vertices[v];
  }
  transfer.drop_samples();
  progress.end();

  progress.begin("system", 1);
  const CellCoefficients coefficients = std::holds_alternative<Material>(material)
                                            ? homogeneous_coefficients(polygrid, std::get<Material>(material))
                                            : sample_coefficients(polygrid, *std::get<const ShellVolume*>(material));
  progress.end();

  if (beams) {
    progress.begin("beams", 1);
    constexpr std::size_t most = 512;  // of one rectangle: each costs a beam a quad
    result.beams = first_collision_source(
        polygrid, coefficients, split.mesh(), geometry,
        divide_rectangles(lights, query, polygrid.spacing, options.beam_samples, most), ior, options.beam_samples);
    progress.end();
  }

  progress.begin("diffusion", 1);
  PointFields fields = options.operator_name == "paper"
                           ? solve_paper(polygrid, coefficients, ior, point_irradiance, options, result)
                           : solve_elements(polygrid, coefficients, ior, point_irradiance,
                                            result.beams ? &*result.beams : nullptr, options, result);
  if (result.beams) result.beams->source.clear();
  progress.end();
  result.fluence = std::move(fields.fluence);
  judge_material(polygrid, coefficients, result, progress);

  result.exitance = split.merge(transfer.to_vertices(fields.exitance));
  result.irradiance = split.merge(irradiance.values);
  for (const Rgb& value : result.exitance) {
    result.negative_vertices += (value < 0).any();
    result.least_exitance = std::min<double>(result.least_exitance, value.minCoeff());
  }
  result.surface_entering = surface_integral(surface, result.irradiance);
  result.surface_leaving = surface_integral(surface, result.exitance);
  warn_of_near_lamps(lights, polygrid, query, progress);
  judge_solution(polygrid, options, result, progress);
  return result;
}

}  // namespace shellgrid
