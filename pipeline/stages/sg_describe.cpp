// SPDX-License-Identifier: AGPL-3.0-or-later
#include <nlohmann/json.hpp>

#include "meshing/formats/describe.h"
#include "meshing/formats/output_file.h"
#include "pipeline/cli/stage_program.h"

using namespace shellgrid;

int main(int argc, char** argv) {
  std::string path;
  bool as_json = false;
  StageProgram program("sg-describe", "says what an artefact is: kind, counts, bounds, value ranges");
  program.input("ARTEFACT", path,
                "a mesh (ply obj off stl), volume (vdb), grid (hdf), image (exr png) or record (json)");
  program.output("description.json", "the description as JSON", true);
  program.flag("--json", as_json, "print JSON instead of text");
  program.example("sg-describe surface.ply", "vertices, genus, bounds, the range of each property");
  program.example("sg-describe shell.vdb --json", "the same for programs");
  return program.run(argc, argv, [&](StageRun& run) {
    const nlohmann::json description = describe_artefact(path);
    run.results() = description;
    const std::string text = description.dump(2, ' ', false, nlohmann::json::error_handler_t::replace);
    run.print(as_json ? text : description_text(description));
    if (!run.output().empty()) write_text_atomically(run.output(), text + "\n");
  });
}
