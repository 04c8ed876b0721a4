// SPDX-License-Identifier: AGPL-3.0-or-later
#include <fmt/format.h>

#include <nlohmann/json.hpp>

#include "meshing/core/error.h"
#include "meshing/formats/mesh_file.h"
#include "meshing/formats/vdb_file.h"
#include "meshing/formats/vtkhdf_file.h"
#include "pipeline/cli/option_table.h"
#include "pipeline/cli/stage_program.h"
#include "pipeline/scene/exitance_mesh.h"
#include "pipeline/scene/origin.h"
#include "pipeline/scene/scene.h"
#include "pipeline/scene/scene_checks.h"
#include "solvers/diffusion/polygrid_diffusion.h"

using namespace shellgrid;

namespace {

constexpr double least_tolerance = 1e-12;

// notes: what it was made from.
UnstructuredGrid fluence_grid(const Polygrid& polygrid, const std::vector<Rgb>& fluence,
                              const std::map<std::string, std::string>& notes) {
  UnstructuredGrid grid;
  for (const auto& [key, text] : notes)
    grid.field_data.push_back({key, 1, std::vector<std::uint8_t>(text.begin(), text.end())});
  grid.points = polygrid.points;
  grid.connectivity.assign(polygrid.cells.data(), polygrid.cells.data() + polygrid.cells.size());
  for (Eigen::Index cell = 0; cell <= polygrid.cells.rows(); ++cell) grid.offsets.push_back(8 * cell);
  grid.types.assign(polygrid.cells.rows(), 12);
  std::vector<float> values;
  for (const Rgb& value : fluence) values.insert(values.end(), value.data(), value.data() + 3);
  grid.point_data.push_back({"fluence", 3, std::move(values)});
  return grid;
}

// The fluence of an earlier solve on the same polygrid.
std::vector<Rgb> read_fluence(const std::string& path, Eigen::Index points) {
  const UnstructuredGrid grid = read_vtkhdf(path);
  const DataArray* data = grid.find_point("fluence");
  const auto* values = data ? std::get_if<std::vector<float>>(&data->values) : nullptr;
  if (!values || data->columns != 3) throw InputError(path + ": it has no point data named fluence; give sg-diffuse's");
  if (grid.points.rows() != points)
    throw InputError(path + ": it has " + std::to_string(grid.points.rows()) + " points, the polygrid " +
                     std::to_string(points) + "; give the fluence of the same polygrid");
  std::vector<Rgb> fluence(points);
  for (Eigen::Index p = 0; p < points; ++p) fluence[p] = {(*values)[3 * p], (*values)[3 * p + 1], (*values)[3 * p + 2]};
  return fluence;
}

std::vector<double> channels(const Double4& a) { return {a[0], a[1], a[2]}; }
std::vector<double> channels(const Eigen::Array3d& a) { return {a[0], a[1], a[2]}; }
std::vector<double> channels(const Rgb& a) { return {a[0], a[1], a[2]}; }

void record(const DiffusionResult& r, nlohmann::json& results) {
  results["energy"] = {{"entering", channels(r.energy.entering)},
                       {"leaving", channels(r.energy.leaving)},
                       {"absorbed", channels(r.energy.absorbed)},
                       {"relative_defect", channels(r.energy.relative_defect)},
                       {"entering_by_surface", channels(r.surface_entering)},
                       {"leaving_by_surface", channels(r.surface_leaving)}};
  if (r.beams)
    results["beams"] = {{"count", r.beams->beams},
                        {"steps", r.beams->steps},
                        {"cut_off", r.beams->cut_off},
                        {"lost", r.beams->lost},
                        {"cut_off_power", channels(r.beams->cut_off_power)},
                        {"environment_lights", r.beams->environment_lights},
                        {"entering", channels(r.beams->entering)},
                        {"absorbed", channels(r.beams->absorbed)},
                        {"leaving_unscattered", channels(r.beams->leaving)}};
  results["warm_start"] = r.warm;
  results["unknowns"] = r.solve.unknowns;
  results["adaptive"] = {{"depth", r.depth},
                         {"nodes_skipped", r.solve.skipped},
                         {"estimated_exitance_error", r.solve.deep_error},
                         {"depths_too_shallow", r.depths_tried}};
  results["multigrid_levels"] = r.solve.level_sizes;
  results["cycles"] = r.solve.cycles;
  results["iterations"] = r.solve.iterations;
  results["tolerance"] = r.solve.tolerance;
  results["estimated_exitance_error"] = r.solve.estimated_error;
  results["error_history"] = r.solve.error_history;
  results["residual_history"] = r.solve.residual_history;
  results["light_directions"] = r.light_directions;
  results["light_skipped_facing_away"] = r.light_facing_away;
  results["light_occluded"] = r.light_occluded;
  results["material_samples"] = r.samples;
  results["material_samples_in_shell"] = r.samples_from_shell;
  results["material_samples_floored"] = r.samples_floored;
  results["least_cells_per_mean_free_path"] = channels(r.cells_per_mean_free_path);
  results["share_under_resolved"] = r.under_resolved;
  results["share_below_diffusion_albedo"] = r.dark;
  results["reduced_albedo"] = channels(r.regime.reduced_albedo);
  results["thickness_in_mean_free_paths"] = channels(r.regime.thickness);
  results["expected_error_of_diffusion"] = channels(r.expected_error);
  results["negative_exitance_vertices"] = r.negative_vertices;
  results["least_exitance"] = r.least_exitance;
  if (r.core)
    results["core"] = {{"kind", "interpolated"},
                       {"free_points", r.core->free_points},
                       {"boundary_points", r.core->boundary_points},
                       {"iterations", r.core->iterations},
                       {"tolerance", r.core->tolerance},
                       {"residual", r.core->residual}};
  else
    results["core"] = {{"kind", "homogeneous"}};
  results["largest_distance_surface_to_grid_mm"] = r.largest_distance;
}

// Without a shell, the scene's homogeneous core.
Material core_material(const Scene& scene) {
  if (!scene.material || !std::holds_alternative<Material>(scene.material->core))
    throw InputError(scene.path + ": no homogeneous core; give shell.vdb, or material.core with coefficients");
  require_scattering(scene);
  return std::get<Material>(scene.material->core);
}

// Refuses options that have no meaning for this operator and source.
void check_operator_options(const StageProgram& program, const std::string& operator_name,
                            const std::string& paper_solver, const std::string& source, const Scene& scene) {
  const bool paper = operator_name == "paper";
  program.refuse_unless(paper, "the operator paper", {"--paper-solver"});
  program.refuse_unless(paper && paper_solver == "adaptive", "--paper-solver adaptive", {"--paper-depths"});
  program.refuse_unless(!paper, "the operator elements", {"--whole-grid", "--initial"});
  program.refuse_unless(source == "first-collision", "the source first-collision", {"--beam-samples"});
  program.refuse_unless(has_extended_light(scene), "a scene with an environment or area light",
                        {"--environment-samples", "--beam-samples"});
  if (paper && source == "first-collision") {
    const std::string what = "the source first-collision goes with the operator elements only";
    if (program.given("--operator") || program.given("--source")) throw UsageError(what);
    throw InputError(scene.path + ": " + what);
  }
}

}  // namespace

int main(int argc, char** argv) {
  StageProgram program("sg-diffuse",
                       "solves the diffusion equation in the object: fluence inside, exitance at its surface");
  std::string scene_path, polygrid_path, surface_path, shell_path, exitance_path, initial_path, method = "scene",
                                                                                                source = "scene";
  double tolerance = 0;
  DiffusionOptions options;
  std::vector<double> depths(options.paper_depths.begin(), options.paper_depths.end());
  program.input("scene.json", scene_path, "lights, method, object.ior, and material.core where there is no shell");
  program.input("polygrid.hdf", polygrid_path, "the object's hexahedra");
  program.input("surface.ply", surface_path, "the object's surface");
  program.input("shell.vdb", shell_path, "its shell of voxels and core; left out for a homogeneous object", true);
  program.output("fluence.hdf", "hexahedra with the fluence at their points");
  program.output_option("--exitance", exitance_path, "exitance.ply", "the surface with its exitance");
  program.option("--operator", method, "elements conserves energy and is second order; paper is the 2008 one",
                 {"scene", "elements", "paper"});
  program.option("--paper-solver", options.paper_solver,
                 "of the operator paper: stabilised bi-conjugate gradients, or the paper's relaxation on one level, "
                 "from coarse to "
                 "fine, or with deep nodes left to coarser levels",
                 {"krylov", "jacobi", "hierarchical", "adaptive"});
  program.list_option("--paper-depths", depths, "links",
                      "adaptive: how deep the nodes of the finest level, the next coarser one, … are relaxed; levels "
                      "beyond the list are as a whole",
                      1, 1e6);
  program.option("--source", source,
                 "where light becomes diffuse: at the surface, or where refracted beams first meet matter",
                 {"scene", "boundary", "first-collision"});
  program.option("--initial", initial_path,
                 "fluence.hdf of the same polygrid to start from, where light or material changed a little; "
                 "none: from nothing");
  bool whole_grid = false;
  program.flag("--whole-grid", whole_grid,
               "solve for every node; else deep cells stand for their children where the tolerance allows");
  program.option("--tolerance", tolerance, "", "relative error of the exitance, 1e-12 and more; 0: the scene's", 0,
                 0.5);
  program.option("--environment-samples", options.environment_samples, "",
                 "parallel lights that stand for an environment", 1, 65536);
  program.option("--beam-samples", options.beam_samples, "",
                 "the same for the source first-collision, whose beams cost more", 1, 65536);
  program.example("sg-diffuse scene.json polygrid.hdf surface.ply shell.vdb -o fluence.hdf --exitance exitance.ply",
                  "a heterogeneous object");
  return program.run(argc, argv, [&](StageRun& run) {
    run.start_timer("read");
    const Scene scene = read_scene(scene_path);
    options.operator_name = method == "scene" ? scene.method.operator_name : method;
    const Polygrid polygrid =
        read_polygrid(polygrid_path, options.operator_name == "paper" ? PolygridParts::all : PolygridParts::cells);
    const TriangleMesh surface = read_closed_surface(surface_path);
    ShellVolume shell;
    require_same_object(polygrid, polygrid_path, surface, surface_path, run.progress());
    if (!shell_path.empty()) {
      shell = read_shell_volume(shell_path);
      require_same_object(shell, shell_path, surface, surface_path, run.progress());
      warn_of_contradictions(shell, shell_path, scene, run.progress());
    }
    options.adaptive = !whole_grid;
    options.source = source == "scene" ? scene.method.source : source;
    if (tolerance > 0 && tolerance < least_tolerance)
      throw UsageError(fmt::format("--tolerance {:g}: below {:g} rounding decides", tolerance, least_tolerance));
    options.tolerance = tolerance > 0 ? tolerance : scene.method.tolerance;
    check_operator_options(program, options.operator_name, options.paper_solver, options.source, scene);
    options.paper_depths.assign(depths.begin(), depths.end());
    if (!initial_path.empty()) options.initial = read_fluence(initial_path, polygrid.points.rows());
    std::variant<const ShellVolume*, Material> material = &shell;
    if (shell_path.empty()) material = core_material(scene);
    warn_of_darkness(scene, run.progress());
    const double ior = scene.object ? scene.object->ior : shell_path.empty() ? SceneObject{}.ior : shell.ior;

    run.start_timer("solve");
    const DiffusionResult result =
        solve_polygrid_diffusion(polygrid, surface, material, ior, scene.lights, options, run.progress());

    if (!is_dark(scene) && !(*std::max_element(&result.energy.entering[0], &result.energy.entering[0] + 3) > 0))
      run.progress().warn(unlit_warning);
    run.start_timer("write");
    write_ply(exitance_path, exitance_mesh(surface, result.exitance, result.irradiance));
    run.note_output(exitance_path);
    std::map<std::string, std::string> notes = {{lights_note, hash_lights(scene.lights)}};
    if (!shell_path.empty()) notes[shell_note] = hash_files({shell_path});
    write_vtkhdf(run.output(), fluence_grid(polygrid, result.fluence, notes));
    record(result, run.results());
    run.print(fmt::format("{}: {} unknowns × RGB, {} cycles, {} iterations, energy defect {:.1e}", run.output(),
                          result.solve.unknowns, result.solve.cycles, result.solve.iterations,
                          result.energy.relative_defect[1]));
  });
}
