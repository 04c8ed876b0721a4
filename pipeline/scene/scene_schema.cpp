// SPDX-License-Identifier: AGPL-3.0-or-later
#include "pipeline/scene/scene_schema.h"

#include <fmt/format.h>

#include <cmath>

#include "meshing/core/error.h"
#include "pipeline/cli/option_table.h"
#include "pipeline/scene/named_materials.h"

namespace shellgrid {
namespace {

constexpr double infinite = 1e300;

SceneKey section(const std::string& place, const std::string& help) {
  return {place, KeyType::section, "", nullptr, 0, 0, false, {}, help};
}
SceneKey list(const std::string& place, const std::string& help) {
  return {place, KeyType::list, "", nullptr, 0, 0, false, {}, help};
}
SceneKey number(const std::string& place, const std::string& unit, const nlohmann::json& otherwise, double least,
                double most, const std::string& help) {
  return {place, KeyType::number, unit, otherwise, least, most, false, {}, help};
}
SceneKey positive(const std::string& place, const std::string& unit, const nlohmann::json& otherwise, double most,
                  const std::string& help) {
  return {place, KeyType::number, unit, otherwise, 0, most, true, {}, help};
}
SceneKey integer(const std::string& place, const nlohmann::json& otherwise, double least, double most,
                 const std::string& help) {
  return {place, KeyType::integer, "", otherwise, least, most, false, {}, help};
}
SceneKey word(const std::string& place, const nlohmann::json& otherwise, const std::vector<std::string>& choices,
              const std::string& help) {
  return {place, KeyType::word, "", otherwise, 0, 0, false, choices, help};
}
SceneKey file(const std::string& place, const std::string& help) {
  return {place, KeyType::file, "", nullptr, 0, 0, false, {}, help};
}
SceneKey files(const std::string& place, const std::string& help) {
  return {place, KeyType::files, "", nullptr, 0, 0, false, {}, help};
}
SceneKey vector(const std::string& place, const std::string& unit, const nlohmann::json& otherwise,
                const std::string& help) {
  return {place, KeyType::vector, unit, otherwise, -1e9, 1e9, false, {}, help};
}
SceneKey colour(const std::string& place, const std::string& unit, const nlohmann::json& otherwise, double most,
                const std::string& help) {
  return {place, KeyType::colour, unit, otherwise, 0, most, false, {}, help};
}

std::string known_materials() {
  std::string names;
  for (const NamedMaterial& material : named_materials()) names += (names.empty() ? "" : ", ") + material.name;
  return names;
}

std::vector<SceneKey> make_schema() {
  using nlohmann::json;
  const json none = nullptr;
  return {
      section("object", "the object's shape"),
      file("object.mesh", "closed mesh: .ply, .obj, .off or .stl"),
      number("object.size", "mm", 80, 0, 1e6, "longest edge of the bounding box; 0 keeps the file's units as mm"),
      number("object.ior", "", 1.5, 1, 4, "refractive index inside over outside"),
      {"object.close_holes", KeyType::boolean, "", false, 0, 0, false, {}, "close the mesh's holes"},

      section("material", "what the object is made of: shell and core, core alone (homogeneous), or opaque"),
      section("material.shell", "the heterogeneous shell"),
      files("material.shell.sample",
            "description of the material sample (.json) or a base volume (.vdb); a list where several share the "
            "surface as it is painted"),
      file("material.shell.paint",
           "a mesh of the object (.ply) whose vertices say what is wanted there: `sample` (0, 1, … of the list; or "
           "`quality`, or `red`), `scale`, `direction_x direction_y direction_z`"),
      number("material.shell.thickness", "mm", 4, 1e-6, 1e4, "thickness of the shell"),
      number("material.shell.voxel", "mm", 0.4, 1e-6, 1e4, "edge of its voxels, d_0"),
      number("material.shell.scale", "", 1, 0.25, 4,
             "how much larger than it is the sample appears along the surface; times what is painted"),
      word("material.shell.symmetry", "auto", {"auto", "1", "2", "4"},
           "turns after which the sample looks alike, so that it may be laid in any of them: 1 none, 2 half turns, 4 "
           "quarter turns; auto recognises them"),
      word("material.shell.synthesis", "coherence", {"coherence", "textons"},
           "how the sample grows: coherently, coarse to fine, or by the paper's sweep of textons (one sample)"),
      word("material.shell.coordinates", "interpolated", {"interpolated", "nearest"},
           "where in the sample a voxel lies: continued from the triangle above it, or that of the nearest vertex, as "
           "the "
           "paper does"),
      vector("material.shell.direction", "", json::array({0, 1, 0}),
             "the sample's x runs this way where the surface allows"),
      list("material.shell.orient", "where the sample's x must run in a direction of one's own"),
      vector("material.shell.orient[].point", "mm", none, "there, at the nearest point of the surface"),
      vector("material.shell.orient[].direction", "", none, "along the surface; the rest follows smoothly"),
      {"material.core",
       KeyType::core,
       "",
       "bottom-layer",
       0,
       0,
       false,
       {},
       "below the shell, or the whole homogeneous object: `\"bottom-layer\"` (the mean of the sample's bottom layer), "
       "`\"interpolated\"` (the shell's bottom layer continued smoothly: harmonically, without new extremes), "
       "`\"mean-value\"` (the same by mean value coordinates, as voxels of the shell's file), `\"solid\"` (the sample "
       "as a solid, fitted to the shell's bottom, as voxels), a solid of a sample of its own, a named material, or "
       "coefficients; required without a shell"},
      file("material.core.sample",
           "description of the core's own solid (.json) or a volume (.vdb), laid below the shell like `\"solid\"`"),
      {"material.core.named",
       KeyType::name,
       "",
       none,
       0,
       0,
       false,
       {},
       "a measured material [Jensen2001]: " + known_materials()},
      colour("material.core.absorption", "mm⁻¹", none, 1e6, "absorption coefficient"),
      colour("material.core.scattering", "mm⁻¹", none, 1e6, "scattering coefficient"),
      {"material.core.anisotropy",
       KeyType::colour,
       "",
       0,
       -0.999,
       0.999,
       false,
       {},
       "mean cosine of the Henyey–Greenstein phase function"},
      section("material.opaque", "an opaque diffuse surface: no light inside"),
      colour("material.opaque.reflectance", "", 0.5, 1, "diffuse reflectance"),

      list("lights", "what shines; without any the object is black"),
      word("lights[].type", none, {"directional", "point", "area", "environment"}, "kind of light"),
      vector("lights[].direction", "", none,
             "directional: the direction in which the light travels; area: in which the rectangle faces"),
      colour("lights[].irradiance", "W mm⁻²", none, most_light, "directional: irradiance on a plane that faces it"),
      vector("lights[].position", "mm", none, "point: where it stands; area: the rectangle's middle"),
      colour("lights[].intensity", "W sr⁻¹", none, most_light, "point: intensity, the same into all directions"),
      positive("lights[].width", "mm", none, 1e6, "area: of the rectangle, across its upward direction"),
      positive("lights[].height", "mm", none, 1e6, "area: of the rectangle"),
      colour("lights[].radiance", "W mm⁻² sr⁻¹", none, most_light, "area: the same into all directions before it"),
      file("lights[].image", "environment: equirectangular radiance, .exr; without it the sky of the keys below"),
      colour("lights[].scale", "", 1, most_light, "environment: factor on the image or the sky"),
      vector("lights[].up", "", json::array({0, 1, 0}), "environment, area: upward direction"),
      colour("lights[].zenith", "W mm⁻² sr⁻¹", 0, most_light, "environment: the sky's radiance straight up"),
      colour("lights[].horizon", "W mm⁻² sr⁻¹", 0, most_light, "environment: at the horizon"),
      colour("lights[].ground", "W mm⁻² sr⁻¹", 0, most_light, "environment: straight down"),
      list("lights[].lamps", "environment: soft round lamps on the sky"),
      vector("lights[].lamps[].direction", "", none, "towards the lamp"),
      {"lights[].lamps[].half_angle", KeyType::number, "degree", 12, 0, 180, true, {}, "from its centre to its rim"},
      number("lights[].lamps[].softness", "", 0.2, 0, 1, "share of the half angle over which it fades"),
      colour("lights[].lamps[].radiance", "W mm⁻² sr⁻¹", none, most_light, "added to the sky's radiance"),

      section("camera", "from where it is seen; the object's bounding box is centred on the origin"),
      vector("camera.position", "mm", json::array({0, 0, 200}), "where the camera stands"),
      vector("camera.look_at", "mm", json::array({0, 0, 0}), "the point in the middle of the picture"),
      vector("camera.up", "", json::array({0, 1, 0}), "upward direction in the picture"),
      number("camera.fov", "degree", 30, 0.1, 170, "vertical field of view"),
      {"camera.resolution",
       KeyType::resolution,
       "pixel",
       json::array({720, 486}),
       1,
       16384,
       false,
       {},
       "width and height of the picture"},

      number("camera.exposure", "stop", none, -100, 100,
             "of the PNG: radiance is shown times 2^exposure; automatic where missing"),
      colour("camera.background", "W mm⁻² sr⁻¹", none, most_light,
             "what is seen behind everything; the environment where missing"),

      section("floor", "a table under the object's lowest point, which shows shadows and reflections"),
      colour("floor.reflectance", "", 0.5, 1, "diffuse reflectance"),
      number("floor.ior", "", 1, 1, 4, "refractive index of a polished coat; 1: matt"),
      positive("floor.radius", "", 2.5, 1e3, "where it has faded into the background, in sizes of the object"),

      section("method", "how light inside the object is computed, and how finely"),
      word("method.type", "polygrid-diffusion", {"polygrid-diffusion", "shell-texture-function", "path-tracing"},
           "diffusion on a polygrid; the sample's precomputed light in the shell over a dipole core; or light paths "
           "(sg-reference): exact, slow and noisy"),
      number("method.nodes", "", 1e5, 1e3, 2e7, "nodes of the polygrid"),
      {"method.tolerance", KeyType::number, "", 0.005, 1e-12, 0.5, false, {}, "relative error of the exitance"},
      word("method.operator", "elements", {"elements", "paper"},
           "discretisation: trilinear elements, or the paper's six-neighbour weights"),
      word("method.source", "boundary", {"boundary", "first-collision"},
           "where light becomes diffuse: at the surface, or where refracted beams first meet matter"),
      number("method.paths", "", 1e7, 1, 1e15,
             "light paths, of path-tracing and of reference.ply, which Make makes on demand"),
      {"method.irradiance_error",
       KeyType::number,
       "",
       0.05,
       1e-3,
       0.5,
       false,
       {},
       "shell-texture-function: relative error of half of the sample's light"},
      word(
          "method.core", "dipole", {"dipole", "paper", "polygrid", "none"},
          "shell-texture-function: the core's light, by a dipole that gets back what it gives and follows light to and "
          "fro between shell and core, or as the paper has it; by diffusion on a polygrid of the whole object, which "
          "needs no flat core; or a black core"),
      integer("method.samples_per_pixel", 16, 1, 65536, "camera rays a pixel"),
  };
}

}  // namespace

const std::vector<SceneKey>& scene_schema() {
  static const std::vector<SceneKey> schema = make_schema();
  return schema;
}

const SceneKey& scene_key(const std::string& place) {
  for (const SceneKey& key : scene_schema())
    if (key.place == place) return key;
  throw InternalError("no scene key " + place);
}

std::vector<std::string> scene_keys_below(const std::string& place) {
  const std::string prefix = place.empty() ? "" : place + ".";
  std::vector<std::string> names;
  for (const SceneKey& key : scene_schema()) {
    if (!key.place.starts_with(prefix)) continue;
    const std::string rest = key.place.substr(prefix.size());
    if (rest.find('.') == std::string::npos) names.push_back(rest);
  }
  return names;
}

std::string key_type_text(const SceneKey& key) {
  switch (key.type) {
    case KeyType::section:
      return "section";
    case KeyType::list:
      return "list";
    case KeyType::number:
      return "number";
    case KeyType::integer:
      return "integer";
    case KeyType::boolean:
      return "true or false";
    case KeyType::word:
      return "text";
    case KeyType::name:
      return "text";
    case KeyType::file:
      return "path";
    case KeyType::files:
      return "path or list of paths";
    case KeyType::vector:
      return "[x, y, z]";
    case KeyType::colour:
      return "[r, g, b] or number";
    case KeyType::resolution:
      return "[width, height]";
    case KeyType::core:
      return "text or section";
  }
  throw InternalError("a scene key without a type");
}

std::string key_range_text(const SceneKey& key) {
  if (!key.choices.empty()) return fmt::format("{}", fmt::join(key.choices, ", "));
  const bool numeric = key.type == KeyType::number || key.type == KeyType::integer || key.type == KeyType::colour ||
                       key.type == KeyType::vector || key.type == KeyType::resolution;
  if (!numeric || key.least <= -1e9) return "";
  const bool open = key.most >= infinite;
  if (key.above_least) return "> " + number_text(key.least) + (open ? "" : ", ≤ " + number_text(key.most));
  return open ? "≥ " + number_text(key.least) : number_text(key.least) + " … " + number_text(key.most);
}

std::string scene_schema_markdown() {
  std::string table = "| key | value | unit | default | range | meaning |\n|---|---|---|---|---|---|\n";
  for (const SceneKey& key : scene_schema()) {
    const std::string otherwise = key.otherwise.is_null()     ? ""
                                  : key.otherwise.is_number() ? number_text(key.otherwise.get<double>())
                                                              : key.otherwise.dump();
    table += fmt::format("| `{}` | {} | {} | {} | {} | {} |\n", key.place, key_type_text(key), key.unit,
                         otherwise.empty() ? "" : "`" + otherwise + "`", key_range_text(key), key.help);
  }
  return table;
}

}  // namespace shellgrid
