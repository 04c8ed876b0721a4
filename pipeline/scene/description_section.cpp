// SPDX-License-Identifier: AGPL-3.0-or-later
#include "pipeline/scene/description_section.h"

#include <fmt/format.h>

#include <algorithm>
#include <cmath>
#include <filesystem>

#include "meshing/core/error.h"
#include "pipeline/cli/nearest_name.h"
#include "pipeline/scene/named_materials.h"
#include "synthesis/solid_material.h"

namespace shellgrid {

using nlohmann::json;

DescriptionSection::DescriptionSection(const std::string& file, const std::string& place, const json& values)
    : file_(file), place_(place), values_(values) {
  if (!values.is_object()) fail("", "expected a section { … }");
}

bool DescriptionSection::has(const std::string& key) {
  known_.push_back(key);
  return values_.contains(key);
}

double DescriptionSection::number(const std::string& key, double otherwise, double least, double most) {
  return has(key) ? check(key, values_.at(key), least, most) : otherwise;
}

int DescriptionSection::integer(const std::string& key, int otherwise, int least, int most) {
  const double value = number(key, otherwise, least, most);
  if (value != std::floor(value)) fail(key, "is not a whole number");
  return static_cast<int>(value);
}

bool DescriptionSection::boolean(const std::string& key, bool otherwise) {
  if (!has(key)) return otherwise;
  if (!values_.at(key).is_boolean()) fail(key, "expected true or false");
  return values_.at(key).get<bool>();
}

Rgb DescriptionSection::color(const std::string& key, const Rgb& otherwise, double least, double most) {
  if (!has(key)) return otherwise;
  const json& value = values_.at(key);
  if (value.is_number()) return Rgb::Constant(static_cast<float>(check(key, value, least, most)));
  if (!value.is_array() || value.size() != 3) fail(key, "expected a number or [r, g, b]");
  Rgb rgb;
  for (int c = 0; c < 3; ++c) rgb[c] = static_cast<float>(check(key, value[c], least, most));
  return rgb;
}

std::string DescriptionSection::text(const std::string& key, const std::string& otherwise) {
  if (!has(key)) return otherwise;
  if (!values_.at(key).is_string()) fail(key, "expected a text");
  return values_.at(key).get<std::string>();
}

std::string DescriptionSection::word(const std::string& key, const std::string& otherwise,
                                     const std::vector<std::string>& choices) {
  const std::string word = text(key, otherwise);
  if (std::find(choices.begin(), choices.end(), word) == choices.end())
    fail(key, fmt::format("'{}' is none of {}{}", word, fmt::join(choices, ", "), did_you_mean(word, choices)));
  return word;
}

std::vector<int> DescriptionSection::integers(const std::string& key, const std::vector<int>& otherwise, int least,
                                              int most, const std::string& form) {
  const std::vector<double> values = numbers(key, otherwise.size(), least, most, form);
  if (values.empty()) return otherwise;
  for (double value : values)
    if (value != std::floor(value)) fail(key, "expected whole numbers");
  return {values.begin(), values.end()};
}

std::vector<double> DescriptionSection::numbers(const std::string& key, std::size_t count, double least, double most,
                                                const std::string& form) {
  std::vector<double> result;
  if (!has(key)) return result;
  const json& values = values_.at(key);
  if (!values.is_array() || values.size() != count) fail(key, "expected " + form);
  for (const json& value : values) result.push_back(check(key, value, least, most));
  return result;
}

std::vector<std::string> DescriptionSection::texts(const std::string& key) {
  std::vector<std::string> result;
  if (!has(key)) return result;
  const json& values = values_.at(key);
  if (!values.is_array()) fail(key, "expected a list of texts");
  for (const json& value : values) {
    if (!value.is_string()) fail(key, "expected a list of texts");
    result.push_back(value.get<std::string>());
  }
  return result;
}

DescriptionSection DescriptionSection::section(const std::string& key) {
  if (!has(key)) fail(key, "is missing");
  DescriptionSection inner(file_, place_of(key), values_.at(key));
  inner.ior_ = ior_;
  return inner;
}

std::vector<DescriptionSection> DescriptionSection::list(const std::string& key) {
  std::vector<DescriptionSection> elements;
  if (!has(key)) return elements;
  if (!values_.at(key).is_array()) fail(key, "expected a list [ … ]");
  for (std::size_t i = 0; i < values_.at(key).size(); ++i) {
    elements.emplace_back(file_, fmt::format("{}[{}]", place_of(key), i), values_.at(key)[i]);
    elements.back().ior_ = ior_;
  }
  return elements;
}

void DescriptionSection::finish() const {
  for (const auto& [key, value] : values_.items()) {
    if (std::find(known_.begin(), known_.end(), key) != known_.end()) continue;
    // A key may have been asked for more than once.
    std::vector<std::string> known;
    for (const std::string& one : known_)
      if (std::find(known.begin(), known.end(), one) == known.end()) known.push_back(one);
    const std::string near = did_you_mean(key, known);
    fail(key, "unknown key" + (near.empty() ? fmt::format("; known here: {}", fmt::join(known, ", ")) : near));
  }
}

void DescriptionSection::fail(const std::string& key, const std::string& what) const {
  const std::string place = key.empty() ? place_ : place_of(key);
  throw InputError(
      fmt::format("{}: {}: {}", file_, one_line(place.empty() ? "the description" : place), one_line(what)));
}

void DescriptionSection::refuse(const std::string& what) const { throw InputError(file_ + ": " + what); }

std::string DescriptionSection::file(const std::string& name) const {
  namespace fs = std::filesystem;
  std::error_code error;
  // A scene's Makefile calls a description whose name is not plain by a link.
  if (fs::is_symlink(file_, error)) {
    const fs::path beside_target = fs::canonical(file_, error).parent_path() / name;
    if (!error && fs::exists(beside_target, error)) return beside_target.string();
  }
  return (fs::path(file_).parent_path() / name).string();
}

double DescriptionSection::check(const std::string& key, const json& value, double least, double most) const {
  if (!value.is_number()) fail(key, "expected a number");
  const double number = value.get<double>();
  if (!(number >= least && number <= most))
    fail(key, fmt::format("{} is out of range; expected {} … {}", value.dump(), least, most));
  return number;
}

Material read_material(DescriptionSection section) {
  Material material;
  if (section.has("named")) {
    try {
      material = named_material(section.text("named", "")).material;
    } catch (const InputError& error) {
      section.fail("named", error.what());
    }
  } else if (section.has("reflectance")) {
    const Rgb reflectance = section.color("reflectance", Rgb::Zero(), 0, 1);
    ColorMaterial matter;
    matter.extinction = section.color("extinction", Rgb::Zero(), 0, 1e4);
    if (!(matter.extinction > 0).all()) section.fail("extinction", "is missing or 0; expected mm⁻¹");
    matter.anisotropy = section.color("anisotropy", Rgb::Zero(), -0.999, 0.999);
    matter.brightest = 1;
    matter.model = section.word("conversion", "transport", {"transport", "dipole"}) == "dipole"
                       ? ReflectanceModel::dipole
                       : ReflectanceModel::transport;
    material = material_of_color(reflectance, matter, ReflectanceInversion(matter.model, section.ior()));
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

}  // namespace shellgrid
