// SPDX-License-Identifier: AGPL-3.0-or-later
// Which stages a scene needs, with which inputs and options, and why.
#pragma once
#include <map>
#include <string>
#include <vector>

#include <nlohmann/json.hpp>

namespace shellgrid {

// A file from outside the scene's folder that a stage reads.
struct ExternalFile {
  std::string name;  // under which records and reasons speak of it: "mesh", "sample", "light 0"
  std::string path;  // as the scene resolves it
};

struct PlannedStage {
  std::string name;     // "prepare"
  std::string purpose;  // what it makes, in a few words
  bool needed = true;
  bool on_demand = false;   // off the way to the picture: Make runs it where its output is asked for
  std::string reason = {};  // why it runs or is left out
  // Words of its command line. "@mesh" stands for the external file of that name.
  std::vector<std::string> arguments = {};
  std::vector<std::string> artefacts = {};  // read: outputs of earlier stages
  std::vector<ExternalFile> files = {};     // read: files from outside
  std::vector<std::string> outputs = {};    // written; the first is the primary one
  std::vector<std::string> views = {};      // written beside it, for a mesh viewer
  nlohmann::json slice = nullptr;           // the part of the scene it reads, as plan/NAME.json; null: none
  std::string tool = {};                    // NAME of its program sg-NAME; empty: its own name

  std::string program() const { return "sg-" + (tool.empty() ? name : tool); }
};

struct Plan {
  std::string scene;                 // path of the scene file
  std::vector<std::string> read;     // files whose change asks for another plan
  std::string material;              // "heterogeneous shell", "homogeneous" or "opaque"
  std::vector<PlannedStage> stages;  // in an order in which they can run
  std::vector<std::string> warnings = {};
};

// Throws: InputError as read_scene does, and where a section is missing that a picture needs.
Plan make_plan(const std::string& scene_path);

}  // namespace shellgrid
