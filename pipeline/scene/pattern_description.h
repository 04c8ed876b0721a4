// SPDX-License-Identifier: AGPL-3.0-or-later
#pragma once
#include "pipeline/scene/description_section.h"
#include "synthesis/procedural_sample.h"

namespace shellgrid {

// The values of `type` that mean a procedural sample.
const std::vector<std::string>& procedural_types();

// The pattern of a description of one of these types, from its own keys. Throws: InputError.
SamplePattern read_pattern(DescriptionSection& root, const std::string& type);

// The materials that a pattern is made of.
std::vector<Material> materials_of(const SamplePattern& pattern);

}  // namespace shellgrid
