// SPDX-License-Identifier: AGPL-3.0-or-later
#include "pipeline/scene/scene.h"

#include <fmt/format.h>

#include <Eigen/Geometry>

#include <cmath>
#include <memory>
#include <numbers>

#include "meshing/core/error.h"
#include "meshing/formats/image_file.h"
#include "pipeline/cli/option_table.h"
#include "pipeline/scene/named_materials.h"
#include "pipeline/scene/scene_document.h"
#include "pipeline/scene/scene_schema.h"

namespace shellgrid {
namespace {

using nlohmann::json;

// A section of a checked scene; what it lacks comes from the schema's defaults.
class Section {
 public:
  Section(const std::string& file, const json& values, const std::string& place, const std::string& key)
      : file_(file), values_(values), place_(place), key_(key) {}

  bool has(const std::string& name) const { return values_.contains(name); }
  Section section(const std::string& name) const {
    return {file_, values_.at(name), place_ + "." + name, key_ + "." + name};
  }
  Section element(const std::string& name, std::size_t i) const {
    return {file_, values_.at(name)[i], fmt::format("{}.{}[{}]", place_, name, i), key_ + "." + name + "[]"};
  }
  std::size_t count(const std::string& name) const { return has(name) ? values_.at(name).size() : 0; }

  double number(const std::string& name) const { return value(name).get<double>(); }
  int integer(const std::string& name) const { return static_cast<int>(value(name).get<double>()); }
  bool boolean(const std::string& name) const { return value(name).get<bool>(); }
  std::string text(const std::string& name) const { return value(name).get<std::string>(); }
  std::string text_or_empty(const std::string& name) const { return has(name) ? text(name) : ""; }
  Vec3 vector(const std::string& name) const {
    const json& xyz = value(name);
    return {xyz[0].get<double>(), xyz[1].get<double>(), xyz[2].get<double>()};
  }
  Vec3 direction(const std::string& name) const {
    const Vec3 given = vector(name);
    if (!(given.norm() > 1e-12)) fail(name, "is the zero vector");
    return given.normalized();
  }
  Rgb colour(const std::string& name) const {
    const json& rgb = value(name);
    if (rgb.is_number()) return Rgb::Constant(rgb.get<float>());
    return {rgb[0].get<float>(), rgb[1].get<float>(), rgb[2].get<float>()};
  }
  const json& value(const std::string& name) const {
    if (has(name)) return values_.at(name);
    const SceneKey& known = scene_key(key_ + "." + name);
    if (known.otherwise.is_null()) fail(name, "is missing; expected " + key_type_text(known));
    return known.otherwise;
  }
  // Refuses keys that belong to another kind of this section.
  void allow(const std::vector<std::string>& names, const std::string& kind) const {
    for (const auto& [name, ignored] : values_.items())
      if (std::find(names.begin(), names.end(), name) == names.end())
        fail(name, fmt::format("has no place here: {} takes {}", kind, fmt::join(names, ", ")));
  }
  [[noreturn]] void fail(const std::string& name, const std::string& what) const {
    throw InputError(file_ + ": " + place_ + (name.empty() ? "" : "." + name) + ": " + what);
  }

 private:
  const std::string& file_;
  const json& values_;
  std::string place_, key_;
};

SceneObject parse_object(const Section& section) {
  SceneObject object;
  object.mesh = section.text_or_empty("mesh");
  object.size = section.number("size");
  object.ior = section.number("ior");
  object.close_holes = section.boolean("close_holes");
  return object;
}

std::variant<BottomLayerCore, ContinuedCore, Material> parse_core(const Section& core, bool has_shell) {
  if (core.has("sample")) {
    core.allow({"sample"}, "a core of a sample's solid");
    if (!has_shell) core.fail("sample", "a solid core lies below a shell; give material.shell");
    return ContinuedCore{"solid", core.text("sample")};
  }
  if (core.has("named")) {
    core.allow({"named"}, "a named material");
    try {
      return named_material(core.text("named")).material;
    } catch (const InputError& error) {
      core.fail("named", error.what());
    }
  }
  const Rgb absorption = core.colour("absorption"), scattering = core.colour("scattering");
  return Material::from_absorption_scattering(absorption, scattering, core.colour("anisotropy"));
}

ShellMaterial parse_shell(const Section& section) {
  ShellMaterial shell;
  if (section.has("sample")) {
    const json& sample = section.value("sample");
    if (sample.is_string())
      shell.samples = {sample.get<std::string>()};
    else
      shell.samples = sample.get<std::vector<std::string>>();
  }
  shell.paint = section.text_or_empty("paint");
  shell.thickness = section.number("thickness");
  shell.voxel = section.number("voxel");
  shell.scale = section.number("scale");
  shell.symmetry = section.text("symmetry");
  shell.synthesis = section.text("synthesis");
  shell.coordinates = section.text("coordinates");
  shell.direction = section.direction("direction");
  for (std::size_t i = 0; i < section.count("orient"); ++i) {
    const Section wanted = section.element("orient", i);
    shell.orient.push_back({wanted.vector("point"), wanted.direction("direction")});
  }
  if (shell.voxel > shell.thickness) section.fail("voxel", "is larger than the shell's thickness");
  if (shell.samples.size() > 1) {
    if (shell.paint.empty())
      section.fail("paint", fmt::format("is missing: it says where each of the {} samples goes", shell.samples.size()));
    if (shell.synthesis == "textons") section.fail("synthesis", "textons: takes one sample, not several");
  }
  if (shell.synthesis == "textons" && shell.symmetry != "auto" && shell.symmetry != "1")
    section.fail("symmetry", shell.symmetry + ": the synthesis by textons lays the sample as it is");
  return shell;
}

SceneMaterial parse_material(const Section& section) {
  SceneMaterial material;
  if (section.has("opaque")) {
    section.allow({"opaque"}, "an opaque material");
    material.opaque = OpaqueMaterial{section.section("opaque").colour("reflectance")};
    return material;
  }
  if (section.has("shell")) {
    material.shell = parse_shell(section.section("shell"));
  } else if (!section.has("core") || !section.value("core").is_object()) {
    section.fail(section.has("core") ? "core" : "", "expected shell, opaque, or a core with coefficients");
  }
  if (section.has("core") && section.value("core").is_object())
    material.core = parse_core(section.section("core"), material.shell.has_value());
  else if (section.has("core") && section.text("core") != "bottom-layer")
    material.core = ContinuedCore{section.text("core")};
  if (const auto* core = std::get_if<ContinuedCore>(&material.core);
      core && core->kind == "solid" && core->sample.empty() && material.shell && material.shell->samples.size() > 1)
    section.fail("core", "\"solid\": of several samples none is the core's; name one, {\"sample\": …}");
  return material;
}

// R, G and B of an equirectangular picture; a grey one's Y stands for all three.
Image environment_picture(const std::string& path, const Rgb& scale) {
  Image file = read_exr(path);
  if (!file.find("R") && !file.find("G") && !file.find("B") && file.find("Y"))
    for (const char* name : {"R", "G", "B"}) file.channels.push_back({name, file.find("Y")->values});
  Image picture;
  picture.width = file.width;
  picture.height = file.height;
  for (int k = 0; k < 3; ++k) {
    const std::string name(1, "RGB"[k]);
    const Image::Channel* channel = file.find(name);
    if (!channel) throw InputError(fmt::format("{}: has no channel {}; expected R, G and B, or Y", path, name));
    std::size_t bad = 0, first = 0;
    for (std::size_t i = channel->values.size(); i-- > 0;) {
      const double radiance = channel->values[i];
      if (radiance >= 0 && radiance * scale[k] <= most_light) continue;
      ++bad;
      first = i;
    }
    if (bad > 0)
      throw InputError(
          fmt::format("{}: {} in channel {} {} not between 0 and {}, the first, {:g}, at ({}, {}) from the "
                      "upper left corner",
                      path, bad == 1 ? "1 pixel" : fmt::format("{} pixels", bad), name, bad == 1 ? "is" : "are",
                      number_text(most_light), channel->values[first], first % file.width, first / file.width));
    picture.channels.push_back(*channel);
  }
  return picture;
}

EnvironmentLight parse_environment(const Section& section) {
  EnvironmentLight light;
  light.up = section.direction("up");
  light.scale = section.colour("scale");
  if (section.has("image")) {
    section.allow({"type", "image", "scale", "up"}, "an environment with an image");
    try {
      light.image = std::make_shared<const Image>(environment_picture(section.text("image"), light.scale));
    } catch (const InputError& error) {
      section.fail("image", error.what());
    }
    return light;
  }
  section.allow({"type", "scale", "up", "zenith", "horizon", "ground", "lamps"}, "an environment without an image");
  light.zenith = section.colour("zenith");
  light.horizon = section.colour("horizon");
  light.ground = section.colour("ground");
  for (std::size_t i = 0; i < section.count("lamps"); ++i) {
    const Section lamp = section.element("lamps", i);
    light.lamps.push_back({lamp.direction("direction"), lamp.number("half_angle") * std::numbers::pi / 180,
                           lamp.number("softness"), lamp.colour("radiance")});
  }
  return light;
}

Light parse_light(const Section& section) {
  const std::string type = section.text("type");
  if (type == "directional") {
    section.allow({"type", "direction", "irradiance"}, "a directional light");
    return DirectionalLight{section.direction("direction"), section.colour("irradiance")};
  }
  if (type == "point") {
    section.allow({"type", "position", "intensity"}, "a point light");
    return PointLight{section.vector("position"), section.colour("intensity")};
  }
  if (type == "area") {
    section.allow({"type", "position", "direction", "up", "width", "height", "radiance"}, "an area light");
    return AreaLight{section.vector("position"), section.direction("direction"), section.direction("up"),
                     section.number("width"),    section.number("height"),       section.colour("radiance")};
  }
  return parse_environment(section);
}

Camera parse_camera(const Section& section) {
  Camera camera;
  camera.position = section.vector("position");
  camera.look_at = section.vector("look_at");
  camera.up = section.direction("up");
  camera.fov = section.number("fov");
  camera.width = static_cast<int>(section.value("resolution")[0].get<double>());
  camera.height = static_cast<int>(section.value("resolution")[1].get<double>());
  const Vec3 view = camera.look_at - camera.position;
  if (!(view.norm() > 1e-9)) section.fail("position", "equals look_at: the camera has no direction");
  if (!(view.normalized().cross(camera.up).norm() > 1e-6)) section.fail("up", "is parallel to the line of sight");
  return camera;
}

SceneMethod parse_method(const Section& section) {
  SceneMethod method;
  method.type = section.text("type");
  method.nodes = section.number("nodes");
  method.paths = section.number("paths");
  method.tolerance = section.number("tolerance");
  method.operator_name = section.text("operator");
  method.source = section.text("source");
  method.irradiance_error = section.number("irradiance_error");
  method.core = section.text("core");
  method.samples_per_pixel = section.integer("samples_per_pixel");
  return method;
}

}  // namespace

Scene read_scene(const std::string& path) {
  const SceneDocument document = read_scene_document(path);
  const json& root = document.root;
  Scene scene;
  scene.path = path;
  const auto section = [&](const char* name) { return Section(document.path, root.at(name), name, name); };
  if (root.contains("object")) scene.object = parse_object(section("object"));
  if (root.contains("material")) scene.material = parse_material(section("material"));
  if (root.contains("lights"))
    for (std::size_t i = 0; i < root["lights"].size(); ++i)
      scene.lights.push_back(
          parse_light(Section(document.path, root["lights"][i], fmt::format("lights[{}]", i), "lights[]")));
  if (root.contains("camera")) {
    const Section camera = section("camera");
    scene.camera = parse_camera(camera);
    if (camera.has("exposure")) scene.exposure = camera.number("exposure");
    if (camera.has("background")) scene.background = camera.colour("background");
  }
  if (root.contains("floor")) {
    const Section floor = section("floor");
    scene.floor = Floor{floor.colour("reflectance"), floor.number("ior"), floor.number("radius")};
  }
  if (root.contains("method")) scene.method = parse_method(section("method"));
  return scene;
}

}  // namespace shellgrid
