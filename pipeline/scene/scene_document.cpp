// SPDX-License-Identifier: AGPL-3.0-or-later
#include "pipeline/scene/scene_document.h"

#include <fmt/format.h>
#include <sys/stat.h>

#include <cerrno>
#include <cmath>
#include <cstring>
#include <filesystem>

#include "meshing/core/error.h"
#include "pipeline/cli/nearest_name.h"
#include "pipeline/cli/option_table.h"
#include "pipeline/scene/named_materials.h"
#include "pipeline/scene/scene_schema.h"
#include "pipeline/scene/strict_json.h"

namespace shellgrid {
namespace {

using nlohmann::json;

std::string kind_of(const json& value) {
  if (value.is_null()) return "null";
  if (value.is_boolean()) return value.get<bool>() ? "true" : "false";
  if (value.is_number()) return number_text(value.get<double>());
  if (value.is_string()) return "'" + value.get<std::string>() + "'";
  return value.is_array() ? fmt::format("a list of {}", value.size()) : "a section";
}

class Checker {
 public:
  Checker(const std::string& path) : path_(path), folder_(std::filesystem::path(path).parent_path()) {}

  // `place` as a person writes it (lights[0].type), `key` as the schema does (lights[].type).
  void section(json& value, const std::string& place, const std::string& key) const {
    if (!value.is_object()) fail(place, "is " + kind_of(value) + "; expected a section { … }");
    const std::vector<std::string> known = scene_keys_below(key);
    for (auto& [name, child] : value.items()) {
      const std::string child_place = place.empty() ? name : place + "." + name;
      if (std::find(known.begin(), known.end(), name) == known.end()) {
        const std::string near = did_you_mean(name, known);
        fail(child_place,
             "unknown key" + (near.empty() ? fmt::format("; known here: {}", fmt::join(known, ", ")) : near));
      }
      check(child, child_place, scene_key(key.empty() ? name : key + "." + name));
    }
  }

  [[noreturn]] void fail(const std::string& place, const std::string& what) const {
    throw InputError(path_ + ": " + one_line((place.empty() ? "the scene" : place) + ": " + what));
  }

 private:
  void check(json& value, const std::string& place, const SceneKey& key) const {
    switch (key.type) {
      case KeyType::section:
        return section(value, place, key.place);
      case KeyType::list:
        return list(value, place, key);
      case KeyType::number:
      case KeyType::integer:
        return number(value, place, key);
      case KeyType::boolean:
        if (!value.is_boolean()) wrong(value, place, key);
        return;
      case KeyType::word:
        return word(value, place, key);
      case KeyType::name:
        return text(value, place, key);
      case KeyType::file:
        return file(value, place, key);
      case KeyType::files:
        return files(value, place, key);
      case KeyType::vector:
        return numbers(value, place, key, 3);
      case KeyType::resolution:
        return resolution(value, place, key);
      case KeyType::colour:
        if (value.is_number()) return number(value, place, key);
        return numbers(value, place, key, 3);
      case KeyType::core:
        if (value.is_object()) return section(value, place, key.place);
        if (!value.is_string() ||
            (value != "bottom-layer" && value != "interpolated" && value != "mean-value" && value != "solid"))
          fail(place, "is " + kind_of(value) +
                          "; expected \"bottom-layer\", \"interpolated\", \"mean-value\", \"solid\", {\"named\": …}, "
                          "{\"sample\": …} or {\"absorption\": …, \"scattering\": …}");
        return;
    }
  }

  [[noreturn]] void wrong(const json& value, const std::string& place, const SceneKey& key) const {
    fail(place, "is " + kind_of(value) + "; expected " + key_type_text(key));
  }

  void list(json& value, const std::string& place, const SceneKey& key) const {
    if (!value.is_array()) wrong(value, place, key);
    for (std::size_t i = 0; i < value.size(); ++i) section(value[i], fmt::format("{}[{}]", place, i), key.place + "[]");
  }

  void number(const json& value, const std::string& place, const SceneKey& key) const {
    if (!value.is_number()) wrong(value, place, key);
    const double x = value.get<double>();
    if (!std::isfinite(x) || x < key.least || x > key.most || (key.above_least && x == key.least))
      fail(place, fmt::format("{} is out of range; expected {}", kind_of(value),
                              key_range_text(key).empty() ? "a moderate number" : key_range_text(key)));
    if (key.type == KeyType::integer && x != std::floor(x)) fail(place, kind_of(value) + " is not a whole number");
  }

  void numbers(const json& value, const std::string& place, const SceneKey& key, std::size_t count) const {
    if (!value.is_array() || value.size() != count) wrong(value, place, key);
    for (std::size_t i = 0; i < count; ++i) number(value[i], fmt::format("{}[{}]", place, i), key);
  }

  void resolution(const json& value, const std::string& place, const SceneKey& key) const {
    numbers(value, place, key, 2);
    for (const json& pixels : value)
      if (pixels.get<double>() != std::floor(pixels.get<double>())) fail(place, "is not in whole pixels");
  }

  void text(const json& value, const std::string& place, const SceneKey& key) const {
    if (!value.is_string()) wrong(value, place, key);
    const std::string word = value.get<std::string>();
    if (word.empty()) fail(place, "must not be empty");
    if (word.find('\0') != std::string::npos) fail(place, "holds a zero byte");
  }

  // Choices that are numbers may stand without quotes.
  void word(json& value, const std::string& place, const SceneKey& key) const {
    if (value.is_number() &&
        std::find(key.choices.begin(), key.choices.end(), number_text(value.get<double>())) != key.choices.end())
      value = number_text(value.get<double>());
    text(value, place, key);
    const std::string word = value.get<std::string>();
    if (std::find(key.choices.begin(), key.choices.end(), word) == key.choices.end())
      fail(place,
           fmt::format("'{}' is none of {}{}", word, fmt::join(key.choices, ", "), did_you_mean(word, key.choices)));
  }

  void file(json& value, const std::string& place, const SceneKey& key) const {
    text(value, place, key);
    const std::string resolved = (folder_ / value.get<std::string>()).string();
    struct stat status {};
    if (::stat(resolved.c_str(), &status) != 0) fail(place, resolved + ": " + std::strerror(errno));
    if (!S_ISREG(status.st_mode)) fail(place, resolved + ": is not a file");
    value = resolved;
  }

  void files(json& value, const std::string& place, const SceneKey& key) const {
    constexpr std::size_t most = 64;
    if (!value.is_array()) {
      if (!value.is_string()) wrong(value, place, key);
      return file(value, place, key);
    }
    if (value.empty() || value.size() > most)
      fail(place, fmt::format("is a list of {}; expected 1 to {} paths", value.size(), most));
    for (std::size_t i = 0; i < value.size(); ++i) {
      const std::string one = fmt::format("{}[{}]", place, i);
      if (!value[i].is_string()) fail(one, "is " + kind_of(value[i]) + "; expected path");
      file(value[i], one, key);
    }
  }

  const std::string path_;
  const std::filesystem::path folder_;
};

}  // namespace

SceneDocument read_scene_document(const std::string& path) {
  SceneDocument document{path, read_strict_json(path)};
  Checker(path).section(document.root, "", "");
  return document;
}

}  // namespace shellgrid
