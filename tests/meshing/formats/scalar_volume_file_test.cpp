// SPDX-License-Identifier: AGPL-3.0-or-later
#include "meshing/formats/scalar_volume_file.h"

#include <gtest/gtest.h>
#include <zlib.h>

#include <cstring>

#include "meshing/formats/image_file.h"
#include "tests/meshing/formats/format_shapes.h"

namespace shellgrid {
namespace {

std::string gzip(const std::string& bytes) {
  z_stream stream{};
  deflateInit2(&stream, 9, Z_DEFLATED, 15 + 16, 8, Z_DEFAULT_STRATEGY);
  std::string packed(bytes.size() + 200, '\0');
  stream.next_in = reinterpret_cast<Bytef*>(const_cast<char*>(bytes.data()));
  stream.avail_in = static_cast<uInt>(bytes.size());
  stream.next_out = reinterpret_cast<Bytef*>(packed.data());
  stream.avail_out = static_cast<uInt>(packed.size());
  deflate(&stream, Z_FINISH);
  packed.resize(stream.total_out);
  deflateEnd(&stream);
  return packed;
}

// Value 100 x + 10 y + z of 2 by 3 by 4, as big- or little-endian shorts.
std::string shorts(bool big) {
  std::string bytes;
  for (int z = 0; z < 4; ++z)
    for (int y = 0; y < 3; ++y)
      for (int x = 0; x < 2; ++x) {
        const int value = 100 * x + 10 * y + z;
        const char high = static_cast<char>(value >> 8), low = static_cast<char>(value & 255);
        bytes += big ? std::string{high, low} : std::string{low, high};
      }
  return bytes;
}

void expect_shorts(const ScalarVolume& volume) {
  ASSERT_EQ(volume.size, Vec3i(2, 3, 4));
  for (int z = 0; z < 4; ++z)
    for (int y = 0; y < 3; ++y)
      for (int x = 0; x < 2; ++x) EXPECT_EQ(volume.at(x, y, z), 100 * x + 10 * y + z);
}

const std::string start = "NRRD0004\n# a comment\ntype: short\ndimension: 3\nsizes: 2 3 4\nsource:=nowhere\n";

TEST(ScalarVolumeFile, ReadsNrrdInEveryEncodingAndByteOrder) {
  const TemporaryFolder folder;
  const std::string path = folder / "v.nrrd";
  write_raw(path, start + "endian: little\nencoding: raw\nspacings: 0.5 0.25 2\n\n" + shorts(false));
  expect_shorts(read_nrrd(path));
  EXPECT_EQ(read_nrrd(path).spacing, Vec3(0.5, 0.25, 2));
  write_raw(path, start + "endian: big\nencoding: gzip\nspace directions: (3,4,0) (-1.6,1.2,0) (0,0,0.5)\n\n" +
                      gzip(shorts(true)));
  expect_shorts(read_nrrd(path));
  EXPECT_EQ(read_nrrd(path).spacing, Vec3(5, 2, 0.5));
  std::string text;
  for (int z = 0; z < 4; ++z)
    for (int y = 0; y < 3; ++y)
      for (int x = 0; x < 2; ++x) text += std::to_string(100 * x + 10 * y + z) + (x == 1 ? "\n" : " ");
  write_raw(path, start + "encoding: text\n\n" + text);
  expect_shorts(read_nrrd(path));
}

TEST(ScalarVolumeFile, ReadsDetachedValuesAndSkips) {
  const TemporaryFolder folder;
  write_raw(folder / "v.raw", "two\nlines\n12345" + shorts(false));
  write_raw(folder / "v.nhdr", start + "encoding: raw\ndata file: v.raw\nline skip: 2\nbyte skip: 5\n");
  expect_shorts(read_nrrd(folder / "v.nhdr"));
  write_raw(folder / "v.nhdr", start + "encoding: raw\ndata file: v.raw\nbyte skip: -1\n");
  expect_shorts(read_nrrd(folder / "v.nhdr"));
  RawLayout layout;
  layout.size = Vec3i(2, 3, 4), layout.type = ScalarType::int16, layout.offset = 15;
  expect_shorts(read_raw_volume(folder / "v.raw", layout));
}

TEST(ScalarVolumeFile, ReadsEveryType) {
  const TemporaryFolder folder;
  const auto round_trip = [&](auto value, const std::string& name) {
    std::string bytes(sizeof value, '\0');
    std::memcpy(bytes.data(), &value, sizeof value);
    write_raw(folder / "v.raw", bytes);
    RawLayout layout;
    layout.size = Vec3i(1, 1, 1), layout.type = scalar_type(name);
    EXPECT_EQ(read_raw_volume(folder / "v.raw", layout).values[0], static_cast<float>(value)) << name;
  };
  round_trip(std::int8_t{-7}, "signed char");
  round_trip(std::uint8_t{200}, "uchar");
  round_trip(std::int16_t{-700}, "short");
  round_trip(std::uint16_t{60000}, "unsigned short");
  round_trip(std::int32_t{-70000}, "int");
  round_trip(std::uint32_t{4000000000u}, "uint32");
  round_trip(std::int64_t{-70000000000}, "longlong");
  round_trip(std::uint64_t{70000000000}, "uint64_t");
  round_trip(0.125f, "float");
  round_trip(-1e20, "double");
}

TEST(ScalarVolumeFile, RefusesWhatItCannotRead) {
  const TemporaryFolder folder;
  const std::string path = folder / "v.nrrd";
  const auto refusal = [&](const std::string& bytes) {
    write_raw(path, bytes);
    return input_error_of([&] { read_nrrd(path); });
  };
  EXPECT_NE(refusal("nothing").find("not an NRRD"), std::string::npos);
  EXPECT_NE(refusal(start + "encoding: raw\nspace directions: (3,4,0) (0,2,0) (0,0,0.5)\n\n" + shorts(false))
                .find("its axes 1 and 2 are not perpendicular"),
            std::string::npos);
  EXPECT_NE(refusal(start + "encoding: bzip2\n\n").find("bzip2"), std::string::npos);
  EXPECT_NE(refusal(start + "\n").find("'encoding' is missing"), std::string::npos);
  EXPECT_NE(refusal(start + "encoding: raw\n\n" + shorts(false).substr(1)).find("need 48"), std::string::npos);
  EXPECT_NE(refusal(start + "encoding: gzip\n\n" + gzip(shorts(false)).substr(0, 20)).find("truncated"),
            std::string::npos);
  EXPECT_NE(refusal("NRRD0004\ntype: float\ndimension: 3\nsizes: 1 1 1\nencoding: text\n\nnan").find("not finite"),
            std::string::npos);
  EXPECT_NE(refusal("NRRD0004\ntype: float\ndimension: 4\nsizes: 3 1 1 1\nencoding: text\n\n1").find("axes"),
            std::string::npos);
  EXPECT_NE(refusal("NRRD0004\ntype: uchar\ndimension: 3\nsizes: 600 600 600\nencoding: gzip\n\nabc").find("promises"),
            std::string::npos);
  EXPECT_NE(refusal(start + "encoding: raw\ndata file: none.raw\n").find("none.raw"), std::string::npos);
}

TEST(ScalarVolumeFile, NrrdSurvivesDamage) {
  const TemporaryFolder folder;
  for (const bool packed : {false, true}) {
    const std::string path = folder / "v.nrrd";
    write_raw(path, start + (packed ? "encoding: gzip\n" : "encoding: raw\n") + "spacings: 0.5 0.25 2\n\n" +
                        (packed ? gzip(shorts(false)) : shorts(false)));
    expect_survives_damage(
        path, [&] { read_nrrd(path); }, 60, 1500);
  }
}

TEST(ScalarVolumeFile, ImageStacksKeepCodeValues) {
  const TemporaryFolder folder;
  write_png(folder / "a.png", 2, 1, {0, 0, 0, 51, 51, 51});
  write_png(folder / "b.png", 2, 1, {102, 102, 102, 255, 255, 255});
  const ScalarVolume volume = read_image_stack({folder / "a.png", folder / "b.png"});
  ASSERT_EQ(volume.size, Vec3i(2, 1, 2));
  const float expected[] = {0, 0.2f, 0.4f, 1};
  for (int i = 0; i < 4; ++i) EXPECT_NEAR(volume.values[i], expected[i], 0.003);
  write_png(folder / "c.png", 1, 1, {1, 2, 3});
  EXPECT_THROW(read_image_stack({folder / "a.png", folder / "c.png"}), InputError);
}

}  // namespace
}  // namespace shellgrid
