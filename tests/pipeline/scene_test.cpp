// SPDX-License-Identifier: AGPL-3.0-or-later
#include "pipeline/scene/scene.h"

#include <gtest/gtest.h>
#include <unistd.h>

#include <cmath>
#include <filesystem>
#include <fstream>

#include "meshing/core/error.h"
#include "meshing/formats/image_file.h"
#include "pipeline/cli/nearest_name.h"
#include "pipeline/cli/option_table.h"
#include "pipeline/scene/named_materials.h"
#include "pipeline/scene/scene_schema.h"

namespace shellgrid {
namespace {

namespace fs = std::filesystem;

class SceneFile : public testing::Test {
 protected:
  void SetUp() override {
    folder_ = fs::temp_directory_path() / ("shellgrid_scene_test_" + std::to_string(getpid()));
    fs::create_directories(folder_);
    std::ofstream(folder_ / "m.off") << "OFF\n";
    std::ofstream(folder_ / "s.json") << "{}\n";
  }
  void TearDown() override { fs::remove_all(folder_); }

  Scene read(const std::string& text) const {
    const std::string path = (folder_ / "scene.json").string();
    std::ofstream(path) << text;
    return read_scene(path);
  }
  // What read_scene says about a bad scene; empty where it accepts it.
  std::string complaint(const std::string& text) const {
    try {
      read(text);
      return "";
    } catch (const InputError& error) {
      return error.what();
    }
  }
  fs::path folder_;
};

#define EXPECT_SAYS(complaint, part) EXPECT_NE((complaint).find(part), std::string::npos) << (complaint)

TEST_F(SceneFile, GivesWhatIsInIt) {
  const Scene scene = read(R"({ // a comment
    "object": {"mesh": "m.off", "size": 60, "ior": 1.3, "close_holes": true},
    "material": {"shell": {"sample": "s.json", "thickness": 3, "voxel": 0.5,
      "orient": [{"point": [1, 2, 3], "direction": [0, 0, 2]}]}, "core": "bottom-layer"},
    "lights": [{"type": "directional", "direction": [0, 0, -2], "irradiance": [1, 2, 3]},
               {"type": "point", "position": [1, 2, 3], "intensity": 4},
               {"type": "environment", "zenith": 1, "lamps": [{"direction": [0, 3, 0], "half_angle": 90, "radiance": 2}]},
               {"type": "area", "position": [0, 90, 0], "direction": [0, -4, 0], "up": [0, 0, 2], "width": 3, "height": 5,
                "radiance": 7}],
    /* another */
    "camera": {"position": [0, 0, 100], "look_at": [0, 1, 0], "up": [0, 2, 0], "fov": 20, "resolution": [32, 16]},
    "method": {"type": "polygrid-diffusion", "nodes": 2e4, "tolerance": 0.01, "operator": "paper",
               "source": "first-collision", "samples_per_pixel": 4} })");
  EXPECT_EQ(scene.object->mesh, (folder_ / "m.off").string());
  EXPECT_EQ(scene.object->size, 60);
  EXPECT_EQ(scene.object->ior, 1.3);
  EXPECT_TRUE(scene.object->close_holes);
  EXPECT_EQ(scene.material->shell->samples, std::vector<std::string>{(folder_ / "s.json").string()});
  EXPECT_EQ(scene.material->shell->thickness, 3);
  EXPECT_EQ(scene.material->shell->voxel, 0.5);
  ASSERT_EQ(scene.material->shell->orient.size(), 1u);
  EXPECT_EQ(scene.material->shell->orient[0].point, Vec3(1, 2, 3));
  EXPECT_EQ(scene.material->shell->orient[0].direction, Vec3(0, 0, 1));
  EXPECT_TRUE(std::holds_alternative<BottomLayerCore>(scene.material->core));
  ASSERT_EQ(scene.lights.size(), 4u);
  const auto& area = std::get<AreaLight>(scene.lights[3]);
  EXPECT_EQ(area.direction, Vec3(0, -1, 0));
  EXPECT_EQ(area.up, Vec3(0, 0, 1));
  EXPECT_EQ(area.height, 5);
  EXPECT_EQ(area.radiance[2], 7);
  const auto& directional = std::get<DirectionalLight>(scene.lights[0]);
  EXPECT_NEAR((directional.direction - Vec3(0, 0, -1)).norm(), 0, 1e-15);
  EXPECT_EQ(directional.irradiance[2], 3);
  EXPECT_EQ(std::get<PointLight>(scene.lights[1]).intensity[1], 4);
  const auto& sky = std::get<EnvironmentLight>(scene.lights[2]);
  ASSERT_EQ(sky.lamps.size(), 1u);
  EXPECT_NEAR(sky.lamps[0].half_angle, std::acos(0.0), 1e-12);
  EXPECT_EQ(sky.lamps[0].direction, Vec3(0, 1, 0));
  EXPECT_EQ(scene.camera->width, 32);
  EXPECT_EQ(scene.camera->height, 16);
  EXPECT_EQ(scene.camera->up, Vec3(0, 1, 0));
  EXPECT_EQ(scene.method.nodes, 2e4);
  EXPECT_EQ(scene.method.operator_name, "paper");
  EXPECT_EQ(scene.method.source, "first-collision");
  EXPECT_EQ(scene.method.samples_per_pixel, 4);
}

TEST_F(SceneFile, GivesSeveralSamplesTheirPaintAndACoreOfItsOwn) {
  std::ofstream(folder_ / "p.ply") << "ply\n";
  std::ofstream(folder_ / "t.vdb") << "vdb\n";
  const Scene scene = read(R"({"material": {"shell": {"sample": ["s.json", "t.vdb"], "paint": "p.ply", "scale": 0.5,
    "symmetry": 2, "direction": [3, 0, 0]}, "core": {"sample": "t.vdb"}}})");
  const ShellMaterial& shell = *scene.material->shell;
  EXPECT_EQ(shell.samples, (std::vector<std::string>{(folder_ / "s.json").string(), (folder_ / "t.vdb").string()}));
  EXPECT_EQ(shell.paint, (folder_ / "p.ply").string());
  EXPECT_EQ(shell.scale, 0.5);
  EXPECT_EQ(shell.symmetry, "2");
  EXPECT_EQ(shell.direction, Vec3(1, 0, 0));
  const auto& core = std::get<ContinuedCore>(scene.material->core);
  EXPECT_EQ(core.kind, "solid");
  EXPECT_EQ(core.sample, (folder_ / "t.vdb").string());
  EXPECT_EQ(read(R"({"material": {"shell": {"symmetry": "4"}}})").material->shell->symmetry, "4");
  EXPECT_EQ(read(R"({"material": {"shell": {"synthesis": "textons"}}})").material->shell->synthesis, "textons");
}

TEST_F(SceneFile, RefusesSamplesPaintAndCoresThatContradict) {
  const std::string two = R"({"material": {"shell": {"sample": ["s.json", "s.json"])";
  EXPECT_SAYS(complaint(two + "}}}"), "material.shell.paint: is missing: it says where each of the 2 samples goes");
  EXPECT_SAYS(complaint(two + R"(, "paint": "s.json", "synthesis": "textons"}}})"),
              "material.shell.synthesis: textons");
  EXPECT_SAYS(complaint(two + R"(, "paint": "s.json"}, "core": "solid"}})"), "material.core: \"solid\"");
  EXPECT_EQ(complaint(two + R"(, "paint": "s.json"}, "core": {"sample": "s.json"}}})"), "");
  EXPECT_SAYS(complaint(R"({"material": {"shell": {"synthesis": "textons", "symmetry": 4}}})"),
              "material.shell.symmetry: 4");
  EXPECT_SAYS(complaint(R"({"material": {"shell": {"symmetry": 3}}})"), "material.shell.symmetry: is 3; expected text");
  EXPECT_SAYS(complaint(R"({"material": {"shell": {"symmetry": "3"}}})"), "none of auto, 1, 2, 4");
  EXPECT_SAYS(complaint(R"({"material": {"shell": {"scale": 5}}})"), "material.shell.scale: 5 is out of range");
  EXPECT_SAYS(complaint(R"({"material": {"shell": {"direction": [0, 0, 0]}}})"),
              "material.shell.direction: is the zero");
  EXPECT_SAYS(complaint(R"({"material": {"shell": {"sample": []}}})"), "material.shell.sample: is a list of 0");
  EXPECT_SAYS(complaint(R"({"material": {"shell": {"sample": ["s.json", 3]}}})"), "material.shell.sample[1]: is 3");
  EXPECT_SAYS(complaint(R"({"material": {"shell": {"sample": ["s.json", "gone.vdb"]}}})"),
              "material.shell.sample[1]: " + (folder_ / "gone.vdb").string());
  EXPECT_SAYS(complaint(R"({"material": {"shell": {"sample": {}}}})"), "expected path or list of paths");
  EXPECT_SAYS(complaint(R"({"material": {"shell": {"paint": "gone.ply"}}})"), "material.shell.paint: ");
  EXPECT_SAYS(complaint(R"({"material": {"core": {"sample": "s.json"}}})"),
              "material.core.sample: a solid core lies below");
  EXPECT_SAYS(complaint(R"({"material": {"shell": {}, "core": {"sample": "s.json", "absorption": 1}}})"),
              "material.core.absorption: has no place here");
}

TEST_F(SceneFile, TakesTheDefaultsThatTheTableOfKeysStates) {
  const Scene scene = read(R"({"object": {}, "material": {"shell": {}}, "camera": {}, "method": {}})");
  const SceneObject object;
  EXPECT_EQ(scene.object->size, object.size);
  EXPECT_EQ(scene.object->ior, object.ior);
  EXPECT_EQ(scene.object->close_holes, object.close_holes);
  EXPECT_EQ(scene.material->shell->thickness, ShellMaterial().thickness);
  EXPECT_EQ(scene.material->shell->voxel, ShellMaterial().voxel);
  EXPECT_EQ(scene.material->shell->scale, ShellMaterial().scale);
  EXPECT_EQ(scene.material->shell->symmetry, ShellMaterial().symmetry);
  EXPECT_EQ(scene.material->shell->synthesis, ShellMaterial().synthesis);
  EXPECT_EQ(scene.material->shell->coordinates, ShellMaterial().coordinates);
  EXPECT_EQ(scene.material->shell->direction, ShellMaterial().direction);
  const Camera camera;
  EXPECT_EQ(scene.camera->position, camera.position);
  EXPECT_EQ(scene.camera->look_at, camera.look_at);
  EXPECT_EQ(scene.camera->up, camera.up);
  EXPECT_EQ(scene.camera->fov, camera.fov);
  EXPECT_EQ(scene.camera->width, camera.width);
  EXPECT_EQ(scene.camera->height, camera.height);
  const SceneMethod method;
  EXPECT_EQ(scene.method.type, method.type);
  EXPECT_EQ(scene.method.nodes, method.nodes);
  EXPECT_EQ(scene.method.tolerance, method.tolerance);
  EXPECT_EQ(scene.method.operator_name, method.operator_name);
  EXPECT_EQ(scene.method.source, method.source);
  EXPECT_EQ(scene.method.samples_per_pixel, method.samples_per_pixel);
}

TEST_F(SceneFile, NamesAnUnknownKeyItsPlaceAndTheNearestKnownKey) {
  EXPECT_SAYS(complaint(R"({"object": {"sise": 3}})"), "object.sise: unknown key; did you mean size?");
  EXPECT_SAYS(complaint(R"({"matirial": {}})"), "matirial: unknown key; did you mean material?");
  EXPECT_SAYS(complaint(R"({"lights": [{"type": "point", "intensty": 1}]})"),
              "lights[0].intensty: unknown key; did you mean intensity?");
  EXPECT_SAYS(complaint(R"({"material": {"core": {"absorbtion": 1}}})"), "did you mean absorption?");
  EXPECT_SAYS(complaint(R"({"object": {"zzzzzzzz": 3}})"), "known here: mesh, size");
}

TEST_F(SceneFile, RefusesWrongTypesAndRanges) {
  EXPECT_SAYS(complaint(R"({"object": {"size": "big"}})"), "object.size: is 'big'; expected number");
  EXPECT_SAYS(complaint(R"({"object": {"size": -1}})"), "object.size: -1 is out of range");
  EXPECT_SAYS(complaint(R"({"object": {"ior": 0.9}})"), "expected 1 … 4");
  EXPECT_SAYS(complaint(R"({"object": {"ior": 4.1}})"), "expected 1 … 4");
  EXPECT_SAYS(complaint(R"({"object": []})"), "object: is a list of 0; expected a section");
  EXPECT_SAYS(complaint(R"({"material": {"core": {"absorption": [0.1, -0.2, 0.1], "scattering": 1}}})"),
              "material.core.absorption[1]: -0.2 is out of range");
  EXPECT_SAYS(complaint(R"({"material": {"core": {"absorption": 1}}})"), "material.core.scattering: is missing");
  EXPECT_SAYS(complaint(R"({"material": {"core": {"absorption": 1, "scattering": 1, "anisotropy": 1}}})"),
              "anisotropy: 1 is out of range");
  EXPECT_SAYS(complaint(R"({"material": {"core": "bottom-layer"}})"), "expected shell, opaque, or a core");
  EXPECT_SAYS(complaint(R"({"material": {"core": "interpolated"}})"), "expected shell, opaque, or a core");
  EXPECT_SAYS(complaint(R"({"material": {"core": "smooth"}})"), "\"interpolated\"");
  EXPECT_SAYS(complaint(R"({"material": {"core": {"named": "marbel"}}})"), "did you mean marble?");
  EXPECT_SAYS(complaint(R"({"material": {"opaque": {"reflectance": 1.5}}})"), "0 … 1");
  EXPECT_SAYS(complaint(R"({"material": {"opaque": {}, "core": {"named": "marble"}}})"), "material.core: has no place");
  EXPECT_SAYS(complaint(R"({"material": {"shell": {"thickness": 0}}})"), "1e-6 … 10000");
  EXPECT_SAYS(complaint(R"({"lights": [{"type": "spot"}]})"),
              "'spot' is none of directional, point, area, environment");
  EXPECT_SAYS(complaint(R"({"lights": [{"type": "point", "position": [0,0,0]}]})"), "lights[0].intensity: is missing");
  EXPECT_SAYS(complaint(R"({"lights": [{"type": "directional", "direction": [0,0,0], "irradiance": 1}]})"),
              "zero vector");
  EXPECT_SAYS(complaint(R"({"lights": [{"type": "point", "position": [0,0,0], "intensity": 1, "zenith": 1}]})"),
              "zenith: has no place");
  EXPECT_SAYS(complaint(R"({"camera": {"position": [1, 2, 3], "look_at": [1, 2, 3]}})"), "equals look_at");
  EXPECT_SAYS(complaint(R"({"camera": {"position": [0, 5, 0], "up": [0, 1, 0]}})"), "parallel");
  EXPECT_SAYS(complaint(R"({"camera": {"position": [1e99, 0, 0]}})"), "out of range");
  EXPECT_SAYS(complaint(R"({"camera": {"resolution": [0, 10]}})"), "1 … 16384");
  EXPECT_SAYS(complaint(R"({"camera": {"resolution": [1.5, 10]}})"), "whole pixels");
  EXPECT_SAYS(complaint(R"({"method": {"nodes": 1e999}})"), "is not JSON");
}

TEST_F(SceneFile, RefusesWhatIsNotJsonAndKeysThatStandTwice) {
  EXPECT_SAYS(complaint(""), "is not JSON");
  EXPECT_SAYS(complaint("{\"object\": {"), "line 1");
  EXPECT_SAYS(complaint("[1]"), "expected a section");
  EXPECT_SAYS(complaint(R"({"object": {"size": 1, "size": 2}})"), "'size' stands twice");
  EXPECT_EQ(complaint(R"({"object": {"size": 1}, "camera": {}})"), "");
}

TEST_F(SceneFile, NamesMissingFiles) {
  EXPECT_SAYS(complaint(R"({"object": {"mesh": "gone.off"}})"), "object.mesh: " + (folder_ / "gone.off").string());
  EXPECT_SAYS(complaint(R"({"material": {"shell": {"sample": "gone.json"}}})"), "material.shell.sample");
  EXPECT_SAYS(complaint(R"({"lights": [{"type": "environment", "image": "gone.exr"}]})"), "lights[0].image");
  EXPECT_SAYS(complaint(R"({"object": {"mesh": "."}})"), "is not a file");
  EXPECT_THROW(read_scene((folder_ / "none.json").string()), InputError);
}

TEST_F(SceneFile, ChecksThePixelsOfAnEnvironment) {
  const std::string path = (folder_ / "sky.exr").string();
  const std::string scene = R"({"lights": [{"type": "environment", "image": "sky.exr", "scale": 100}]})";
  const auto save = [&](const std::vector<std::string>& names, float odd) {
    Image image;
    image.width = 3;
    image.height = 2;
    for (const std::string& name : names) {
      image.add(name).values.assign(6, 0.5f);
      image.channels.back().values[5] = name == "A" ? std::nanf("") : odd;
    }
    write_exr(path, image);
  };
  save({"R", "G", "B", "A"}, 2);
  EXPECT_EQ(complaint(scene), "");
  save({"Y"}, 2);
  EXPECT_EQ(complaint(scene), "");
  for (const char* name : {"R", "G", "B"})
    EXPECT_EQ(std::get<EnvironmentLight>(read(scene).lights[0]).image->find(name)->values[5], 2.0f);
  for (const float odd : {std::nanf(""), -0.1f, HUGE_VALF, 3e38f, 1.1e10f}) {
    save({"R", "G", "B"}, odd);
    EXPECT_SAYS(complaint(scene), "lights[0].image: " + path + ": 1 pixel in channel R");
    EXPECT_SAYS(complaint(scene), "at (2, 1)");
  }
  save({"R"}, 1);
  EXPECT_SAYS(complaint(scene), "has no channel G");
  EXPECT_SAYS(complaint(R"({"lights": [{"type": "directional", "direction": [0, 1, 0], "irradiance": 1e13}]})"),
              "0 … 1e12");
}

// Total diffuse reflectance of the dipole. Source: [Jensen2001] eq. after (15), with their polynomial F_dr.
double dipole_reflectance(double reduced_albedo, double ior) {
  const double internal = -1.440 / (ior * ior) + 0.710 / ior + 0.668 + 0.0636 * ior;
  const double boundary = (1 + internal) / (1 - internal), root = std::sqrt(3 * (1 - reduced_albedo));
  return reduced_albedo / 2 * (1 + std::exp(-4.0 / 3 * boundary * root)) * std::exp(-root);
}

TEST(NamedMaterials, ReproduceThePublishedReflectances) {
  EXPECT_EQ(named_materials().size(), 12u);
  for (const NamedMaterial& named : named_materials())
    for (int channel = 0; channel < 3; ++channel)
      // The published figures are rounded to two digits, and so are the coefficients.
      EXPECT_NEAR(dipole_reflectance(named.material.reduced_albedo()[channel], named.ior),
                  named.measured_reflectance[channel], 0.03)
          << named.name << " channel " << channel;
}

TEST(NearestName, FindsMisspellingsAndNothingForeign) {
  EXPECT_EQ(nearest_name("thicknes", {"voxel", "thickness"}), "thickness");
  EXPECT_EQ(nearest_name("hcannel", {"channel", "handle"}), "channel");
  EXPECT_EQ(nearest_name("xyzzy", {"voxel", "thickness"}), "");
}

TEST(Numbers, AreReadAndWrittenShortly) {
  EXPECT_EQ(parse_number("1e5"), 1e5);
  EXPECT_EQ(parse_number("+2.5"), 2.5);
  for (const char* bad : {"", "+", "nan", "inf", "1e999", "1x", " 1", "0x10"})
    EXPECT_THROW(parse_number(bad), UsageError);
  EXPECT_EQ(number_text(1e5), "1e5");
  EXPECT_EQ(number_text(0.005), "0.005");
  EXPECT_EQ(number_text(80), "80");
  EXPECT_EQ(number_text(1e-12), "1e-12");
  for (const double value : {0.1, 1.0 / 3, 123456.0, 1e300, -2.5e-7}) EXPECT_EQ(std::stod(number_text(value)), value);
}

TEST(OneLine, LeavesNoLineBreakAndNoControlCharacter) { EXPECT_EQ(one_line("a\n\tb\x1b[1mc"), "a b\\x1b[1mc"); }

}  // namespace
}  // namespace shellgrid
