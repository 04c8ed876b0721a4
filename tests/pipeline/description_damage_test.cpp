// SPDX-License-Identifier: AGPL-3.0-or-later
#include <gtest/gtest.h>

#include "meshing/formats/image_file.h"
#include "meshing/formats/mesh_file.h"
#include "meshing/formats/vdb_file.h"
#include "pipeline/scene/sample_description.h"
#include "pipeline/scene/scene.h"
#include "synthesis/procedural_sample.h"
#include "synthesis/sample_archive.h"
#include "synthesis/surface_paint.h"
#include "tests/meshing/formats/format_shapes.h"

namespace shellgrid {
namespace {

TEST(DamagedScene, SurvivesDamage) {
  const TemporaryFolder folder;
  write_raw(folder / "m.off", "OFF\n");
  write_raw(folder / "s.json", "{}\n");
  const std::string path = folder / "scene.json";
  write_raw(path, R"({ // a comment
    "object": {"mesh": "m.off", "size": 60, "ior": 1.3, "close_holes": true},
    "material": {"shell": {"sample": "s.json", "thickness": 3, "voxel": 0.5}, "core": {"named": "marble"}},
    "lights": [{"type": "directional", "direction": [0, 0, -2], "irradiance": [1, 2, 3]},
               {"type": "point", "position": [1, 2, 3], "intensity": 4},
               {"type": "environment", "zenith": 1, "lamps": [{"direction": [0, 3, 0], "half_angle": 90, "radiance": 2}]}],
    "camera": {"position": [0, 0, 100], "look_at": [0, 1, 0], "up": [0, 2, 0], "fov": 20, "resolution": [32, 16]},
    "method": {"type": "polygrid-diffusion", "nodes": 2e4, "tolerance": 0.01, "samples_per_pixel": 4}})");
  read_scene(path);
  expect_survives_damage(
      path, [&] { read_scene(path); }, 150, 3000);
}

TEST(DamagedScene, SurvivesDamageOfSamplesPaintAndCore) {
  const TemporaryFolder folder;
  for (const char* file : {"a.json", "b.vdb", "p.ply"}) write_raw(folder / file, "{}\n");
  const std::string path = folder / "scene.json";
  write_raw(path,
            R"({"material": {"shell": {"sample": ["a.json", "b.vdb"], "paint": "p.ply", "scale": 0.5, "symmetry": 2,
    "synthesis": "coherence", "coordinates": "nearest", "direction": [1, 0, 0],
    "orient": [{"point": [1, 2, 3], "direction": [0, 0, 2]}]}, "core": {"sample": "b.vdb"}}})");
  EXPECT_EQ(read_scene(path).material->shell->samples.size(), 2u);
  expect_survives_damage(
      path, [&] { read_scene(path); }, 150, 3000);
}

TEST(DamagedPaint, SurvivesDamage) {
  const TemporaryFolder folder;
  const std::string path = folder / "painted.ply";
  const TriangleMesh surface = octahedron();
  AttributedMesh painted{surface, {}};
  const auto count = static_cast<std::size_t>(surface.vertex_count());
  painted.properties = {{"sample", std::vector<float>(count, 1)}, {"scale", std::vector<float>(count, 0.5f)}};
  for (const char* name : {"direction_x", "direction_y", "direction_z"})
    painted.properties.push_back({name, std::vector<float>(count, 1)});
  write_ply(path, painted);
  const auto lay = [&] { return transfer_paint(read_mesh(path), surface, 2, path); };
  EXPECT_EQ(lay().sample, std::vector<std::int32_t>(count, 1));
  expect_survives_damage(
      path, [&] { lay(); }, 50, 2000);
}

TEST(DamagedSampleDescription, SurvivesDamage) {
  const TemporaryFolder folder;
  const std::string body = R"("materials": {"body": {"absorption": [0.01, 0.02, 0.03], "scattering": [2, 2, 3]}, )";
  const std::vector<std::string> descriptions{
      R"({"type": "marble", "size": [9, 8], "voxel": 0.4, "thickness": 2, "ior": 1.5, "seed": 1, )" + body +
          R"("vein": {"named": "marble"}}, "warp": 6, "veins": [{"cells": 2, "width": 0.9, "waves_x": 1}]})",
      R"({"type": "spots", "size": [9, 8], "voxel": 0.4, "thickness": 2, )" + body +
          R"("spot": {"absorption": 1, "scattering": 2, "anisotropy": 0.5}}, "count": 3, "radius": 1})",
      R"({"type": "bumps", "size": [9, 8], "voxel": 0.4, "thickness": 3, )" + body +
          R"("bump": {"absorption": 1, "scattering": 2}}, "count": 2, "radius": 0.8, "lift": 0.4})",
      R"({"type": "layers", "size": [9, 8], "voxel": 0.4, "thickness": 2, "waviness": 1, "cells": 2,
          "layers": [{"material": {"absorption": 1, "scattering": 2}, "thickness": 1}]})",
      R"({"type": "wood", "size": [9, 8], "voxel": 0.4, "thickness": 2, )" + body +
          R"("ring": {"absorption": 1, "scattering": 2}}, "ring_width": 1, "pith_depth": 2, "waviness": 0.5,
          "fibre_length": 2, "fibres": 0.3, "pores": 0.1})",
      R"({"type": "cells", "size": [9, 8], "voxel": 0.4, "thickness": 2, )" + body +
          R"("wall": {"absorption": 1, "scattering": 2}}, "cells": 2, "wall_width": 0.5, "variation": 1, "jitter": 1})",
      R"({"type": "grass", "size": [9, 8], "voxel": 0.4, "thickness": 3, )" + body +
          R"("blade": {"absorption": 1, "scattering": 2}}, "count": 3, "height": 1, "radius": 0.4, "bend": 0.5})",
      R"({"type": "weave", "size": [9, 8], "voxel": 0.4, "thickness": 3, )" + body +
          R"("warp": {"named": "skin1"}, "weft": {"absorption": 1, "scattering": 2}}, "warp_count": 2, "weft_count": 2,
          "over": 1, "under": 1, "fill": 0.8, "height": 0.4, "strands": 2})",
      R"({"type": "meshes", "size": [9, 8], "voxel": 0.4, "thickness": 3, "samples_per_edge": 2, "top": 0.2, "parts": [
          {"ground": 0, "material": {"named": "skin1"}}, {"mesh": "part.ply", "free": true, "priority": 1, "scale": 0.5,
          "position": [1, 1, 0], "rotation": [0, 10, 20], "scatter": 2, "random_turns": true}]})",
      R"({"type": "volume", "file": "v.raw", "raw": {"size": [6, 5, 4], "type": "uint8", "offset": 3}, "spacing": 0.4,
          "down": "-z", "mirror": true, "surface": 0.5, "borders": "traced", "crop": {"first": [1, 0, 0],
          "size": [5, 5, 3]}, "classes": [{"from": 0, "to": 60, "free": true}, {"value": 70,
          "material": {"named": "skin1"}}]})",
      R"({"type": "solid", "size": [9, 8], "voxel": 0.4, "thickness": 1, "views": {"z": "view.png", "x": "view.png"},
          "extinction": [2, 2, 3], "anisotropy": 0.1, "conversion": "dipole", "brightest": 0.9, "window": 5, "evenness": 1})",
      R"({"type": "layers", "size": [9, 8], "voxel": 0.4, "thickness": 2,
          "layers": [{"material": {"reflectance": [0.5, 0.4, 0.3], "extinction": 2, "conversion": "dipole"}}]})",
  };
  write_png(folder / "view.png", 9, 8, std::vector<std::uint8_t>(9 * 8 * 3, 90));
  write_raw(folder / "v.raw", std::string(60, 'A') + std::string(63, 'z'));
  write_ply(folder / "part.ply", {octahedron(), {}});
  const std::string path = folder / "sample.json";
  for (const std::string& description : descriptions) {
    write_raw(path, description);
    load_sample(path, {});
    expect_survives_damage(
        path, [&] { load_sample(path, {}); }, 50, 400);
  }
}

SampleDefinition small_layers() {
  SampleDefinition definition;
  definition.width = definition.height = 8;
  definition.thickness = 3 * definition.voxel;
  LayersPattern pattern;
  pattern.layers = {{Material::from_absorption_scattering(Rgb::Ones(), Rgb::Ones(), Rgb::Zero()), 1}};
  definition.pattern = pattern;
  return definition;
}

TEST(SampleVolume, SurvivesDamage) {
  const TemporaryFolder folder;
  const std::string path = folder / "sample.vdb";
  const VdbArchive archive = archive_sample(make_procedural_sample(small_layers()));
  write_vdb(path, archive);
  SampleOverrides overrides;
  overrides.thickness = 0.4;
  expect_survives_damage(
      path, [&] { load_sample(path, overrides); }, 30, 120);
}

TEST(SampleVolume, RefusesCutsThinnerThanNothingAndThickerThanTheVolume) {
  const TemporaryFolder folder;
  const std::string path = folder / "sample.vdb";
  write_vdb(path, archive_sample(make_procedural_sample(small_layers())));
  SampleOverrides overrides;
  overrides.voxel = 1e-6;
  overrides.thickness = 1e4;
  EXPECT_NE(input_error_of([&] { load_sample(path, overrides); }).find("10000 mm are wanted"), std::string::npos);
}

}  // namespace
}  // namespace shellgrid
