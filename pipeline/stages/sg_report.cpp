// SPDX-License-Identifier: AGPL-3.0-or-later
#include <nlohmann/json.hpp>

#include "meshing/formats/output_file.h"
#include "pipeline/cli/stage_program.h"
#include "pipeline/scene/run_report.h"

using namespace shellgrid;

int main(int argc, char** argv) {
  StageProgram program("sg-report", "puts the run of a scene on one page that opens in any browser");
  std::string folder;
  program.input_folder("FOLDER", folder, "folder of a scene's artefacts, as sg-plan makes it");
  program.output("report.html",
                 "the page: each stage's picture, figures, time, memory, and the command that remakes it");
  program.example("sg-report out/marble-bunny -o out/marble-bunny/report.html", "makes the page");
  return program.run(argc, argv, [&](StageRun& run) {
    const RunReport report = report_run(folder);
    write_text_atomically(run.output(), report.html);
    run.results()["stages"] = report.stages;
    run.results()["stages_made"] = report.stages_made;
    run.results()["pictures"] = report.pictures;
    run.results()["seconds_of_stages"] = report.seconds;
  });
}
