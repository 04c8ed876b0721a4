// SPDX-License-Identifier: AGPL-3.0-or-later
// Sources of samples through their descriptions: what files say comes out, the same at any thread count.
#include "pipeline/scene/sample_description.h"

#include <gtest/gtest.h>
#include <oneapi/tbb/global_control.h>

#include "meshing/formats/image_file.h"
#include "meshing/formats/mesh_file.h"
#include "meshing/formats/vdb_file.h"
#include "pipeline/scene/named_materials.h"
#include "synthesis/half_space_reflectance.h"
#include "synthesis/sample_archive.h"
#include "tests/meshing/formats/format_shapes.h"

namespace shellgrid {
namespace {

const std::string two_classes =
    R"("classes": [{"value": 0, "material": {"named": "apple"}}, {"value": 1, "material": {"named": "skin1"}}]})";

// A sample whose share of skin rises from 0 to 1 along x in five steps.
void expect_ramp(const MaterialSample& sample) {
  ASSERT_EQ(sample.size.x(), 5);
  const Material apple = named_material("apple").material, skin = named_material("skin1").material;
  for (int x = 0; x < 5; ++x) {
    const float share = static_cast<float>(x) / 4;
    const Rgb absorption = sample.material(sample.index(x, 2, 1)).absorption();
    EXPECT_NEAR(absorption[1], (1 - share) * apple.absorption()[1] + share * skin.absorption()[1], 6e-4);
  }
}

TEST(SampleDescription, ClassifiesTheDensityOfAnyVolume) {
  const TemporaryFolder folder;
  VdbArchive archive;
  archive.frame = {Vec3(3, 0, 0), 0.5};
  TwoLevelGrid<float> density(Vec3i::Zero(), Vec3i(2, 1, 1), 0.0f);
  // Away from the origin: the box of active samples counts.
  for (int x = 0; x < 5; ++x)
    for (int y = 0; y < 5; ++y)
      for (int z = 0; z < 3; ++z) density.set(x + 4, y + 1, z + 2, static_cast<float>(x) / 4);
  archive.grids.push_back({"fog", density});
  write_vdb(folder / "ct.vdb", archive);
  write_raw(folder / "s.json", R"({"type": "volume", "file": "ct.vdb", "grid": "fog", )" + two_classes);
  const MaterialSample sample = load_sample(folder / "s.json", {});
  expect_ramp(sample);
  EXPECT_EQ(sample.size, Vec3i(5, 5, 3));
  EXPECT_EQ(sample.voxel, 0.5);
  EXPECT_EQ(check_sample_description(folder / "s.json", {}), std::vector<std::string>{folder / "ct.vdb"});
  EXPECT_EQ(described_materials(folder / "s.json").size(), 2u);
}

TEST(SampleDescription, NamesAKeyThatStandsTwiceAndTheKnownOnesOnce) {
  const TemporaryFolder folder;
  const auto complaint = [&](const std::string& text) {
    write_raw(folder / "s.json", text);
    return input_error_of([&] { load_sample(folder / "s.json", {}); });
  };
  EXPECT_NE(complaint(R"({"type": "spots", "type": "wood"})").find("the key 'type' stands twice"), std::string::npos);
  const std::string known = complaint(R"({"type": "spots", "xyzzyx": 1, "materials": {"body": {"named": "apple"},
    "spot": {"named": "skin1"}}})");
  EXPECT_NE(known.find("xyzzyx: unknown key; known here: type, voxel, thickness, ior, size"), std::string::npos)
      << known;
}

TEST(SampleDescription, ClassifiesAStackOfImages) {
  const TemporaryFolder folder;
  std::vector<std::uint8_t> rgb;
  for (int y = 0; y < 4; ++y)
    for (int x = 0; x < 5; ++x) rgb.insert(rgb.end(), 3, static_cast<std::uint8_t>(x * 255 / 4));
  write_png(folder / "a.png", 5, 4, rgb);
  write_png(folder / "b.png", 5, 4, rgb);
  write_raw(folder / "s.json", R"({"type": "volume", "images": ["a.png", "b.png"], "spacing": 0.3, )" + two_classes);
  const MaterialSample sample = load_sample(folder / "s.json", {});
  expect_ramp(sample);
  EXPECT_EQ(sample.size, Vec3i(5, 4, 2));
}

TEST(SampleDescription, AReflectanceIsWhatAHalfSpaceShows) {
  const TemporaryFolder folder;
  write_raw(folder / "s.json",
            R"({"type": "layers", "size": [8, 8], "voxel": 0.4, "thickness": 2, "ior": 1.3, "layers": [{"material":
            {"reflectance": [0.6, 0.3, 0.05], "extinction": [1, 2, 3]}}]})");
  const Material material = load_sample(folder / "s.json", {}).material(9);
  const double wanted[] = {0.6, 0.3, 0.05};
  for (int c = 0; c < 3; ++c) EXPECT_NEAR(half_space_reflectance(material.reduced_albedo()[c], 1.3), wanted[c], 1e-4);
  EXPECT_FLOAT_EQ(material.extinction[1], 2);
}

TEST(SampleDescription, GrowsASolidOfASmallerSampleAndOfPictures) {
  const TemporaryFolder folder;
  write_raw(folder / "small.json",
            R"({"type": "cells", "size": [16, 16], "voxel": 0.5, "thickness": 5, "ior": 1.4, "cells": 3,
            "materials": {"body": {"named": "apple"}, "wall": {"named": "skin1"}}})");
  write_vdb(folder / "small.vdb", archive_sample(load_sample(folder / "small.json", {})));
  write_raw(folder / "s.json",
            R"({"type": "solid", "sample": "small.vdb", "size": [20, 18], "voxel": 0.5, "thickness": 3, "window": 5})");
  const MadeSample made = make_sample(folder / "s.json", {});
  EXPECT_EQ(made.sample.size, Vec3i(20, 18, 6));
  EXPECT_LT(made.figures["window_distance"][2].get<double>(), 0.3);
  std::vector<std::uint8_t> rgb;
  for (int i = 0; i < 144; ++i) rgb.insert(rgb.end(), 3, i / 3 % 2 == 0 ? 60 : 200);
  write_png(folder / "view.png", 12, 12, rgb);
  write_raw(folder / "p.json",
            R"({"type": "solid", "views": {"y": "view.png"}, "size": [10, 10], "thickness": 1, "extinction": 2})");
  EXPECT_EQ(check_sample_description(folder / "p.json", {}), std::vector<std::string>{folder / "view.png"});
  EXPECT_EQ(load_sample(folder / "p.json", {}).size, Vec3i(10, 10, 3));
}

TEST(SampleDescription, EverySourceIsTheSameAtAnyNumberOfThreads) {
  const TemporaryFolder folder;
  write_ply(folder / "part.ply", {octahedron(), {}});
  std::string ramp;
  for (int i = 0; i < 12 * 12 * 8; ++i) ramp += static_cast<char>(i * 37 % 251);
  write_raw(folder / "v.raw", ramp);
  std::vector<std::uint8_t> rgb;
  for (int i = 0; i < 144 * 3; ++i) rgb.push_back(static_cast<std::uint8_t>(i * 91 % 256));
  write_png(folder / "view.png", 12, 12, rgb);
  const std::vector<std::string> descriptions = {
      R"({"type": "meshes", "size": [16, 16], "voxel": 0.25, "thickness": 2, "parts": [{"mesh": "part.ply", "scatter": 5,
          "material": {"named": "apple"}}, {"ground": 0, "material": {"named": "skin1"}}]})",
      R"({"type": "volume", "file": "v.raw", "raw": {"size": [12, 12, 8]}, "spacing": 0.5, "voxel": 0.7, "classes": [
          {"value": 60, "free": true}, {"value": 130, "material": {"named": "apple"}}, {"value": 220,
          "material": {"named": "skin1"}}]})",
      R"({"type": "solid", "views": {"z": "view.png"}, "size": [12, 12], "thickness": 1, "extinction": 2})",
      R"({"type": "grass", "size": [16, 16], "thickness": 5, "materials": {"body": {"named": "apple"},
          "blade": {"named": "skin1"}}})"};
  for (const std::string& description : descriptions) {
    write_raw(folder / "s.json", description);
    const MaterialSample all = load_sample(folder / "s.json", {});
    const oneapi::tbb::global_control one(oneapi::tbb::global_control::max_allowed_parallelism, 1);
    const MaterialSample single = load_sample(folder / "s.json", {});
    EXPECT_EQ(all.extinction, single.extinction);
    EXPECT_EQ(all.albedo, single.albedo);
    EXPECT_EQ(all.normal, single.normal);
    EXPECT_EQ(all.kind, single.kind);
  }
}

}  // namespace
}  // namespace shellgrid
