// SPDX-License-Identifier: AGPL-3.0-or-later
#pragma once
#include <optional>
#include <string>
#include <vector>

#include "synthesis/material_sample.h"

namespace shellgrid {

// What the command line says instead of the file.
struct SampleOverrides {
  std::optional<double> voxel, thickness, ior;
  std::optional<std::uint64_t> seed;
};

// Makes the base volume that a file describes: a JSON description (comments allowed) or an OpenVDB volume.
//
// A description has `type` (marble, spots, layers, bumps, wood, cells, grass, weave, volume), `size` [n_x, n_y],
// `voxel` mm, `thickness` mm, `ior`, `seed`, `materials` (by the names that the type uses; each {"named": …} or
// {"absorption", "scattering", "anisotropy"}) and the type's own keys. A thickness that is given cuts a volume's lower
// layers off. Throws: InputError for what is not JSON, an unknown key (named with its place and the nearest known key),
// a wrong type, a value out of range, a missing file.
MaterialSample load_sample(const std::string& path, const SampleOverrides& overrides);

// Whether load_sample can make a sample of a JSON description, as far as its text tells; volumes are not read. Returns
// the path of the volume that it imports, or an empty one. Throws: InputError, as load_sample.
std::string check_sample_description(const std::string& path, const SampleOverrides& overrides);

// The materials of which a JSON description makes its sample; none where it imports a volume, or is one itself.
// Throws: InputError, as check_sample_description.
std::vector<Material> described_materials(const std::string& path);

}  // namespace shellgrid
