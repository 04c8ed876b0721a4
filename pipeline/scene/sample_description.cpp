// SPDX-License-Identifier: AGPL-3.0-or-later
#include "pipeline/scene/sample_description.h"

#include <fmt/format.h>

#include <algorithm>
#include <cerrno>
#include <cmath>
#include <cstring>
#include <filesystem>
#include <nlohmann/json.hpp>

#include "meshing/core/error.h"
#include "meshing/formats/vdb_file.h"
#include "pipeline/scene/description_section.h"
#include "pipeline/scene/pattern_description.h"
#include "pipeline/scene/sample_recipe.h"
#include "pipeline/scene/strict_json.h"
#include "synthesis/sample_archive.h"
#include "synthesis/sample_check.h"
#include "synthesis/sample_resize.h"

namespace shellgrid {
namespace {

using nlohmann::json;

// Keeps the top layers of a volume, as many as the thickness holds.
void cut(MaterialSample& sample, double thickness, const std::string& path) {
  const double layers = std::ceil(thickness / sample.voxel - 1e-6);
  if (!(layers <= sample.size.z()))
    throw InputError(
        fmt::format("{}: the volume is {} mm thick, {} mm are wanted; lower the thickness or enlarge the voxel", path,
                    sample.size.z() * sample.voxel, thickness));
  sample.size.z() = std::max(1, static_cast<int>(layers));
  const std::size_t count = sample.voxel_count();
  for (std::vector<Vec3f>* values : {&sample.extinction, &sample.albedo, &sample.anisotropy, &sample.normal})
    values->resize(count);
  sample.kind.resize(count);
  if (!sample.surface_ior.empty()) sample.surface_ior.resize(count);
}

// A volume's own thickness and index stand unless others were given.
void fit_volume(MaterialSample& sample, const SampleExtent& extent, bool ior_given, const std::string& path) {
  if (ior_given) sample.ior = extent.ior;
  if (extent.thickness_given) cut(sample, extent.thickness, path);
}

bool is_volume(const std::string& path) { return std::filesystem::path(path).extension() == ".vdb"; }

SampleRecipe read_recipe(const std::string& path, const SampleOverrides& overrides) {
  const json document = read_strict_json(path);
  DescriptionSection root(path, "", document);
  std::vector<std::string> types = procedural_types();
  types.insert(types.end(), {"volume", "meshes", "solid"});
  const std::string type = root.word("type", "", types);
  SampleRecipe recipe;
  SampleExtent& extent = recipe.extent;
  const auto setting = [&](double& value, const std::optional<double>& instead, const char* key, double least,
                           double most) {
    const bool given = root.has(key) || instead;
    value = root.number(key, value, least, most);
    if (instead) value = *instead;
    return given;
  };
  extent.voxel_given = setting(extent.voxel, overrides.voxel, "voxel", 1e-6, 1e4);
  extent.thickness_given = setting(extent.thickness, overrides.thickness, "thickness", 1e-6, 1e4);
  const bool ior_given = setting(extent.ior, overrides.ior, "ior", 1, 4);
  root.set_ior(extent.ior);
  recipe.deepens = type != "volume";
  recipe.grows = type == "solid";
  if (type == "volume") {
    describe_volume(root, recipe);
    const auto make = recipe.make;
    recipe.make = [make, ior_given, file = recipe.files.front()](const SampleExtent& wanted) {
      MadeSample made = make(wanted);
      fit_volume(made.sample, wanted, ior_given, file);
      return made;
    };
  } else {
    const std::vector<int> size = root.integers("size", {extent.width, extent.height}, 4, 2048, "[n_x, n_y]");
    extent.width = size[0], extent.height = size[1];
    const double layers = std::ceil(extent.thickness / extent.voxel - 1e-6);
    if (size[0] * (size[1] * layers) > 1e8)
      throw InputError(fmt::format("{}: {} x {} x {:.0f} voxels are too many for one sample; expected at most 1e8",
                                   path, size[0], size[1], layers));
    extent.seed = static_cast<std::uint64_t>(root.integer("seed", 1, 0, 2000000000));
    if (overrides.seed) extent.seed = *overrides.seed;
    if (type == "meshes")
      describe_meshes(root, recipe);
    else if (type == "solid")
      describe_solid(root, recipe);
    else
      describe_procedural(root, type, recipe);
  }
  // Measured values are mirrored before they are classified.
  if (root.boolean("mirror", false) && !root.has("classes")) {
    recipe.grows = false;
    recipe.make = [make = recipe.make](const SampleExtent& wanted) {
      MadeSample made = make(wanted);
      made.sample = mirror_sample(made.sample);
      return made;
    };
  }
  root.finish();
  // A file that several parts use is one.
  std::vector<std::string> files;
  for (const std::string& file : recipe.files)
    if (std::find(files.begin(), files.end(), file) == files.end()) files.push_back(file);
  recipe.files = files;
  return recipe;
}

// Makes the sample until it passes the checks that a larger one can pass; deeper layers change the means, so that it
// may take a second time.
MadeSample make_large_enough(const SampleRecipe& recipe) {
  SampleExtent extent = recipe.extent;
  MadeSample made = recipe.make(extent);
  std::vector<std::string> done;
  for (int round = 0; round < 4; ++round) {
    const SampleCheck check = check_sample(made.sample);
    const Vec3i size = made.sample.size, least = check.least_size;
    const bool deeper = least.z() > size.z();
    const bool wider = recipe.grows && (least.x() > size.x() || least.y() > size.y());
    if (!deeper && !wider) break;
    if (deeper && !recipe.deepens) {
      if (least.z() > 512) break;
      made.sample = with_layers(made.sample, least.z());
      done.push_back(fmt::format("the bottom layer continues down to {} layers", least.z()));
      continue;
    }
    if (deeper) extent.thickness = least.z() * extent.voxel;
    if (wider) extent.width = std::max(size.x(), least.x()), extent.height = std::max(size.y(), least.y());
    if (std::max(extent.width, extent.height) > 2048 || extent.thickness > 512 * extent.voxel) break;
    made = recipe.make(extent);
    const Vec3i now = made.sample.size;
    done.push_back(fmt::format("made with {} x {} x {} voxels", now.x(), now.y(), now.z()));
  }
  if (!check_sample(made.sample).tilable()) {
    made.sample = mirror_sample(made.sample);
    done.push_back("put beside its mirror images");
  }
  const Vec3i size = made.sample.size, least = check_sample(made.sample).least_size;
  const int times_x = std::max(1, (least.x() + size.x() - 1) / size.x());
  const int times_y = std::max(1, (least.y() + size.y() - 1) / size.y());
  if (times_x * times_y > 1 && std::max(times_x * size.x(), times_y * size.y()) <= 2048) {
    made.sample = repeat_sample(made.sample, times_x, times_y);
    done.push_back(fmt::format("repeated {} by {} times", times_x, times_y));
  }
  made.figures["enlarged"] = done;
  return made;
}

}  // namespace

MadeSample make_sample(const std::string& path, const SampleOverrides& overrides) {
  SampleRecipe recipe;
  if (is_volume(path)) {
    recipe.deepens = false;
    recipe.make = [&](const SampleExtent&) {
      const VdbArchive archive = read_vdb(path);
      MadeSample made;
      made.sample = is_sample_archive(archive) ? restore_sample(archive) : import_sample(archive, {});
      SampleExtent extent;
      if (overrides.voxel) made.sample.voxel = *overrides.voxel;
      extent.thickness_given = overrides.thickness.has_value(), extent.thickness = overrides.thickness.value_or(0);
      extent.ior = overrides.ior.value_or(0);
      fit_volume(made.sample, extent, overrides.ior.has_value(), path);
      return made;
    };
    return overrides.enlarge ? naming(path, [&] { return make_large_enough(recipe); }) : recipe.make({});
  }
  recipe = read_recipe(path, overrides);
  return naming(path, [&] { return overrides.enlarge ? make_large_enough(recipe) : recipe.make(recipe.extent); });
}

MaterialSample load_sample(const std::string& path, const SampleOverrides& overrides) {
  return make_sample(path, overrides).sample;
}

std::vector<std::string> check_sample_description(const std::string& path, const SampleOverrides& overrides) {
  if (is_volume(path)) {
    require_sample_grids(read_vdb_outline(path));
    return {};
  }
  const SampleRecipe recipe = read_recipe(path, overrides);
  std::error_code error;
  for (const std::string& file : recipe.files)
    if (!std::filesystem::is_regular_file(file, error))
      throw InputError(path + ": file: " + file + ": " + std::strerror(ENOENT));
  if (recipe.check) recipe.check();
  return recipe.files;
}

std::vector<Material> described_materials(const std::string& path) {
  if (is_volume(path)) return {};
  return read_recipe(path, {}).materials;
}

}  // namespace shellgrid
