// SPDX-License-Identifier: AGPL-3.0-or-later
// Volumes as other programs write them with OpenVDB itself: what comes through read_vdb, voxel by voxel.
#include <gtest/gtest.h>
#include <openvdb/io/File.h>
#include <openvdb/openvdb.h>
#include <openvdb/tools/LevelSetSphere.h>
#include <openvdb/tools/LevelSetUtil.h>
#include <openvdb/tools/Prune.h>

#include "meshing/formats/cube_list_file.h"
#include "meshing/formats/vdb_file.h"
#include "tests/meshing/formats/format_shapes.h"

namespace shellgrid {
namespace {

void write_foreign(const std::string& path, const openvdb::GridBase::Ptr& grid, const std::string& name) {
  grid->setName(name);
  openvdb::io::File file(path);
  file.write({grid});
  file.close();
}

float plain(float value) { return value; }
std::int32_t plain(std::int32_t value) { return value; }
Vec3f plain(const openvdb::Vec3s& value) { return {value.x(), value.y(), value.z()}; }

// Value and state at every voxel of the box, which must reach beyond everything that the grid holds.
template <class T, class Grid>
void expect_every_voxel(const TwoLevelGrid<T>& read, const Grid& grid, const openvdb::CoordBBox& box) {
  const auto accessor = grid.getConstAccessor();
  for (auto at = box.begin(); at; ++at) {
    const openvdb::Coord s = *at;
    ASSERT_EQ(read.value(s.x(), s.y(), s.z()), plain(accessor.getValue(s))) << s;
    ASSERT_EQ(read.is_active(s.x(), s.y(), s.z()), accessor.isValueOn(s)) << s;
  }
  EXPECT_EQ(read.active_count(), grid.activeVoxelCount());
}

const openvdb::CoordBBox around({-150, -70, -90}, {70, 60, 60});

TEST(ForeignVdb, FilledBoxesOfActiveTilesComeThrough) {
  openvdb::initialize();
  const TemporaryFolder folder;
  const openvdb::FloatGrid::Ptr grid = openvdb::FloatGrid::create(0.25f);
  // Whole tiles of 8³ inside, voxels along the rim, and a tile of 128³ elsewhere.
  grid->sparseFill(openvdb::CoordBBox({-21, -16, 3}, {40, 17, 33}), 2.5f, true);
  grid->sparseFill(openvdb::CoordBBox({-128, -128, -128}, {-1, -1, -1}), -1.5f, true);
  grid->sparseFill(openvdb::CoordBBox({8, 8, -16}, {15, 15, -9}), 7.0f, false);  // inactive, yet not the background
  ASSERT_GT(grid->tree().activeTileCount(), 0u);
  write_foreign(folder / "a.vdb", grid, "density");
  const VdbArchive archive = read_vdb(folder / "a.vdb");
  expect_every_voxel(archive.get<float>("density"), *grid, openvdb::CoordBBox({-140, -140, -140}, {60, 30, 50}));
}

TEST(ForeignVdb, DenseTilesOfLabelsAndVectorsComeThrough) {
  openvdb::initialize();
  const TemporaryFolder folder;
  const openvdb::Int32Grid::Ptr labels = openvdb::Int32Grid::create(-1);
  labels->denseFill(openvdb::CoordBBox({-20, 0, 5}, {30, 25, 40}), 3, true);
  labels->denseFill(openvdb::CoordBBox({0, 8, 8}, {15, 15, 23}), 9, true);
  openvdb::tools::prune(labels->tree());  // uniform leaves become tiles
  ASSERT_GT(labels->tree().activeTileCount(), 0u);
  ASSERT_GT(labels->tree().leafCount(), 0u);
  write_foreign(folder / "l.vdb", labels, "label");
  expect_every_voxel(read_vdb(folder / "l.vdb").get<std::int32_t>("label"), *labels, around);

  const openvdb::Vec3SGrid::Ptr vectors = openvdb::Vec3SGrid::create(openvdb::Vec3s(0, 0, 1));
  vectors->sparseFill(openvdb::CoordBBox({-9, -9, -9}, {20, 20, 20}), openvdb::Vec3s(1, 2, 3), true);
  ASSERT_GT(vectors->tree().activeTileCount(), 0u);
  write_foreign(folder / "v.vdb", vectors, "colour");
  expect_every_voxel(read_vdb(folder / "v.vdb").get<Vec3f>("colour"), *vectors, around);
}

TEST(ForeignVdb, LevelSetsAndFogKeepTheirInside) {
  openvdb::initialize();
  const TemporaryFolder folder;
  const openvdb::FloatGrid::Ptr level_set =
      openvdb::tools::createLevelSetSphere<openvdb::FloatGrid>(10.0f, openvdb::Vec3f(0.5f, 0, 0), 0.25f, 3.0f);
  const openvdb::CoordBBox box({-60, -60, -60}, {60, 60, 60});
  write_foreign(folder / "s.vdb", level_set, "surface");
  const VdbArchive archive = read_vdb(folder / "s.vdb");
  expect_every_voxel(archive.get<float>("surface"), *level_set, box);
  EXPECT_LT(archive.get<float>("surface").value(0, 0, 0), 0) << "deep inside, where only inactive tiles are";

  const openvdb::FloatGrid::Ptr fog = level_set->deepCopy();
  openvdb::tools::sdfToFogVolume(*fog);
  ASSERT_GT(fog->tree().activeTileCount(), 0u);
  write_foreign(folder / "f.vdb", fog, "density");
  expect_every_voxel(read_vdb(folder / "f.vdb").get<float>("density"), *fog, box);
  // As a list of cubes: every voxel of the ball, in tiles or not.
  const CubeList cubes = read_cube_list(folder / "f.vdb");
  EXPECT_EQ(cubes.cubes.size(), fog->activeVoxelCount());
  EXPECT_NEAR(static_cast<double>(cubes.cubes.size()) * std::pow(0.25, 3), 4.0 / 3 * M_PI * 1000, 50);
}

TEST(ForeignVdb, TilesTooLargeForLeavesAreRefusedByName) {
  openvdb::initialize();
  const TemporaryFolder folder;
  for (const bool active : {true, false}) {
    const openvdb::FloatGrid::Ptr grid = openvdb::FloatGrid::create(0.0f);
    grid->tree().addTile(3, openvdb::Coord(0, 0, 0), 1.0f, active);  // 4096³ voxels
    write_foreign(folder / "huge.vdb", grid, "density");
    EXPECT_EQ(input_error_of([&] { read_vdb(folder / "huge.vdb"); }),
              (folder / "huge.vdb") + ": the tiles of the grid 'density' hold more than 2^28 voxels");
  }
}

}  // namespace
}  // namespace shellgrid
