// SPDX-License-Identifier: AGPL-3.0-or-later
#pragma once
#include <nlohmann/json_fwd.hpp>
#include <string>

namespace shellgrid {

// What any artefact is, by its extension (ply obj off stl vdb hdf exr png json): its kind, counts, bounds, value ranges
// of each property, grid, array or channel; of meshes whether they are closed, Euler characteristic and genus.
// Throws: InputError for a file that cannot be read or an unknown extension.
nlohmann::json describe_artefact(const std::string& path);

// The same in words: lines without a last line end.
std::string description_text(const nlohmann::json& description);

}  // namespace shellgrid
