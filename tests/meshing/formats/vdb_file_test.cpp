// SPDX-License-Identifier: AGPL-3.0-or-later
#include "meshing/formats/vdb_file.h"

#include <gtest/gtest.h>

#include <Eigen/Geometry>
#include <cmath>
#include <cstring>
#include <map>
#include <utility>

#include "tests/meshing/formats/format_shapes.h"

namespace shellgrid {
namespace {

template <class T, class Make>
TwoLevelGrid<T> scattered(const T& background, const Make& make) {
  TwoLevelGrid<T> grid(Vec3i(-3, -3, -3), Vec3i(6, 6, 6), background);
  for (int n = 0; n < 3000; ++n) {
    const int i = n * 7919 % 41 - 20, j = n * 104729 % 37 - 20, k = n * 129971 % 31 - 10;
    grid.set(i, j, k, make(n));
  }
  // Inactive samples of allocated leaves hold values of their own.
  for (int n = 0; n < 512; n += 3)
    if (!TwoLevelGrid<T>::mask_test(grid.leaf_mask(1), n)) grid.leaf_values(1)[n] = make(-n);
  return grid;
}

VdbArchive archive_of_all_types() {
  VdbArchive archive;
  archive.frame.origin = Vec3(-40.1, 1.0 / 3, 17);
  archive.frame.voxel = 0.4;
  archive.grids = {
      {"distance", scattered<float>(0.8f, [](int n) { return std::sin(static_cast<float>(n)); })},
      {"vertex", scattered<std::int32_t>(-1, [](int n) { return n * 700001; })},
      {"point", scattered<Vec3f>(Vec3f::Zero(), [](int n) { return Vec3f(n * 0.1f, -n / 3.0f, 1e-30f); })}};
  archive.metadata = {{"kind", "test"}, {"text", "a b\nc"}};
  archive.set_numbers("numbers", {1.0 / 3, -1e300, 0.1});
  return archive;
}

template <class T>
void expect_same(const TwoLevelGrid<T>& a, const TwoLevelGrid<T>& b) {
  ASSERT_EQ(a.leaf_count(), b.leaf_count());
  EXPECT_EQ(a.background(), b.background());
  for (int l = 0; l < a.leaf_count(); ++l) {
    const int m = b.find_leaf(a.leaf_coordinate(l));
    ASSERT_GE(m, 0);
    EXPECT_EQ(a.leaf_mask(l), b.leaf_mask(m));
    EXPECT_EQ(std::memcmp(a.leaf_values(l), b.leaf_values(m), 512 * sizeof(T)), 0);
  }
}

TEST(VdbFile, RoundTripIsLosslessAndDeterministic) {
  const TemporaryFolder folder;
  const VdbArchive archive = archive_of_all_types();
  write_vdb(folder / "a.vdb", archive);
  const VdbArchive read = read_vdb(folder / "a.vdb");
  EXPECT_EQ(read.frame.origin, archive.frame.origin);
  EXPECT_EQ(read.frame.voxel, archive.frame.voxel);
  EXPECT_EQ(read.metadata, archive.metadata);
  EXPECT_EQ(read.numbers("numbers", 3), (std::vector<double>{1.0 / 3, -1e300, 0.1}));
  expect_same(read.get<float>("distance"), archive.get<float>("distance"));
  expect_same(read.get<std::int32_t>("vertex"), archive.get<std::int32_t>("vertex"));
  expect_same(read.get<Vec3f>("point"), archive.get<Vec3f>("point"));
  write_vdb(folder / "b.vdb", archive);
  EXPECT_EQ(hash_file(folder / "a.vdb"), hash_file(folder / "b.vdb"));
  EXPECT_EQ(folder.file_count(), 2u);
}

TEST(VdbFile, MissingGridsAndMetadataAreNamed) {
  const TemporaryFolder folder;
  write_vdb(folder / "a.vdb", archive_of_all_types());
  const VdbArchive read = read_vdb(folder / "a.vdb");
  EXPECT_EQ(input_error_of([&] { read.get<float>("vertex"); }),
            (folder / "a.vdb") + ": no grid 'vertex' of type float");
  EXPECT_THROW(read.number("none"), InputError);
  EXPECT_THROW(read.number("text"), InputError);
  EXPECT_THROW(read.numbers("numbers", 2), InputError);
  EXPECT_THROW(read_distance_field(folder / "a.vdb"), InputError);
  EXPECT_THROW(read_shell_volume(folder / "a.vdb"), InputError);
}

TEST(VdbFile, EmptyGridsComeBackEmpty) {
  const TemporaryFolder folder;
  VdbArchive archive;
  archive.grids = {{"none", TwoLevelGrid<float>(Vec3i::Zero(), Vec3i::Ones(), 2.0f)}};
  write_vdb(folder / "a.vdb", archive);
  const VdbArchive read = read_vdb(folder / "a.vdb");
  EXPECT_EQ(read.get<float>("none").leaf_count(), 0);
  EXPECT_EQ(read.get<float>("none").value(3, 4, 5), 2.0f);
}

DistanceField sphere_field(double radius, double voxel) {
  DistanceField field;
  field.frame.origin = Vec3(0.1, 0.2, 0.3);
  field.frame.voxel = voxel;
  field.inside_band = 3 * voxel;
  field.outside_band = 2 * voxel;
  const int leaves = static_cast<int>(radius / voxel / 8) + 2;
  const Vec3i lower = Vec3i::Constant(-leaves), counts = Vec3i::Constant(2 * leaves);
  field.distance = TwoLevelGrid<float>(lower, counts, static_cast<float>(field.outside_band));
  field.nearest_vertex = TwoLevelGrid<std::int32_t>(lower, counts, -1);
  field.nearest_point = TwoLevelGrid<Vec3f>(lower, counts, Vec3f::Zero());
  for (int i = -8 * leaves; i < 8 * leaves; ++i)
    for (int j = -8 * leaves; j < 8 * leaves; ++j)
      for (int k = -8 * leaves; k < 8 * leaves; ++k) {
        const double distance = voxel * Vec3(i, j, k).norm() - radius;
        if (distance < -field.inside_band || distance > field.outside_band) continue;
        field.distance.set(i, j, k, static_cast<float>(distance));
        field.nearest_vertex.set(i, j, k, i * j + k);
        field.nearest_point.set(i, j, k, Vec3f(1, 2, 3));
      }
  // As the contract says: deep samples of allocated leaves hold −inside_band.
  for (int l = 0; l < field.distance.leaf_count(); ++l)
    for (int n = 0; n < 512; ++n) {
      const Vec3i at = field.distance.leaf_coordinate(l) * 8 + Vec3i(n >> 6, n >> 3 & 7, n & 7);
      if (voxel * at.cast<double>().norm() - radius < -field.inside_band)
        field.distance.leaf_values(l)[n] = static_cast<float>(-field.inside_band);
    }
  return field;
}

TEST(VdbFile, DistanceFieldRoundTrip) {
  const TemporaryFolder folder;
  const DistanceField field = sphere_field(3, 0.3);
  write_distance_field(folder / "d.vdb", field);
  const DistanceField read = read_distance_field(folder / "d.vdb");
  EXPECT_EQ(read.inside_band, field.inside_band);
  EXPECT_EQ(read.outside_band, field.outside_band);
  EXPECT_EQ(read.frame.voxel, field.frame.voxel);
  expect_same(read.distance, field.distance);
  expect_same(read.nearest_vertex, field.nearest_vertex);
  expect_same(read.nearest_point, field.nearest_point);
}

TEST(VdbFile, ShellVolumeRoundTrip) {
  const TemporaryFolder folder;
  ShellVolume shell;
  shell.frame.voxel = 0.7;
  const auto vectors = [](float scale) {
    return scattered<Vec3f>(Vec3f::Zero(), [=](int n) { return Vec3f(scale * n, 0.5f, -scale); });
  };
  shell.texture_coordinate = vectors(1), shell.extinction = vectors(2), shell.albedo = vectors(3);
  shell.anisotropy = vectors(4), shell.normal = vectors(5);
  shell.kind = scattered<std::int32_t>(0, [](int n) { return n % 3; });
  shell.core.extinction = Rgb(0.1f, 1.0f / 3, 7e-8f);
  shell.core.albedo = Rgb(0.9f, 0.99f, 0.999f);
  shell.core.anisotropy = Rgb(-0.1f, 0, 0.8f);
  shell.core_interpolated = true;
  shell.thickness = 4.1;
  shell.ior = 1.5;
  write_shell_volume(folder / "s.vdb", shell);
  const ShellVolume read = read_shell_volume(folder / "s.vdb");
  expect_same(read.texture_coordinate, shell.texture_coordinate);
  expect_same(read.extinction, shell.extinction);
  expect_same(read.albedo, shell.albedo);
  expect_same(read.anisotropy, shell.anisotropy);
  expect_same(read.normal, shell.normal);
  expect_same(read.kind, shell.kind);
  EXPECT_TRUE((read.core.extinction == shell.core.extinction).all());
  EXPECT_TRUE((read.core.albedo == shell.core.albedo).all());
  EXPECT_TRUE((read.core.anisotropy == shell.core.anisotropy).all());
  EXPECT_TRUE(read.core_interpolated);
  EXPECT_EQ(read.thickness, shell.thickness);
  EXPECT_EQ(read.ior, shell.ior);
  // Parts of it are as they are in the whole; what was not asked for is not there.
  const ShellVolume matter = read_shell_volume(folder / "s.vdb", ShellParts::matter);
  expect_same(matter.kind, shell.kind);
  expect_same(matter.albedo, shell.albedo);
  EXPECT_EQ(matter.normal.leaf_count(), 0);
  EXPECT_EQ(matter.thickness, shell.thickness);
  EXPECT_EQ(read_vdb(folder / "s.vdb", {"kind", "none"}).grids.size(), 1u);
}

// A narrow band around a sphere gives that sphere alone: no second sheet where the band ends inside.
TEST(VdbFile, IsosurfaceOfANarrowBandIsOneClosedOutwardSurface) {
  const DistanceField field = sphere_field(9, 0.3);
  for (double isovalue : {0.0, -0.35}) {
    const TriangleMesh mesh = extract_isosurface(field.distance, field.frame, isovalue);
    const double radius = 9 + isovalue;
    double volume = 0;
    std::map<std::pair<int, int>, int> edges;
    for (int f = 0; f < mesh.face_count(); ++f) {
      volume += mesh.corner(f, 0).dot(mesh.corner(f, 1).cross(mesh.corner(f, 2))) / 6;
      for (int k = 0; k < 3; ++k) ++edges[{mesh.faces(f, k), mesh.faces(f, (k + 1) % 3)}];
    }
    for (const auto& [edge, count] : edges) {
      EXPECT_EQ(count, 1);
      EXPECT_EQ(edges.count({edge.second, edge.first}), 1u);
    }
    EXPECT_EQ(mesh.vertex_count() - static_cast<int>(edges.size()) / 2 + mesh.face_count(), 2);
    EXPECT_NEAR(volume, 4.0 / 3 * M_PI * std::pow(radius, 3), 0.01 * volume);
    for (int i = 0; i < mesh.vertex_count(); ++i)
      EXPECT_NEAR((mesh.vertex(i) - field.frame.origin).norm(), radius, 0.05);
  }
}

TEST(VdbFile, RefusesForeignFiles) {
  const TemporaryFolder folder;
  write_raw(folder / "empty.vdb", "");
  write_raw(folder / "foreign.vdb", std::string(3000, 'x'));
  write_raw(folder / "magic.vdb", std::string(" BDV\0\0\0\0", 8) + std::string(3000, 'x'));
  for (const char* name : {"empty.vdb", "foreign.vdb", "magic.vdb", "missing.vdb"})
    EXPECT_EQ(input_error_of([&] { read_vdb(folder / name); }).rfind(folder / name, 0), 0u);
}

TEST(VdbFile, FileOfAnotherWriterIsReadAfterRehearsal) {
  const TemporaryFolder folder;
  const VdbArchive archive = archive_of_all_types();
  write_vdb(folder / "a.vdb", archive);
  std::string bytes = read_text(folder / "a.vdb");
  bytes[22] = bytes[22] == '0' ? '1' : '0';  // another id
  write_raw(folder / "b.vdb", bytes);
  expect_same(read_vdb(folder / "b.vdb").get<Vec3f>("point"), archive.get<Vec3f>("point"));
}

TEST(VdbFile, SurvivesDamage) {
  const TemporaryFolder folder;
  VdbArchive archive = archive_of_all_types();
  const std::string path = folder / "a.vdb";
  write_vdb(path, archive);
  expect_survives_damage(
      path, [&] { read_vdb(path); }, 40, 120);
}

TEST(VdbFile, DistanceFieldSurvivesDamage) {
  const TemporaryFolder folder;
  const std::string path = folder / "d.vdb";
  write_distance_field(path, sphere_field(1, 0.5));
  expect_survives_damage(
      path, [&] { read_distance_field(path); }, 20, 120);
}

}  // namespace
}  // namespace shellgrid
