// SPDX-License-Identifier: AGPL-3.0-or-later
#include <fmt/format.h>

#include <cmath>
#include <nlohmann/json.hpp>

#include "meshing/core/error.h"
#include "meshing/formats/cube_list_file.h"
#include "meshing/formats/mesh_file.h"
#include "meshing/formats/polycube_file.h"
#include "meshing/formats/vtkhdf_file.h"
#include "meshing/polycube/counted_polycube.h"
#include "meshing/polycube/given_polycube.h"
#include "meshing/polycube/polycube_map.h"
#include "meshing/polycube/tetrahedralize.h"
#include "pipeline/cli/option_table.h"
#include "pipeline/cli/stage_program.h"
#include "pipeline/cli/view_path.h"

namespace shellgrid {
namespace {

struct Options {
  std::string input, cubes, placement = "auto";
  PolycubeOptions polycube;
  double edge = 0;
  std::vector<double> origin;
};

void declare(StageProgram& program, Options& options) {
  program.input("tets.hdf", options.input, "tetrahedral mesh of the object");
  program.input("cubes", options.cubes, "a polycube of your own: json txt hdf ply off obj stl vdb", true);
  program.output("polycube.hdf", "blocks with their lattice coordinates (VTKHDF); a view.ply beside it");
  program.output_beside(".view.ply");
  program.option("--nodes", options.polycube.nodes, "", "nodes wanted in the polygrid", 200, 2e7);
  program.option("--cubes", options.polycube.blocks, "",
                 "blocks wanted; with --grid it sets the nodes, else the cells along a block's edge", 1, 1e6);
  program.option("--grid", options.polycube.grid, "", "cells along a block's edge; 0 chooses by --nodes and --cubes", 0,
                 256);
  program.option("--sweeps", options.polycube.anneal_sweeps, "", "annealing sweeps over the stairs", 0, 10000);
  program.option("--place", options.placement,
                 "where your own cubes lie: as their file says, over the object's bounding box, or auto: as the file "
                 "says where that covers a quarter of the object",
                 {"auto", "file", "box"});
  program.option("--origin", options.origin, "mm", "lower corner of your cube (0, 0, 0); overrides --place");
  program.option("--edge", options.edge, "mm", "edge of your cubes; overrides --place; 0: that of --place", 0, 1e9);
  program.example("sg-polycube tets.hdf -o polycube.hdf --nodes 1e5", "a polycube for 100 000 nodes");
  program.example("sg-polycube tets.hdf -o polycube.hdf --cubes 253 --grid 16", "253 cubes of 16³ cells");
  program.example("sg-polycube tets.hdf cubes.json -o polycube.hdf --nodes 1e5", "a polycube of your own");
}

VoxelPolycube given_polycube(const TriangleMesh& surface, const Options& options, const StageProgram& program,
                             StageRun& run) {
  GivenPolycubeOptions given;
  given.nodes = options.polycube.nodes;
  given.grid = options.polycube.grid;
  given.placement = options.placement == "file"  ? CubePlacement::file
                    : options.placement == "box" ? CubePlacement::box
                                                 : CubePlacement::automatic;
  if (program.given("--origin")) given.origin = Vec3(options.origin[0], options.origin[1], options.origin[2]);
  if (options.edge > 0) given.edge = options.edge;
  const CubeList list = read_cube_list(options.cubes);
  const GivenPolycube placed = naming(options.cubes, [&] { return place_given_polycube(list, surface, given); });
  run.results()["placement"] = given.origin || given.edge                ? "given"
                               : placed.placement == CubePlacement::file ? "file"
                                                                         : "box";
  run.results()["covered_volume"] = placed.covered;
  run.results()["overlap"] = placed.overlap;
  if (placed.overlap < 0.5)
    run.progress().warn(
        fmt::format("the cubes follow the object roughly: they hold {:.0f} % of its volume, which is "
                    "{:.0f} % of what both take together; expect strained cells",
                    100 * placed.covered, 100 * placed.overlap));
  return placed.polycube;
}

VoxelPolycube automatic_polycube(const TriangleMesh& surface, const Options& options, const StageProgram& program,
                                 StageRun& run) {
  const bool counted = program.given("--cubes") && options.polycube.grid > 0;
  if (counted && program.given("--nodes"))
    throw UsageError("--cubes with --grid sets the nodes; leave out --nodes, --cubes or --grid");
  const std::string asked =
      counted ? fmt::format("--cubes is {} of {}³ cells", number_text(options.polycube.blocks), options.polycube.grid)
              : fmt::format("--nodes is {} (method.nodes of a scene)", number_text(options.polycube.nodes));
  const VoxelPolycube polycube = naming(options.input, [&] {
    try {
      return counted ? build_counted_polycube(surface, options.polycube, run.progress())
                     : build_voxel_polycube(surface, options.polycube, run.progress());
    } catch (const InputError& error) {
      throw InputError(std::string(error.what()) + "; " + asked);
    }
  });
  if (counted) {
    const double count = static_cast<double>(polycube.blocks.size());
    run.results()["cubes_wanted"] = options.polycube.blocks;
    if (std::abs(count / options.polycube.blocks - 1) > 0.1)
      run.progress().warn(
          fmt::format("the polycube has {} cubes where {} were wanted: no size of cubes was found that "
                      "comes nearer",
                      count, options.polycube.blocks));
  }
  if (polycube.genus != polycube.object_genus)
    run.progress().warn(
        fmt::format("the polycube's genus is {}, the object's {}: handles or hollows narrower than {} "
                    "mm are lost; more nodes may find them, {}",
                    polycube.genus, polycube.object_genus,
                    number_text(std::round(20 * polycube.spacing * polycube.cells_per_block) / 10), asked));
  if (polycube.coverage_max > 2.5 * polycube.cells_per_block)
    run.progress().warn(fmt::format(
        "the surface lies up to {:.1f} cells from the polycube: parts thinner than {} mm are lost; more "
        "nodes may find them, {}",
        polycube.coverage_max, number_text(std::round(2.5 * polycube.spacing * polycube.cells_per_block) / 10), asked));
  return polycube;
}

void record(const VoxelPolycube& polycube, nlohmann::json& results) {
  results["nodes"] = polygrid_nodes(polycube);
  results["cubes"] = polycube.blocks.size();
  results["grid"] = polycube.cells_per_block;
  results["cells"] = static_cast<double>(polycube.blocks.size()) * std::pow(polycube.cells_per_block, 3);
  results["spacing"] = polycube.spacing;
  results["object_genus"] = polycube.object_genus;
  results["genus"] = polycube.genus;
  results["singular_edges"] = polycube.singular_edges;
  results["singular_corners"] = polycube.singular_corners;
  results["coverage"] = {{"p99", polycube.coverage_p99}, {"max", polycube.coverage_max}};
}

}  // namespace
}  // namespace shellgrid

int main(int argc, char** argv) {
  using namespace shellgrid;
  StageProgram program("sg-polycube", "approximates an object by a polycube of equal blocks");
  Options options;
  declare(program, options);
  return program.run(argc, argv, [&](StageRun& run) {
    if (options.cubes.empty() && (program.given("--place") || program.given("--origin") || program.given("--edge")))
      throw UsageError("--place, --origin and --edge lay a polycube of your own; name its file after tets.hdf");
    if (!options.cubes.empty() && program.given("--cubes"))
      throw UsageError("--cubes does not go with a polycube of your own");
    run.start_timer("read");
    const TriangleMesh surface = boundary_of(read_tetrahedra(options.input));
    run.start_timer("polycube");
    const VoxelPolycube polycube = options.cubes.empty() ? automatic_polycube(surface, options, program, run)
                                                         : given_polycube(surface, options, program, run);
    if (!options.cubes.empty() && polycube.genus != polycube.object_genus)
      run.progress().warn(
          fmt::format("the cubes' genus is {}, the object's {}: the grid cannot follow the object there",
                      polycube.genus, polycube.object_genus));
    run.start_timer("write");
    write_polycube(run.output(), polycube);
    const std::string view = view_path(run.output());
    AttributedMesh blocks;
    blocks.mesh = polycube_surface(polycube);
    write_ply(view, blocks);
    run.note_output(view);
    record(polycube, run.results());
  });
}
