// SPDX-License-Identifier: AGPL-3.0-or-later
#pragma once
#include <optional>
#include <string>
#include <vector>

#include "pipeline/scene/sample_recipe.h"

namespace shellgrid {

// What the command line says instead of the file.
struct SampleOverrides {
  std::optional<double> voxel, thickness, ior;
  std::optional<std::uint64_t> seed;
  bool enlarge = false;  // where the sample fails a check of [STF §5.1, §5.2], make it larger
};

// Makes the base volume that a file describes: a JSON description (comments allowed) or an OpenVDB volume. What a
// description may say is in meshing/formats/FORMATS.md. A thickness that is given cuts a volume's lower layers off.
// To enlarge, a sample is made deeper, or its bottom layer continues; what does not tile comes beside its mirror
// images; a solid is grown wider and higher, of others whole periods are repeated. Throws: InputError for what is not
// JSON, an unknown key (named with its place and the nearest known key), a wrong type, a value out of range, a missing
// file.
MadeSample make_sample(const std::string& path, const SampleOverrides& overrides);
MaterialSample load_sample(const std::string& path, const SampleOverrides& overrides);

// Whether load_sample can make a sample of a JSON description, as far as its text tells; files that it names are not
// read, but must be there. Returns their paths. Throws: InputError, as load_sample.
std::vector<std::string> check_sample_description(const std::string& path, const SampleOverrides& overrides);

// The materials of which a JSON description makes its sample; none where files tell, or it is a volume itself.
// Throws: InputError, as check_sample_description.
std::vector<Material> described_materials(const std::string& path);

}  // namespace shellgrid
