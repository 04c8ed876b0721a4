// SPDX-License-Identifier: AGPL-3.0-or-later
#pragma once
#include <memory>
#include <string>

#include "solvers/shell_texture/shell_texture_lookup.h"

namespace shellgrid {

// A shell texture function as sg-irradiance writes it, plain (.vdb) or compressed (.stf), to be looked up.
// Throws: InputError.
std::unique_ptr<ShellTextureLookup> open_shell_texture(const std::string& path);

}  // namespace shellgrid
