// SPDX-License-Identifier: AGPL-3.0-or-later
#include "pipeline/scene/plan_makefile.h"

#include <fmt/format.h>

#include "meshing/core/error.h"

namespace shellgrid {
namespace {

std::string join(const std::vector<std::string>& words) { return fmt::format("{}", fmt::join(words, " ")); }

// The last gate before a text becomes Make's and the shell's.
const std::string& plain(const std::string& word) {
  if (word.empty() || word.find_first_not_of("abcdefghijklmnopqrstuvwxyzABCDEFGHIJKLMNOPQRSTUVWXYZ0123456789"
                                             "_-+./,") != std::string::npos)
    throw InternalError("a word of the Makefile is not plain: " + word);
  return word;
}

std::string command(const PlannedStage& stage, const std::map<std::string, std::string>& names) {
  std::string line = "$(programs)/" + stage.program();
  for (const std::string& argument : stage.arguments)
    line += " " + plain(argument.starts_with("@") ? names.at(argument) : argument);
  return line;
}

}  // namespace

std::string plan_makefile(const Plan& plan, const std::map<std::string, std::string>& names,
                          const std::string& programs) {
  std::string text;
  text += makefile_beginning;
  text += " plan/plan.json holds the same for machines. Run it by `make -C FOLDER [TARGET]`, where\n";
  text += "# TARGET is any artefact, `all` (the picture), `views` or `report`. Options for every stage: FLAGS='-q'.\n";
  text += "#\n";
  text += "# Material: " + plan.material + ".\n";
  text +=
      "# A stage runs when the content of something it reads has changed. The next lines ask sg-plan, which takes\n";
  text +=
      "# the stamps in .done away from such stages; .done/X.xxh64 changes only when the bytes of X do, so a stage\n";
  text += "# that makes the same again is the last one to run.\n";
  text += "SHELL := /bin/sh\n";
  text += "MAKEFLAGS += --no-builtin-rules\n";
  text += "programs := " + plain(programs) + "\n";
  text += "FLAGS ?=\n";
  text += "refreshed := $(shell $(programs)/sg-plan --refresh -q -o . 2>&1)\n";
  text += "ifneq ($(.SHELLSTATUS),0)\n$(error $(refreshed))\nendif\n\n";
  text += "# A changed scene makes another plan, which Make then reads again.\n";
  text += "Makefile: .done/plan ;\n";
  text += ".done/plan:\n\t@$(programs)/sg-plan --again -q -o .\n\t@touch Makefile\n\n";
  text += ".DEFAULT_GOAL := all\n.DELETE_ON_ERROR:\n";
  text += ".SUFFIXES:\n";
  text += ".PHONY: all views report\n\n";
  std::vector<std::string> views;
  for (const PlannedStage& stage : plan.stages)
    if (stage.needed) views.insert(views.end(), stage.views.begin(), stage.views.end());
  text += "all: image.exr image.png\n\n";
  text += "views: " + join(views) + "\n\n";
  text += "report: all\n\t@$(programs)/sg-report . -o report.html $(FLAGS)\n\n";
  for (const PlannedStage& stage : plan.stages) {
    if (!stage.needed) {
      text += fmt::format("# {} is left out, because {}.\n\n", stage.name, stage.reason);
      continue;
    }
    text += fmt::format("# {} makes {}, because {}.\n", stage.name, stage.purpose, stage.reason);
    std::vector<std::string> stamps, made = stage.outputs, contents;
    for (const std::string& artefact : stage.artefacts) stamps.push_back(".done/" + artefact + ".xxh64");
    for (const std::string& output : stage.outputs) contents.push_back(".done/" + output + ".xxh64");
    made.insert(made.end(), stage.views.begin(), stage.views.end());
    made.insert(made.end(), contents.begin(), contents.end());
    text += join(made) + " &: .done/" + stage.name + " ;\n";
    text += ".done/" + stage.name + ":" + (stamps.empty() ? "" : " " + join(stamps)) + "\n";
    text += "\t" + command(stage, names) + " $(FLAGS)\n";
    text += "\t@$(programs)/sg-plan --stamp " + plain(stage.name) + " -q -o .\n\n";
  }
  return text;
}

}  // namespace shellgrid
