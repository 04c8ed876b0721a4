// SPDX-License-Identifier: AGPL-3.0-or-later
#include <fmt/format.h>

#include <filesystem>
#include <nlohmann/json.hpp>

#include "meshing/core/error.h"
#include "meshing/formats/mesh_file.h"
#include "meshing/formats/polycube_file.h"
#include "meshing/formats/vtkhdf_file.h"
#include "meshing/polycube/polygrid.h"
#include "pipeline/cli/stage_program.h"
#include "pipeline/scene/scene_checks.h"

int main(int argc, char** argv) {
  using namespace shellgrid;
  StageProgram program("sg-polygrid", "maps a polycube's cells into an object and weighs their links");
  std::string polycube_path, surface_path;
  PolygridOptions options;
  program.input("polycube.hdf", polycube_path, "polycube of the object");
  program.input("surface.ply", surface_path, "the object's closed surface");
  program.output("polygrid.hdf", "hexahedra, links and weights (VTKHDF)");
  program.output_beside(".view.ply");
  program.option("--layer", options.layer_thickness, "cells", "thickness of the boundary layer", 0.01, 0.5);
  program.option("--condition-limit", options.condition_limit, "",
                 "condition number of appendix B's matrix beyond which a node's weights are least squares; 1e12: never",
                 1, 1e12);
  program.example("sg-polygrid polycube.hdf surface.ply -o polygrid.hdf", "the polygrid of a prepared surface");
  return program.run(argc, argv, [&](StageRun& run) {
    run.start_timer("read");
    const VoxelPolycube polycube = read_polycube(polycube_path);
    const TriangleMesh surface = read_closed_surface(surface_path);
    run.start_timer("map");
    Polygrid polygrid =
        naming(polycube_path, [&] { return build_polygrid(polycube, surface, options, run.progress()); });
    run.start_timer("measure");
    const PolygridQuality quality = measure_polygrid(polygrid, polycube, surface);
    if (quality.off_surface > 0)
      run.progress().warn(fmt::format("{} of {} boundary points stay off the surface, the farthest by {:.3g} cells",
                                      quality.off_surface, quality.boundary_points, quality.boundary_distance_max));
    run.start_timer("write");
    const std::string view = std::filesystem::path(run.output()).replace_extension(".view.ply").string();
    write_ply(view, polygrid_view(polygrid));
    run.note_output(view);
    const double spacing = polygrid.spacing;
    write_polygrid(run.output(), std::move(polygrid));
    auto& results = run.results();
    results["nodes"] = quality.nodes;
    results["cubes"] = quality.cubes;
    results["genus"] = quality.genus;
    results["inverted_cells"] = quality.inverted_cells;
    results["scaled_jacobian"] = {{"min", quality.scaled_jacobian_min}, {"mean", quality.scaled_jacobian_mean}};
    results["link_length_cv"] = quality.link_length_cv;
    results["link_angle"] = {
        {"mean", quality.link_angle_mean}, {"max", quality.link_angle_max}, {"over_30", quality.steep_links}};
    results["layer_thickness"] = quality.layer_thickness_mean;
    results["boundary_distance"] = {{"max", quality.boundary_distance_max},
                                    {"max_mm", quality.boundary_distance_max * spacing},
                                    {"points_off_surface", quality.off_surface}};
    results["coverage"] = {{"p99", quality.coverage_p99}, {"max", quality.coverage_max}};
    results["weights"] = {
        {"condition", {{"median", quality.weight_condition_median}, {"max", quality.weight_condition_max}}},
        {"least_squares", quality.least_squares_weights},
        {"singular", quality.singular_weights}};
    results["spacing"] = spacing;
  });
}
