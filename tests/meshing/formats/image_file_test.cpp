// SPDX-License-Identifier: AGPL-3.0-or-later
#include "meshing/formats/image_file.h"

#include <gtest/gtest.h>

#include <cmath>
#include <limits>

#include "tests/meshing/formats/format_shapes.h"

namespace shellgrid {
namespace {

Image layered_image() {
  Image image;
  image.width = 7;
  image.height = 5;
  for (const char* name : {"A", "B", "G", "R", "depth.Z", "specular.R"}) {
    Image::Channel& channel = image.add(name);
    for (std::size_t i = 0; i < channel.values.size(); ++i)
      channel.values[i] = std::sin(static_cast<float>(i) * static_cast<float>(name[0])) * 1e3f;
  }
  image.channels[4].values[3] = std::numeric_limits<float>::infinity();
  return image;
}

TEST(ImageFile, ExrRoundTripIsLosslessAndDeterministic) {
  const TemporaryFolder folder;
  const Image image = layered_image();
  write_exr(folder / "a.exr", image);
  const Image read = read_exr(folder / "a.exr");
  EXPECT_EQ(read.width, 7);
  EXPECT_EQ(read.height, 5);
  ASSERT_EQ(read.channels.size(), image.channels.size());
  for (const Image::Channel& channel : image.channels) {
    ASSERT_NE(read.find(channel.name), nullptr) << channel.name;
    EXPECT_EQ(read.find(channel.name)->values, channel.values) << channel.name;
  }
  write_exr(folder / "b.exr", read);
  EXPECT_EQ(read_text(folder / "a.exr"), read_text(folder / "b.exr"));
}

TEST(ImageFile, PngRowsStartAtTheTopAndDecodeSrgb) {
  const TemporaryFolder folder;
  const std::vector<std::uint8_t> rgb{0, 128, 255, 10, 20, 30, 40, 50, 60, 70, 80, 90};
  write_png(folder / "a.png", 2, 2, rgb);
  const Image image = read_png(folder / "a.png");
  ASSERT_EQ(image.width, 2);
  EXPECT_EQ(image.find("R")->values[0], 0.0f);
  EXPECT_NEAR(image.find("G")->values[0], 0.21586f, 1e-5);  // the sRGB standard's curve at 128
  EXPECT_EQ(image.find("B")->values[0], 1.0f);
  EXPECT_NEAR(image.find("R")->values[2], std::pow((40 / 255.0 + 0.055) / 1.055, 2.4), 1e-6);
  write_png(folder / "b.png", 2, 2, rgb);
  EXPECT_EQ(read_text(folder / "a.png"), read_text(folder / "b.png"));
}

TEST(ImageFile, RefusesForeignFiles) {
  const TemporaryFolder folder;
  write_raw(folder / "empty", "");
  write_raw(folder / "foreign", "hello, this is no picture at all");
  for (const char* name : {"empty", "foreign", "missing"}) {
    EXPECT_THROW(read_exr(folder / name), InputError);
    EXPECT_THROW(read_png(folder / name), InputError);
  }
}

TEST(ImageFile, SurvivesDamage) {
  const TemporaryFolder folder;
  const std::string exr = folder / "a.exr", png = folder / "a.png";
  write_exr(exr, layered_image());
  expect_survives_damage(
      exr, [&] { read_exr(exr); }, 150, 1500);
  std::vector<std::uint8_t> rgb(30 * 20 * 3);
  for (std::size_t i = 0; i < rgb.size(); ++i) rgb[i] = static_cast<std::uint8_t>(i * i >> 3);
  write_png(png, 30, 20, rgb);
  expect_survives_damage(
      png, [&] { read_png(png); }, 150, 1500);
}

}  // namespace
}  // namespace shellgrid
