// SPDX-License-Identifier: AGPL-3.0-or-later
#pragma once
#include <functional>
#include <string>
#include <vector>

#include "pipeline/scene/description_section.h"
#include "synthesis/material_sample.h"

namespace shellgrid {

// What descriptions of all kinds share.
struct SampleExtent {
  int width = 128, height = 128;  // n_x, n_y, texels
  double voxel = 0.4;             // mm
  double thickness = 4;           // mm
  bool thickness_given = false;   // else a volume keeps its own
  bool voxel_given = false;
  double ior = 1.5;
  std::uint64_t seed = 1;
};

// A sample and what its making found.
struct MadeSample {
  MaterialSample sample;
  nlohmann::json figures = nlohmann::json::object();
  std::vector<std::string> warnings;
};

// How a description's sample is made: what its text says, checked, and nothing read or computed yet.
struct SampleRecipe {
  SampleExtent extent;
  std::vector<std::string> files;   // that `make` reads
  std::function<void()> check;      // of the files' heads alone, where there is something to check; throws InputError
  std::vector<Material> materials;  // of which the sample is made; empty where files tell
  // With another thickness than the recipe's the same material, deeper.
  std::function<MadeSample(const SampleExtent&)> make;
  bool deepens = true;  // else a greater thickness cannot be made
  bool grows = false;   // whether another width and height can be made as well
};

// Each kind of source reads its own keys and fills the recipe, whose extent is set. Throw InputError.
void describe_procedural(DescriptionSection& root, const std::string& type, SampleRecipe& recipe);
void describe_volume(DescriptionSection& root, SampleRecipe& recipe);
void describe_meshes(DescriptionSection& root, SampleRecipe& recipe);
void describe_solid(DescriptionSection& root, SampleRecipe& recipe);

}  // namespace shellgrid
