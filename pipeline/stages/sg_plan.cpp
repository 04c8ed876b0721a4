// SPDX-License-Identifier: AGPL-3.0-or-later
#include <fmt/format.h>

#include <filesystem>

#include "pipeline/cli/option_table.h"
#include "pipeline/cli/stage_program.h"
#include "pipeline/scene/plan.h"
#include "pipeline/scene/plan_folder.h"
#include "pipeline/scene/scene_schema.h"

using namespace shellgrid;

namespace {

void print_reasons(const Plan& plan, const std::string& folder, StageRun& run) {
  std::vector<StageState> states;
  if (!folder.empty()) states = refresh_plan_folder(folder);
  run.print("material: " + plan.material);
  for (const PlannedStage& stage : plan.stages) {
    const char* const fate = !stage.needed ? "left out" : stage.on_demand ? "on demand" : "run";
    std::string line = fmt::format("{:<14} {:<9} {}", stage.name, fate, stage.reason);
    for (const StageState& state : states)
      if (state.name == stage.name) line += state.up_to_date ? " (up to date)" : " (to be made: " + state.why + ")";
    run.print(line);
  }
}

}  // namespace

int main(int argc, char** argv) {
  StageProgram program("sg-plan", "turns a scene into a Makefile of just the stages it needs");
  std::string scene, stage;
  bool why = false, refresh = false, again = false, keys = false;
  program.input("SCENE", scene, "scene (.json)", true);
  program.output_folder("FOLDER", "folder of the scene's artefacts; gets Makefile and plan/", true);
  program.flag("--why", why, "print each stage, run or left out, and why");
  program.flag("--refresh", refresh, "only forget the stamps of stages in FOLDER whose inputs changed (for Make)");
  program.flag("--again", again, "plan the scene of FOLDER again (for Make)");
  program.option("--stamp", stage, "only note that this stage of FOLDER has run (for Make)");
  program.flag("--scene-keys", keys, "print the table of scene keys, as Markdown");
  program.example("sg-plan marble-bunny.json -o out/marble-bunny && make -C out/marble-bunny", "makes the picture");
  program.example("sg-plan marble-bunny.json --why", "prints which stages the scene needs, and why");
  return program.run(argc, argv, [&](StageRun& run) {
    if (keys) return run.print(scene_schema_markdown());
    const std::string& folder = run.output();
    if (folder.empty() && (refresh || again || !stage.empty())) throw UsageError("missing -o FOLDER");
    if (!stage.empty()) return stamp_stage(folder, stage);
    if (refresh) {
      for (const StageState& state : refresh_plan_folder(folder))
        run.print(fmt::format("{:<14} {}", state.name, state.up_to_date ? "up to date" : state.why));
      return;
    }
    if (again) scene = scene_of_plan_folder(folder);
    if (scene.empty()) throw UsageError("missing SCENE");
    if (folder.empty() && !why) throw UsageError("nothing to do: give -o FOLDER or --why");
    const Plan plan = make_plan(scene);
    for (const std::string& warning : plan.warnings) run.progress().warn(warning);
    const std::string executables = std::filesystem::read_symlink("/proc/self/exe").parent_path().string();
    if (!folder.empty()) write_plan_folder(plan, folder, executables);
    if (why) print_reasons(plan, folder, run);
  });
}
