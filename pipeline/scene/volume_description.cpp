// SPDX-License-Identifier: AGPL-3.0-or-later
#include <fmt/format.h>

#include <cmath>

#include "meshing/core/error.h"
#include "meshing/formats/vdb_file.h"
#include "pipeline/scene/sample_recipe.h"
#include "synthesis/sample_archive.h"

namespace shellgrid {

void describe_volume(DescriptionSection& root, SampleRecipe& recipe) {
  VolumeImport import;
  import.extinction_scale = root.number("extinction_scale", 1, 0, 1e6);
  import.albedo = root.color("albedo", import.albedo, 0, 1);
  import.anisotropy = root.color("anisotropy", import.anisotropy, -0.999, 0.999);
  import.least_density = root.number("least_density", 0, -1e9, 1e9);
  const std::string name = root.text("file", "");
  if (name.empty()) root.fail("file", "is missing; expected a .vdb");
  const std::string file = root.file(name);
  recipe.files = {file};
  recipe.make = [import, file](const SampleExtent&) {
    MadeSample made;
    made.sample = import_sample(read_vdb(file), import);
    return made;
  };
}

}  // namespace shellgrid
