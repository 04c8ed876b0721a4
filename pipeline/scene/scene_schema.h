// SPDX-License-Identifier: AGPL-3.0-or-later
// The keys of a scene file: one table for the checks and for the documentation.
#pragma once
#include <string>
#include <vector>

#include <nlohmann/json.hpp>

namespace shellgrid {

enum class KeyType {
  section,     // an object of keys of its own
  list,        // an array of sections
  number,      // one number
  integer,     // one whole number
  boolean,     // true or false
  word,        // one of `choices`
  name,        // any text
  file,        // a path, relative to the scene file; must exist
  files,       // one of these or a list of them
  vector,      // [x, y, z]
  colour,      // [r, g, b] or one number for all three
  resolution,  // [width, height]
  core,        // material.core: "bottom-layer", "interpolated", "mean-value", "solid" or a section
};

// Greatest radiance, irradiance or intensity of a light: sums over many of them stay far from the end of single
// precision. (The sun: about 20 W mm⁻² sr⁻¹.)
constexpr double most_light = 1e12;

struct SceneKey {
  std::string place;  // "object.size"; elements of lists as "lights[].type"
  KeyType type;
  std::string unit;
  nlohmann::json otherwise;  // the value where the key is missing; null: none
  double least, most;        // inclusive, for numbers and components
  bool above_least;          // `least` itself is excluded
  std::vector<std::string> choices;
  std::string help;
};

const std::vector<SceneKey>& scene_schema();

// The key at a place. Throws: InternalError where there is none.
const SceneKey& scene_key(const std::string& place);

// Names of the keys right below a place ("" for the top).
std::vector<std::string> scene_keys_below(const std::string& place);

// "number", "[r, g, b] or number", …
std::string key_type_text(const SceneKey& key);
// "> 0", "0 … 1", the choices, or empty.
std::string key_range_text(const SceneKey& key);

// The scene keys with types, units, ranges and defaults, as a Markdown table.
std::string scene_schema_markdown();

}  // namespace shellgrid
