// SPDX-License-Identifier: AGPL-3.0-or-later
#include "pipeline/scene/sample_description.h"

#include <fmt/format.h>

#include <cerrno>
#include <cmath>
#include <cstring>
#include <filesystem>
#include <nlohmann/json.hpp>

#include "meshing/core/error.h"
#include "meshing/formats/output_file.h"
#include "meshing/formats/vdb_file.h"
#include "pipeline/cli/nearest_name.h"
#include "pipeline/scene/description_section.h"
#include "pipeline/scene/pattern_description.h"
#include "synthesis/sample_archive.h"

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
}

MaterialSample finish_volume(MaterialSample sample, const SampleOverrides& overrides, const std::string& path) {
  if (overrides.voxel) sample.voxel = *overrides.voxel;
  if (overrides.ior) sample.ior = *overrides.ior;
  if (overrides.thickness) cut(sample, *overrides.thickness, path);
  return sample;
}

json parse(const std::string& path) {
  try {
    return json::parse(read_text(path), nullptr, true, true);
  } catch (const json::exception& error) {
    std::string reason = error.what();
    if (const std::size_t end = reason.find("] "); end != std::string::npos) reason = reason.substr(end + 2);
    throw InputError(path + ": is not JSON: " + one_line(reason));
  }
}

bool is_volume(const std::string& path) { return std::filesystem::path(path).extension() == ".vdb"; }

// What a description's text says.
struct Description {
  SampleOverrides settings;     // of the command line, else of the text
  std::string volume;           // path of the volume to import; empty for procedural samples
  VolumeImport import;          // of that volume
  SampleDefinition definition;  // of a procedural sample
};

Description read_description(const std::string& path, const SampleOverrides& overrides) {
  const json document = parse(path);
  DescriptionSection root(path, "", document);
  std::vector<std::string> types = procedural_types();
  types.push_back("volume");
  const std::string type = root.word("type", "", types);
  Description description;
  SampleOverrides& settings = description.settings;
  settings = overrides;
  const auto setting = [&](std::optional<double>& value, const std::string& key, double least, double most) {
    const bool present = root.has(key);
    const double number = root.number(key, 0, least, most);
    if (present && !value) value = number;
  };
  setting(settings.voxel, "voxel", 1e-6, 1e4);
  setting(settings.thickness, "thickness", 1e-6, 1e4);
  setting(settings.ior, "ior", 1, 4);
  if (type == "volume") {
    VolumeImport& import = description.import;
    import.extinction_scale = root.number("extinction_scale", 1, 0, 1e6);
    import.albedo = root.color("albedo", import.albedo, 0, 1);
    import.anisotropy = root.color("anisotropy", import.anisotropy, -0.999, 0.999);
    import.least_density = root.number("least_density", 0, -1e9, 1e9);
    const std::string file = root.text("file", "");
    if (file.empty()) root.fail("file", "is missing; expected a .vdb");
    root.finish();
    description.volume = (std::filesystem::path(path).parent_path() / file).string();
    return description;
  }
  SampleDefinition& definition = description.definition;
  const std::vector<int> size = root.integers("size", {definition.width, definition.height}, 4, 2048, "[n_x, n_y]");
  definition.width = size[0], definition.height = size[1];
  definition.voxel = settings.voxel.value_or(definition.voxel);
  definition.thickness = settings.thickness.value_or(definition.thickness);
  definition.ior = settings.ior.value_or(definition.ior);
  definition.seed = static_cast<std::uint64_t>(root.integer("seed", 1, 0, 2000000000));
  if (settings.seed) definition.seed = *settings.seed;
  definition.pattern = read_pattern(root, type);
  root.finish();
  try {
    procedural_sample_size(definition);
  } catch (const InputError& error) {
    throw InputError(path + ": " + error.what());
  }
  return description;
}

}  // namespace

MaterialSample load_sample(const std::string& path, const SampleOverrides& overrides) {
  if (is_volume(path)) {
    const VdbArchive archive = read_vdb(path);
    return finish_volume(is_sample_archive(archive) ? restore_sample(archive) : import_sample(archive, {}), overrides,
                         path);
  }
  const Description description = read_description(path, overrides);
  if (!description.volume.empty())
    return finish_volume(import_sample(read_vdb(description.volume), description.import), description.settings,
                         description.volume);
  try {
    return make_procedural_sample(description.definition);
  } catch (const InputError& error) {
    throw InputError(path + ": " + error.what());
  }
}

std::string check_sample_description(const std::string& path, const SampleOverrides& overrides) {
  if (is_volume(path)) return "";
  const Description description = read_description(path, overrides);
  std::error_code error;
  if (!description.volume.empty() && !std::filesystem::is_regular_file(description.volume, error))
    throw InputError(path + ": file: " + description.volume + ": " + std::strerror(ENOENT));
  return description.volume;
}

std::vector<Material> described_materials(const std::string& path) {
  if (is_volume(path)) return {};
  const Description description = read_description(path, {});
  if (!description.volume.empty()) return {};
  return materials_of(description.definition.pattern);
}

}  // namespace shellgrid
