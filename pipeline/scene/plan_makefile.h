// SPDX-License-Identifier: AGPL-3.0-or-later
#pragma once
#include <map>
#include <string>

#include "pipeline/scene/plan.h"

namespace shellgrid {

// How every plan's Makefile begins.
inline constexpr const char* makefile_beginning = "# Written by sg-plan;";

// The text of a plan's Makefile. `names` gives for each "@file" of the stages' arguments the name by which Make and the
// shell may call it, `programs` that of the programs' folder: plain characters only.
// Throws: InternalError where a name is not plain.
std::string plan_makefile(const Plan& plan, const std::map<std::string, std::string>& names,
                          const std::string& programs);

}  // namespace shellgrid
