// SPDX-License-Identifier: AGPL-3.0-or-later
#include "meshing/formats/compare_artefacts.h"

#include <gtest/gtest.h>

#include <cmath>
#include <limits>
#include <nlohmann/json.hpp>

#include "meshing/core/colour_map.h"
#include "meshing/formats/describe.h"
#include "meshing/formats/image_file.h"
#include "meshing/formats/mesh_file.h"
#include "meshing/formats/vdb_file.h"
#include "meshing/formats/vtkhdf_file.h"
#include "tests/meshing/formats/format_shapes.h"

namespace shellgrid {
namespace {

TEST(Comparison, FiguresMatchHandComputation) {
  Comparison figures("x");
  figures.add(3, 0);
  figures.add(1, 5);
  figures.add(std::numeric_limits<double>::infinity(), std::numeric_limits<double>::infinity());
  EXPECT_EQ(figures.mismatches(), 0u);
  EXPECT_DOUBLE_EQ(figures.rmse(), std::sqrt(12.5));
  EXPECT_DOUBLE_EQ(figures.relative(), 1.0);
  EXPECT_EQ(figures.maximum(), 4.0);
  figures.add(std::nan(""), 1);
  EXPECT_EQ(figures.mismatches(), 1u);
  EXPECT_DOUBLE_EQ(figures.rmse(), std::sqrt(12.5));
}

TEST(Comparison, FalseColourBrightensFromBlackToWhite) {
  EXPECT_EQ(false_colour(0), (std::array<std::uint8_t, 3>{0, 0, 0}));
  EXPECT_EQ(false_colour(1), (std::array<std::uint8_t, 3>{255, 255, 255}));
  EXPECT_EQ(false_colour(std::nan("")), (std::array<std::uint8_t, 3>{0, 0, 0}));
  double last = -1;
  for (int i = 0; i <= 64; ++i) {
    const auto c = false_colour(i / 64.0);
    const double luma = 0.30 * c[0] + 0.59 * c[1] + 0.11 * c[2];
    EXPECT_GT(luma, last - 1.0);
    last = luma;
  }
}

Image flat_image(float red, float green) {
  Image image;
  image.width = 4, image.height = 3;
  image.add("R").values.assign(12, red);
  image.add("G").values.assign(12, green);
  image.add("B").values.assign(12, 1.0f);
  return image;
}

TEST(CompareArtefacts, ImagesGiveFiguresPerChannelAndAPicture) {
  const TemporaryFolder folder;
  write_exr(folder / "a.exr", flat_image(0.5f, 2));
  Image b = flat_image(1, 2);
  b.add("depth.Z");
  write_exr(folder / "b.exr", b);
  const ArtefactComparison comparison = compare_artefacts(folder / "a.exr", folder / "b.exr");
  ASSERT_EQ(comparison.figures.size(), 3u);
  for (const Comparison& figures : comparison.figures) {
    EXPECT_DOUBLE_EQ(figures.rmse(), figures.name() == "R" ? 0.5 : 0.0);
    EXPECT_DOUBLE_EQ(figures.relative(), figures.name() == "R" ? 0.5 : 0.0);
  }
  ASSERT_EQ(comparison.remarks.size(), 1u);
  EXPECT_NE(comparison.remarks[0].find("depth.Z"), std::string::npos);
  write_difference(folder / "d.png", comparison, 1.0);
  EXPECT_EQ(read_png(folder / "d.png").width, 4);
  EXPECT_THROW(write_difference(folder / "d.ply", comparison, 0), InputError);
  Image small = flat_image(1, 1);
  small.width = 3, small.height = 4;
  write_exr(folder / "c.exr", small);
  EXPECT_NE(input_error_of([&] { compare_artefacts(folder / "c.exr", folder / "b.exr"); }).find("pixels"),
            std::string::npos);
}

TEST(CompareArtefacts, VolumesAreComparedWhereEitherIsActive) {
  const TemporaryFolder folder;
  VdbArchive a, b;
  TwoLevelGrid<float> grid(Vec3i::Zero(), Vec3i::Ones(), 1.0f);
  grid.set(0, 0, 0, 5);
  a.grids = {{"x", grid}};
  grid.set(1, 1, 1, 4);
  b.grids = {{"x", grid}};
  write_vdb(folder / "a.vdb", a);
  write_vdb(folder / "b.vdb", b);
  const ArtefactComparison comparison = compare_artefacts(folder / "a.vdb", folder / "b.vdb");
  EXPECT_EQ(comparison.figures[0].count(), 2u);
  EXPECT_EQ(comparison.figures[0].maximum(), 3.0);
  EXPECT_DOUBLE_EQ(comparison.figures[0].relative(), std::sqrt(9.0 / 41));
  EXPECT_EQ(comparison.remarks.size(), 1u);
  write_difference(folder / "d.ply", comparison, 0);
  EXPECT_EQ(*read_points(folder / "d.ply").find("quality"), (std::vector<float>{0, 3}));
  b.frame.voxel = 2;
  write_vdb(folder / "b.vdb", b);
  EXPECT_THROW(compare_artefacts(folder / "a.vdb", folder / "b.vdb"), InputError);
}

TEST(CompareArtefacts, MeshesOfOneTopologyAreComparedByVertexElseByDistance) {
  const TemporaryFolder folder;
  AttributedMesh a{octahedron(), {{"exitance_r", {1, 1, 1, 1, 1, 1}}}}, b = a;
  b.properties[0].values[3] = 3;
  write_ply(folder / "a.ply", a);
  write_ply(folder / "b.ply", b);
  ArtefactComparison comparison = compare_artefacts(folder / "a.ply", folder / "b.ply");
  ASSERT_EQ(comparison.figures.size(), 2u);
  EXPECT_EQ(comparison.figures[0].maximum(), 0.0);
  EXPECT_EQ(comparison.figures[1].maximum(), 2.0);
  EXPECT_EQ(comparison.difference[3], 2.0f);

  // Half as large and another order of faces: the furthest points are the corners, 1/2 along the axis to the
  // smaller's corner.
  b.mesh.vertices *= 0.5;
  b.mesh.faces.row(0).swap(b.mesh.faces.row(1));
  write_ply(folder / "b.ply", b);
  comparison = compare_artefacts(folder / "a.ply", folder / "b.ply");
  EXPECT_NEAR(comparison.figures[0].maximum(), 0.5, 1e-6);
  // From a corner of the smaller one, (1/2, 0, 0), to the plane x + y + z = 1.
  EXPECT_NEAR(comparison.figures[1].maximum(), 0.5 / std::sqrt(3.0), 1e-6);
  EXPECT_LT(comparison.figures[0].relative(), 0.5);
  write_difference(folder / "d.ply", comparison, 0);
  EXPECT_EQ(read_mesh(folder / "d.ply").mesh.face_count(), 8);
}

TEST(CompareArtefacts, KindsMustAgree) {
  const TemporaryFolder folder;
  write_exr(folder / "a.exr", flat_image(1, 1));
  write_ply(folder / "a.ply", {octahedron(), {}});
  EXPECT_THROW(compare_artefacts(folder / "a.exr", folder / "a.ply"), InputError);
  EXPECT_THROW(compare_artefacts(folder / "a.txt", folder / "a.txt"), InputError);
}

TEST(Describe, SaysWhatAMeshIs) {
  const TemporaryFolder folder;
  AttributedMesh mesh{octahedron(), {{"quality", {0, 1, 2, 3, 4, std::nanf("")}}}};
  write_ply(folder / "a.ply", mesh);
  nlohmann::json d = describe_artefact(folder / "a.ply");
  EXPECT_EQ(d["vertices"], 6);
  EXPECT_EQ(d["edges"], 12);
  EXPECT_EQ(d["closed"], true);
  EXPECT_EQ(d["genus"], 0);
  EXPECT_NEAR(d["volume_mm3"].get<double>(), 4.0 / 3, 1e-12);
  EXPECT_NEAR(d["area_mm2"].get<double>(), 4 * std::sqrt(3.0), 1e-12);
  EXPECT_EQ(d["properties"]["quality"]["greatest"], 4.0);
  EXPECT_EQ(d["properties"]["quality"]["not_finite"], 1);
  EXPECT_NE(description_text(d).find("quality: 0 … 4, mean 2, 1 not finite"), std::string::npos) << description_text(d);

  mesh.mesh.faces.conservativeResize(7, 3);
  mesh.mesh.faces.row(0).reverseInPlace();
  write_ply(folder / "a.ply", mesh);
  d = describe_artefact(folder / "a.ply");
  EXPECT_EQ(d["closed"], false);
  EXPECT_EQ(d["oriented"], false);
  EXPECT_EQ(d["boundary_edges"], 3);
  EXPECT_EQ(d["misoriented_edges"], 3);
  EXPECT_FALSE(d.contains("genus"));
}

TEST(Describe, SaysWhatVolumesGridsImagesAndRecordsAre) {
  const TemporaryFolder folder;
  VdbArchive archive;
  TwoLevelGrid<Vec3f> grid(Vec3i::Zero(), Vec3i::Ones(), Vec3f::Zero());
  grid.set(1, 2, 3, Vec3f(1, 2, 3));
  archive.grids = {{"albedo", grid}};
  write_vdb(folder / "a.vdb", archive);
  EXPECT_EQ(describe_artefact(folder / "a.vdb")["grids"]["albedo"]["values"]["y"]["mean"], 2.0);
  TetrahedralMesh tets;
  tets.points.resize(4, 3);
  tets.points << 0, 0, 0, 1, 0, 0, 0, 1, 0, 0, 0, 1;
  tets.tetrahedra.resize(1, 4);
  tets.tetrahedra << 0, 1, 2, 3;
  write_tetrahedra(folder / "a.hdf", tets);
  EXPECT_EQ(describe_artefact(folder / "a.hdf")["kind"], "tetrahedral mesh");
  write_exr(folder / "a.exr", flat_image(1, 2));
  EXPECT_EQ(describe_artefact(folder / "a.exr")["channels"]["G"]["mean"], 2.0);
  write_raw(folder / "a.json", "{\"stage\": \"sg-x\", \"inputs\": [], \"results\": {\"y\": [1, 2]}}");
  EXPECT_EQ(describe_artefact(folder / "a.json")["stage"], "sg-x");
  write_raw(folder / "b.json", "{");
  EXPECT_THROW(describe_artefact(folder / "b.json"), InputError);
  EXPECT_THROW(describe_artefact(folder / "b.txt"), InputError);
  for (const char* name : {"a.vdb", "a.hdf", "a.exr", "a.json"})
    EXPECT_FALSE(description_text(describe_artefact(folder / name)).empty());
}

}  // namespace
}  // namespace shellgrid
