// SPDX-License-Identifier: AGPL-3.0-or-later
#include <nlohmann/json.hpp>

#include "meshing/core/error.h"
#include "meshing/formats/mesh_file.h"
#include "meshing/formats/vtkhdf_file.h"
#include "meshing/polycube/tetrahedralize.h"
#include "meshing/surface/repair.h"
#include "pipeline/cli/stage_program.h"

int main(int argc, char** argv) {
  using namespace shellgrid;
  StageProgram program("sg-tetrahedralize", "fills a closed surface with tetrahedra");
  std::string input;
  TetrahedralizeOptions options;
  program.input("surface.ply", input, "closed surface, as sg-prepare writes it");
  program.output("tets.hdf", "tetrahedral mesh (VTKHDF)");
  program.option("--proxy-faces", options.proxy_faces, "", "simplify a heavier surface to about so many faces", 100);
  program.option("--limit", options.limit_seconds, "s", "processor time that the mesher may take", 1, 86400);
  program.option(
      "--spacing", options.spacing, "mm",
      "edge of the tetrahedra inside, well shaped to compute on, for a surface of such triangles; 0: as few as fill it",
      0, 1e6);
  program.example("sg-tetrahedralize surface.ply -o tets.hdf", "tetrahedra of a prepared surface");
  return program.run(argc, argv, [&](StageRun& run) {
    run.start_timer("read");
    const TriangleMesh surface = read_mesh(input).mesh;
    naming(input, [&] { require_closed_surface(surface); });
    run.start_timer("tetrahedralize");
    const TetrahedralizeResult result = naming(input, [&] { return tetrahedralize(surface, options, run.progress()); });
    run.start_timer("write");
    write_tetrahedra(run.output(), result.mesh);
    run.results()["points"] = result.mesh.points.rows();
    run.results()["tetrahedra"] = result.mesh.tetrahedra.rows();
    run.results()["surface_faces"] = result.surface_faces;
    run.results()["simplified"] = result.simplified;
    run.results()["genus"] = genus(surface);
    run.results()["volume"] = result.volume;
    run.results()["volume_error"] = result.volume / enclosed_volume(surface) - 1;
  });
}
