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
#include "pipeline/scene/named_materials.h"
#include "synthesis/procedural_sample.h"
#include "synthesis/sample_archive.h"

namespace shellgrid {
namespace {

using nlohmann::json;

// One section of a description. Every key must be asked for before `finish`, which refuses the rest.
class DescriptionSection {
 public:
  DescriptionSection(const std::string& file, const std::string& place, const json& values)
      : file_(file), place_(place), values_(values) {
    if (!values.is_object()) fail("", "expected a section { … }");
  }

  bool has(const std::string& key) {
    known_.push_back(key);
    return values_.contains(key);
  }
  double number(const std::string& key, double otherwise, double least, double most) {
    return has(key) ? check(key, values_.at(key), least, most) : otherwise;
  }
  int integer(const std::string& key, int otherwise, int least, int most) {
    const double value = number(key, otherwise, least, most);
    if (value != std::floor(value)) fail(key, "is not a whole number");
    return static_cast<int>(value);
  }
  Rgb color(const std::string& key, const Rgb& otherwise, double least, double most) {
    if (!has(key)) return otherwise;
    const json& value = values_.at(key);
    if (value.is_number()) return Rgb::Constant(static_cast<float>(check(key, value, least, most)));
    if (!value.is_array() || value.size() != 3) fail(key, "expected a number or [r, g, b]");
    Rgb rgb;
    for (int c = 0; c < 3; ++c) rgb[c] = static_cast<float>(check(key, value[c], least, most));
    return rgb;
  }
  std::string text(const std::string& key, const std::string& otherwise) {
    if (!has(key)) return otherwise;
    if (!values_.at(key).is_string()) fail(key, "expected a text");
    return values_.at(key).get<std::string>();
  }
  DescriptionSection section(const std::string& key) {
    if (!has(key)) fail(key, "is missing");
    return {file_, place_of(key), values_.at(key)};
  }
  // The elements of a list of sections.
  std::vector<DescriptionSection> list(const std::string& key) {
    std::vector<DescriptionSection> elements;
    if (!has(key)) return elements;
    if (!values_.at(key).is_array()) fail(key, "expected a list [ … ]");
    for (std::size_t i = 0; i < values_.at(key).size(); ++i)
      elements.emplace_back(file_, fmt::format("{}[{}]", place_of(key), i), values_.at(key)[i]);
    return elements;
  }
  void finish() const {
    for (const auto& [key, value] : values_.items()) {
      if (std::find(known_.begin(), known_.end(), key) != known_.end()) continue;
      const std::string near = did_you_mean(key, known_);
      fail(key, "unknown key" + (near.empty() ? fmt::format("; known here: {}", fmt::join(known_, ", ")) : near));
    }
  }
  [[noreturn]] void fail(const std::string& key, const std::string& what) const {
    const std::string place = key.empty() ? place_ : place_of(key);
    throw InputError(fmt::format("{}: {}: {}", file_, place.empty() ? "the description" : place, what));
  }

 private:
  std::string place_of(const std::string& key) const { return place_.empty() ? key : place_ + "." + key; }
  double check(const std::string& key, const json& value, double least, double most) const {
    if (!value.is_number()) fail(key, "expected a number");
    const double number = value.get<double>();
    if (!(number >= least && number <= most))
      fail(key, fmt::format("{} is out of range; expected {} … {}", value.dump(), least, most));
    return number;
  }

  std::string file_, place_;
  const json& values_;
  std::vector<std::string> known_;
};

Material read_material(DescriptionSection section) {
  Material material;
  if (section.has("named")) {
    try {
      material = named_material(section.text("named", "")).material;
    } catch (const InputError& error) {
      section.fail("named", error.what());
    }
  } else {
    const Rgb missing = Rgb::Constant(-1);
    const Rgb absorption = section.color("absorption", missing, 0, 1e4);
    const Rgb scattering = section.color("scattering", missing, 0, 1e4);
    if ((absorption < 0).any()) section.fail("absorption", "is missing; expected mm⁻¹, or a 'named' material");
    if ((scattering < 0).any()) section.fail("scattering", "is missing; expected mm⁻¹");
    material = Material::from_absorption_scattering(absorption, scattering,
                                                    section.color("anisotropy", Rgb::Zero(), -0.999, 0.999));
  }
  section.finish();
  return material;
}

SamplePattern read_pattern(DescriptionSection& root, const std::string& type) {
  if (type == "layers") {
    LayersPattern pattern;
    for (DescriptionSection& layer : root.list("layers")) {
      pattern.layers.push_back({read_material(layer.section("material")), layer.number("thickness", 1, 1e-6, 1e4)});
      layer.finish();
    }
    if (pattern.layers.empty()) root.fail("layers", "expected at least one layer");
    pattern.waviness = root.number("waviness", 0, 0, 1e3);
    pattern.cells = root.integer("cells", 4, 1, 256);
    return pattern;
  }
  DescriptionSection materials = root.section("materials");
  const Material body = read_material(materials.section("body"));
  if (type == "spots") {
    SpotsPattern pattern;
    pattern.body = body;
    pattern.spot = read_material(materials.section("spot"));
    pattern.count = root.integer("count", pattern.count, 1, 10000);
    pattern.radius = root.number("radius", pattern.radius, 1e-3, 1e3);
    pattern.variation = root.number("variation", pattern.variation, 0, 1);
    pattern.softness = root.number("softness", pattern.softness, 0, 1e3);
    materials.finish();
    return pattern;
  }
  if (type == "bumps") {
    BumpsPattern pattern;
    pattern.body = body;
    pattern.bump = read_material(materials.section("bump"));
    pattern.count = root.integer("count", pattern.count, 1, 10000);
    pattern.radius = root.number("radius", pattern.radius, 1e-3, 1e3);
    pattern.lift = root.number("lift", pattern.lift, 0, 10);
    materials.finish();
    return pattern;
  }
  MarblePattern pattern;
  pattern.body = body;
  pattern.vein = read_material(materials.section("vein"));
  materials.finish();
  pattern.warp = root.number("warp", pattern.warp, 0, 1e3);
  pattern.cloudiness = root.number("cloudiness", pattern.cloudiness, 0, 5);
  for (DescriptionSection& section : root.list("veins")) {
    VeinFamily vein;
    vein.cells = section.integer("cells", vein.cells, 1, 256);
    vein.width = section.number("width", vein.width, 1e-3, 1e3);
    vein.variation = section.number("variation", vein.variation, 0, 5);
    vein.strength = section.number("strength", vein.strength, 0, 1);
    vein.coverage = section.number("coverage", vein.coverage, 0, 1);
    vein.waves_x = section.integer("waves_x", 0, -64, 64);
    vein.waves_y = section.integer("waves_y", 0, -64, 64);
    section.finish();
    pattern.veins.push_back(vein);
  }
  return pattern;
}

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
  const std::vector<std::string> types = {"marble", "spots", "layers", "bumps", "volume"};
  const std::string type = root.text("type", "");
  if (std::find(types.begin(), types.end(), type) == types.end())
    root.fail("type", fmt::format("'{}' is none of {}{}", type, fmt::join(types, ", "), did_you_mean(type, types)));
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
  if (root.has("size")) {
    const json& size = document.at("size");
    if (!size.is_array() || size.size() != 2) root.fail("size", "expected [n_x, n_y]");
    int* extents[2] = {&definition.width, &definition.height};
    for (int i = 0; i < 2; ++i) {
      if (!size[i].is_number_integer() || size[i].get<long>() < 4 || size[i].get<long>() > 2048)
        root.fail("size", "expected whole numbers from 4 to 2048");
      *extents[i] = size[i].get<int>();
    }
  }
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
  struct Lister {
    std::vector<Material> operator()(const MarblePattern& p) const { return {p.body, p.vein}; }
    std::vector<Material> operator()(const SpotsPattern& p) const { return {p.body, p.spot}; }
    std::vector<Material> operator()(const BumpsPattern& p) const { return {p.body, p.bump}; }
    std::vector<Material> operator()(const LayersPattern& p) const {
      std::vector<Material> list;
      for (const LayersPattern::Layer& layer : p.layers) list.push_back(layer.material);
      return list;
    }
  };
  return std::visit(Lister(), description.definition.pattern);
}

}  // namespace shellgrid
