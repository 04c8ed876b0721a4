// SPDX-License-Identifier: AGPL-3.0-or-later
#include <fmt/format.h>

#include <cmath>
#include <nlohmann/json.hpp>

#include "meshing/core/error.h"
#include "meshing/formats/mesh_file.h"
#include "meshing/formats/polycube_file.h"
#include "meshing/formats/vtkhdf_file.h"
#include "meshing/polycube/polycube_map.h"
#include "meshing/polycube/tetrahedralize.h"
#include "meshing/polycube/voxel_polycube.h"
#include "pipeline/cli/option_table.h"
#include "pipeline/cli/stage_program.h"
#include "pipeline/cli/view_path.h"

int main(int argc, char** argv) {
  using namespace shellgrid;
  StageProgram program("sg-polycube", "approximates an object by a polycube of equal blocks");
  std::string input;
  PolycubeOptions options;
  program.input("tets.hdf", input, "tetrahedral mesh of the object");
  program.output("polycube.hdf", "blocks with their lattice coordinates (VTKHDF); a view.ply beside it");
  program.output_beside(".view.ply");
  program.option("--nodes", options.nodes, "", "nodes wanted in the polygrid", 200, 2e7);
  program.option("--cubes", options.blocks, "", "blocks wanted, where --grid is 0", 8, 1e6);
  program.option("--grid", options.grid, "", "cells along a block's edge; 0 chooses by --cubes", 0, 256);
  program.option("--sweeps", options.anneal_sweeps, "", "annealing sweeps over the stairs", 0, 10000);
  program.example("sg-polycube tets.hdf -o polycube.hdf --nodes 1e5", "a polycube for 100 000 nodes");
  return program.run(argc, argv, [&](StageRun& run) {
    run.start_timer("read");
    const TriangleMesh surface = boundary_of(read_tetrahedra(input));
    run.start_timer("polycube");
    const std::string asked = fmt::format("--nodes is {} (method.nodes of a scene)", number_text(options.nodes));
    const VoxelPolycube polycube = naming(input, [&] {
      try {
        return build_voxel_polycube(surface, options, run.progress());
      } catch (const InputError& error) {
        throw InputError(std::string(error.what()) + "; " + asked);
      }
    });
    if (polycube.genus != polycube.object_genus)
      run.progress().warn(
          fmt::format("the polycube's genus is {}, the object's {}: handles or hollows narrower than {} "
                      "mm are lost; more nodes may find them, {}",
                      polycube.genus, polycube.object_genus,
                      number_text(std::round(20 * polycube.spacing * polycube.cells_per_block) / 10), asked));
    run.start_timer("write");
    write_polycube(run.output(), polycube);
    const std::string view = view_path(run.output());
    AttributedMesh blocks;
    blocks.mesh = polycube_surface(polycube);
    write_ply(view, blocks);
    run.note_output(view);
    auto& results = run.results();
    results["cubes"] = polycube.blocks.size();
    results["cells_per_cube_edge"] = polycube.cells_per_block;
    results["spacing"] = polycube.spacing;
    results["object_genus"] = polycube.object_genus;
    results["genus"] = polycube.genus;
    results["singular_edges"] = polycube.singular_edges;
    results["singular_corners"] = polycube.singular_corners;
    results["coverage"] = {{"p99", polycube.coverage_p99}, {"max", polycube.coverage_max}};
  });
}
