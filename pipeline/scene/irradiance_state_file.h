// SPDX-License-Identifier: AGPL-3.0-or-later
#pragma once
#include <string>

#include "solvers/shell_texture/irradiance_sums.h"

namespace shellgrid {

// What the paths of a shell texture function have gathered, in a file, bit by bit; `fingerprint` is of all inputs and
// options that they depend on. Throws: InputError.
void write_irradiance_state(const std::string& path, const std::string& fingerprint, const IrradianceSums& sums);

// The state, of the same sizes as `expected`. Throws: InputError for a damaged file or one of another fingerprint.
IrradianceSums read_irradiance_state(const std::string& path, const std::string& fingerprint,
                                     const IrradianceSums& expected);

}  // namespace shellgrid
