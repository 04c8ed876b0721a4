// SPDX-License-Identifier: AGPL-3.0-or-later
// The folder in which Make runs a plan: Makefile, plan/ (what the stages read of the scene), .done/ (what was made from
// what). Whether a stage is up to date is a question of content: before Make compares any times, `refresh_plan_folder`
// takes the stamps away from stages whose inputs changed bytes and lays out the times of all others in order.
#pragma once
#include <string>
#include <vector>

#include "pipeline/scene/plan.h"

namespace shellgrid {

struct StageState {
  std::string name;
  bool up_to_date = false;
  std::string why;  // "never made", "the sample changed", "surface.ply is missing"
};

// Writes Makefile, plan/STAGE.json and plan/plan.json; files whose content stays the same keep their time.
// `executables` is the folder of the sg-* programs. Names of files are data: where one holds anything but plain
// characters, the Makefile speaks of it by a symbolic link in plan/.
// Throws: InputError.
void write_plan_folder(const Plan& plan, const std::string& folder, const std::string& executables);

// Forgets the stamps of the plan, where the scene has changed, and of stages that must run again and says which ones
// and why; in the order of the plan. Throws: InputError where the folder holds no plan.
std::vector<StageState> refresh_plan_folder(const std::string& folder);

// The scene that the folder's plan was made from. Throws: InputError.
std::string scene_of_plan_folder(const std::string& folder);

// Notes that a stage has just run: stamps its outputs by content.
// Throws: InputError where an output is missing.
void stamp_stage(const std::string& folder, const std::string& stage);

}  // namespace shellgrid
