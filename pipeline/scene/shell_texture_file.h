// SPDX-License-Identifier: AGPL-3.0-or-later
#pragma once
#include <memory>
#include <string>
#include <vector>

#include "solvers/shell_texture/shell_texture_archive.h"
#include "solvers/shell_texture/spread_light.h"

namespace shellgrid {

// A shell texture function as sg-irradiance writes it, plain (.vdb) or compressed (.stf), to be looked up.
// parts: of a plain one, what is read; with its bottom alone it has no reader. sample: the hash of its sample's file,
// as in origin.h. Throws: InputError.
std::unique_ptr<ShellTextureLookup> open_shell_texture(const std::string& path,
                                                       ShellTextureParts parts = ShellTextureParts::all,
                                                       std::string* sample = nullptr);

// The choices of `--correction` of sg-core and sg-render.
inline const std::vector<std::string> irradiance_correction_names = {"kernels", "one", "none"};
inline constexpr const char* irradiance_correction_help =
    "how matter sees light that is uneven about it: by the kernel of each place where it enters, by one kernel for all "
    "of them, or, none, as if it were even";
inline constexpr const char* flat_shell_help =
    "takes shell and core as flat, as the paper does, where they are as bent as the surface by default";
IrradianceCorrection irradiance_correction(const std::string& name);

}  // namespace shellgrid
