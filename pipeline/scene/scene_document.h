// SPDX-License-Identifier: AGPL-3.0-or-later
#pragma once
#include <string>
#include <vector>

#include <nlohmann/json.hpp>

namespace shellgrid {

// A scene file as JSON, checked against the schema: every key known, every type and range right, every file there.
struct SceneDocument {
  std::string path;
  nlohmann::json root;  // as in the file, but for paths, which are resolved against its folder
};

// Throws: InputError "PATH: PLACE: what is wrong".
SceneDocument read_scene_document(const std::string& path);

}  // namespace shellgrid
