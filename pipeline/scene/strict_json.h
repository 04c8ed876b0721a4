// SPDX-License-Identifier: AGPL-3.0-or-later
#pragma once
#include <string>

#include <nlohmann/json.hpp>

namespace shellgrid {

// The JSON of a file that a person writes: comments allowed, no key twice in one section.
// Throws: InputError "PATH: what is wrong".
nlohmann::json read_strict_json(const std::string& path);

}  // namespace shellgrid
