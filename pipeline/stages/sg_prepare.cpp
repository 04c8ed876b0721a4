// SPDX-License-Identifier: AGPL-3.0-or-later
#include <fmt/format.h>

#include <nlohmann/json.hpp>

#include "meshing/core/error.h"
#include "meshing/formats/mesh_file.h"
#include "meshing/surface/prepare_surface.h"
#include "pipeline/cli/option_table.h"
#include "pipeline/cli/stage_program.h"

using namespace shellgrid;

namespace {

// "0.5" is mm, "1%" a share of the length.
void set_rewrap(PrepareOptions& options, const std::string& text) {
  std::size_t used = 0;
  double value = 0;
  try {
    value = std::stod(text, &used);
  } catch (const std::exception&) {
  }
  const std::string unit = text.substr(used);
  if (!(value > 0 && value < 1e9) || (unit != "" && unit != "%"))
    throw UsageError("--rewrap " + text + ": expected a length in mm, or a share of the object's length as 1%");
  (unit == "%" ? options.rewrap_share : options.rewrap) = unit == "%" ? value / 100 : value;
}

}  // namespace

int main(int argc, char** argv) {
  std::string mesh_path;
  PrepareOptions options;
  bool no_retile = false;
  std::string rewrap;
  StageProgram program("sg-prepare", "makes a closed, oriented, evenly tiled surface of any mesh");
  program.input("MESH", mesh_path, "mesh: .ply, .obj, .off or .stl");
  program.output("surface.ply", "the surface, centred on the origin");
  program.option("--size", options.size, "mm", "longest edge of the bounding box; 0 keeps the file's units", 0, 1e6);
  program.option("--spacing", options.spacing, "mm", "mean edge length of the retiled surface", 1e-6, 1e6);
  program.option("--feature-angle", options.feature_angle, "degrees",
                 "edges with a greater angle between their faces stay sharp; 180: none", 1, 180);
  program.flag("--close-holes", options.close_holes, "fill every hole instead of refusing an open mesh");
  program.option(
      "--rewrap", rewrap,
      "wrap any heap of triangles, open, crossing or in parts, in a closed surface of this resolution: mm, or "
      "a share of the object's length, as 1%");
  program.flag("--no-retile", no_retile, "repair, scale and centre only");
  program.option("--longest-edge", options.longest_edge, "mm",
                 "with --no-retile: longer edges are split, without a change of shape; 0: none", 0, 1e6);
  program.example("sg-prepare bunny.off -o surface.ply --size 80 --spacing 0.4", "a bunny 80 mm long, edges of 0.4 mm");
  program.example("sg-prepare soup.stl -o surface.ply --size 80 --rewrap 1%", "whatever it is, closed");
  program.example("sg-prepare scan.obj -o surface.ply --size 80 --close-holes", "a scan that is open at the bottom");
  return program.run(argc, argv, [&](StageRun& run) {
    options.retile = !no_retile;
    if (!rewrap.empty()) set_rewrap(options, rewrap);
    program.refuse_unless(no_retile, "--no-retile", {"--longest-edge"});
    program.refuse_unless(!no_retile, "a retiled surface", {"--spacing", "--feature-angle"});
    run.start_timer("read");
    AttributedMesh input = read_mesh(mesh_path);
    run.start_timer("prepare");
    const PreparedSurface surface =
        naming(mesh_path, [&] { return prepare_surface(input.mesh, options, run.progress()); });
    run.start_timer("write");
    write_ply(run.output(), {surface.mesh, {}});

    const double voxel = options.spacing;
    run.results() = {
        {"vertices", surface.mesh.vertex_count()},
        {"faces", surface.mesh.face_count()},
        {"genus", surface.genus},
        {"volume_mm3", surface.volume},
        {"scale", surface.scale},
        {"edge_mean_mm", surface.edges.mean},
        {"edge_deviation_mm", surface.edges.deviation},
        {"edge_variation", surface.edges.variation()},
        {"edge_least_mm", surface.edges.least},
        {"edge_greatest_mm", surface.edges.greatest},
        {"hausdorff_to_input_voxels", surface.to_input / voxel},
        {"hausdorff_from_input_voxels", surface.from_input / voxel},
        {"hausdorff_sampling", "at vertices and at one point in every half squared spacing of area"},
        {"crease_length_mm", surface.creases.length},
        {"crease_kept", surface.creases.kept},
        {"crease_distance_voxels", surface.creases.length > 0 ? surface.creases.distance / voxel : 0.0},
        {"retiling_attempts", surface.retiling_attempts},
        {"kept_triangles", surface.kept_triangles},
        {"rewrap_resolution_mm", surface.rewrap.resolution},
        {"rewrap_to_input_mm", surface.rewrap.to_input},
        {"rewrap_from_input_mm", surface.rewrap.from_input},
        {"rewrap_dropped_components", surface.rewrap.dropped_components},
        {"rewrap_dropped_volume", surface.rewrap.dropped_volume},
        {"merged_vertices", surface.repair.merged_vertices},
        {"dropped_faces", surface.repair.dropped_faces},
        {"flattened_faces", surface.repair.flattened_faces},
        {"unreferenced_vertices", surface.repair.unreferenced_vertices},
        {"turned_faces", surface.repair.turned_faces},
        {"closed_holes", surface.repair.closed_holes},
    };
    run.print(fmt::format("{} vertices, {} faces, genus {}, edges {:.4g} ± {:.2g} mm, {:.2g} voxels from the input",
                          surface.mesh.vertex_count(), surface.mesh.face_count(), surface.genus, surface.edges.mean,
                          surface.edges.deviation, std::max(surface.to_input, surface.from_input) / voxel));
  });
}
