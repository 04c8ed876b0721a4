// SPDX-License-Identifier: AGPL-3.0-or-later
#pragma once
#include <filesystem>
#include <string>

namespace shellgrid {

// Where the view of an artefact goes: `out/shell.vdb` has `out/shell.view.ply`.
inline std::string view_path(const std::string& artefact) {
  return std::filesystem::path(artefact).replace_extension(".view.ply").string();
}

}  // namespace shellgrid
