// SPDX-License-Identifier: AGPL-3.0-or-later
#include <fmt/format.h>

#include <chrono>
#include <filesystem>
#include <nlohmann/json.hpp>

#include "meshing/core/error.h"
#include "meshing/distance/distance_field.h"
#include "meshing/formats/mesh_file.h"
#include "meshing/formats/vdb_file.h"
#include "meshing/surface/surface_quality.h"
#include "pipeline/cli/stage_program.h"

using namespace shellgrid;

int main(int argc, char** argv) {
  std::string surface_path;
  DistanceOptions options;
  std::string sign = "closed";
  StageProgram program("sg-distance",
                       "computes the signed distance, nearest point and nearest vertex around a surface");
  program.input("SURFACE", surface_path, "closed mesh, as sg-prepare writes it");
  program.output("distance.vdb", "narrow-band grids distance, nearest_point, nearest_vertex; a view.ply beside it");
  program.output_beside(".view.ply");
  program.option("--voxel", options.voxel, "mm", "grid interval", 1e-6, 1e6);
  program.option("--inside", options.inside_band, "mm", "width of the band inside the surface", 1e-6, 1e6);
  program.option("--outside", options.outside_band, "mm", "width of the band outside the surface", 1e-6, 1e6);
  program.option("--sign", sign,
                 "closed: the surface must be; winding-number: any triangles that look outward, with gaps, doubled or "
                 "crossing",
                 {"closed", "winding-number"});
  program.example("sg-distance surface.ply -o distance.vdb --voxel 0.4 --inside 4.8 --outside 0.8",
                  "a shell of twelve voxels");
  return program.run(argc, argv, [&](StageRun& run) {
    options.sign = sign == "closed" ? SignRule::closed : SignRule::winding_number;
    run.start_timer("read");
    const TriangleMesh surface = read_mesh(surface_path).mesh;
    run.start_timer("distance");
    const auto start = std::chrono::steady_clock::now();
    DistanceStatistics statistics;
    const DistanceField field =
        naming(surface_path, [&] { return compute_distance_field(surface, options, statistics, run.progress()); });
    const double seconds = std::chrono::duration<double>(std::chrono::steady_clock::now() - start).count();

    // The view shows how far the grid's interpolated surface lies from the mesh.
    run.start_timer("view");
    AttributedMesh view{extract_isosurface(field.distance, field.frame, 0), {}};
    std::vector<float> error = distances_to_surface(view.mesh.vertices, surface);
    double greatest = 0;
    for (float& value : error) {
      value /= static_cast<float>(options.voxel);
      greatest = std::max<double>(greatest, value);
    }
    view.properties.push_back({"quality", std::move(error)});
    run.start_timer("write");
    const std::string view_path = std::filesystem::path(run.output()).replace_extension(".view.ply").string();
    write_ply(view_path, view);
    run.note_output(view_path);
    write_distance_field(run.output(), field);

    run.results() = {{"active_samples", statistics.active_samples},
                     {"visited_samples", statistics.visited_samples},
                     {"compared_pairs", statistics.compared_pairs},
                     {"possible_samples", statistics.possible_samples},
                     {"allocated_leaves", statistics.allocated_leaves},
                     {"possible_leaves", statistics.possible_leaves},
                     {"skipped_share", statistics.skipped()},
                     {"samples_per_second", static_cast<double>(statistics.active_samples) / seconds},
                     {"isosurface_error_voxels", greatest}};
    run.print(fmt::format("{} samples in {} of {} leaves, {:.0f} % skipped, {:.3g} samples a second",
                          statistics.active_samples, statistics.allocated_leaves, statistics.possible_leaves,
                          100 * statistics.skipped(), static_cast<double>(statistics.active_samples) / seconds));
  });
}
