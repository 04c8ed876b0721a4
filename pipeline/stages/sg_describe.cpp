// SPDX-License-Identifier: AGPL-3.0-or-later
#include <nlohmann/json.hpp>

#include "meshing/core/error.h"
#include "meshing/formats/describe.h"
#include "meshing/formats/image_file.h"
#include "meshing/formats/mesh_file.h"
#include "meshing/formats/output_file.h"
#include "meshing/formats/vdb_file.h"
#include "meshing/formats/vtkhdf_file.h"
#include "meshing/polycube/polygrid_hierarchy.h"
#include "pipeline/cli/stage_program.h"
#include "synthesis/sample_archive.h"
#include "synthesis/sample_picture.h"

using namespace shellgrid;

int main(int argc, char** argv) {
  std::string path;
  bool as_json = false;
  int level = 1;
  StageProgram program("sg-describe", "says what an artefact is: kind, counts, bounds, value ranges");
  program.input("ARTEFACT", path,
                "a mesh (ply obj off stl), volume (vdb), grid (hdf), image (exr png) or record (json)");
  program.output(
      "description.json",
      "the description as JSON; as .ply, a polygrid's coarse level to look at; as .png, slices of a sample or a shell",
      true, {".ply", ".png"});
  program.flag("--json", as_json, "print JSON instead of text");
  program.option("--level", level, "", "of the polygrid's hierarchy, for -o NAME.ply", 1, 64);
  program.example("sg-describe surface.ply", "vertices, genus, bounds, the range of each property");
  program.example("sg-describe shell.vdb --json", "the same for programs");
  program.example("sg-describe sample.vdb -o sample.png", "a sample from above, its middle layer and two cuts");
  program.example("sg-describe polygrid.hdf --level 2 -o level2.ply", "the nodes of a coarse level");
  return program.run(argc, argv, [&](StageRun& run) {
    const nlohmann::json description = describe_artefact(path);
    run.results() = description;
    const std::string text = description.dump(2, ' ', false, nlohmann::json::error_handler_t::replace);
    run.print(as_json ? text : description_text(description));
    if (run.output().ends_with(".ply")) {
      const Polygrid polygrid = read_polygrid(path);
      write_ply(run.output(), naming(path, [&] { return level_view(polygrid, level); }));
    } else if (run.output().ends_with(".png")) {
      const SamplePicture picture = description.at("kind") == "volume: shell volume"
                                        ? draw_shell(read_shell_volume(path))
                                        : draw_sample(restore_sample(read_vdb(path)));
      write_png(run.output(), picture.width, picture.height, picture.rgb);
    } else if (!run.output().empty()) {
      write_text_atomically(run.output(), text + "\n");
    }
  });
}
