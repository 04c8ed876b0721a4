// SPDX-License-Identifier: AGPL-3.0-or-later
#include "meshing/formats/vtkhdf_file.h"

#include <gtest/gtest.h>

#include <algorithm>

#include "tests/meshing/formats/format_shapes.h"

namespace shellgrid {
namespace {

// A row of `count` unit cubes with every kind of array.
UnstructuredGrid row_of_cubes(int count) {
  UnstructuredGrid grid;
  grid.points.resize(4 * (count + 1), 3);
  for (int i = 0; i <= count; ++i)
    for (int k = 0; k < 4; ++k) grid.points.row(4 * i + k) << i / 3.0, k == 1 || k == 2, k / 2;
  grid.offsets = {0};
  for (int c = 0; c < count; ++c) {
    for (int k = 0; k < 8; ++k) grid.connectivity.push_back(4 * c + k);
    grid.offsets.push_back(8 * (c + 1));
    grid.types.push_back(12);
  }
  const auto points = static_cast<std::size_t>(grid.points.rows());
  grid.point_data = {{"fluence", 3, std::vector<float>(3 * points, 0.1f)},
                     {"depth", 1, std::vector<double>(points, 1.0 / 3)}};
  grid.cell_data = {{"id", 1, std::vector<std::int64_t>(static_cast<std::size_t>(count), std::int64_t{1} << 40)},
                    {"layer", 1, std::vector<std::uint8_t>(static_cast<std::size_t>(count), 200)}};
  grid.field_data = {{"empty", 3, std::vector<double>{}},
                     {"links", 6, std::vector<std::int32_t>(600000, -7)},
                     {"single", 1, std::vector<double>{4}}};
  grid.attributes = {{"spacing", 0.1}};
  return grid;
}

void expect_same(std::vector<DataArray> a, std::vector<DataArray> b) {
  const auto by_name = [](const DataArray& x, const DataArray& y) { return x.name < y.name; };
  std::sort(a.begin(), a.end(), by_name), std::sort(b.begin(), b.end(), by_name);
  ASSERT_EQ(a.size(), b.size());
  for (std::size_t i = 0; i < a.size(); ++i) {
    EXPECT_EQ(a[i].name, b[i].name);
    EXPECT_EQ(a[i].columns, b[i].columns) << a[i].name;
    EXPECT_TRUE(a[i].values == b[i].values) << a[i].name;
  }
}

TEST(VtkhdfFile, RoundTripIsLosslessAndDeterministic) {
  const TemporaryFolder folder;
  const UnstructuredGrid grid = row_of_cubes(5);
  write_vtkhdf(folder / "a.hdf", grid);
  const UnstructuredGrid read = read_vtkhdf(folder / "a.hdf");
  EXPECT_TRUE((read.points.array() == grid.points.array()).all());
  EXPECT_EQ(read.connectivity, grid.connectivity);
  EXPECT_EQ(read.offsets, grid.offsets);
  EXPECT_EQ(read.types, grid.types);
  EXPECT_EQ(read.attributes, grid.attributes);
  expect_same(read.point_data, grid.point_data);
  expect_same(read.cell_data, grid.cell_data);
  expect_same(read.field_data, grid.field_data);
  write_vtkhdf(folder / "b.hdf", grid);
  EXPECT_EQ(hash_file(folder / "a.hdf"), hash_file(folder / "b.hdf"));
  EXPECT_EQ(folder.file_count(), 2u);
}

TEST(VtkhdfFile, FileWithoutSealIsReadAfterRehearsal) {
  const TemporaryFolder folder;
  write_vtkhdf(folder / "a.hdf", row_of_cubes(2));
  std::string bytes = read_text(folder / "a.hdf");
  bytes.resize(bytes.rfind("\nshellgrid seal "));
  write_raw(folder / "b.hdf", bytes);
  EXPECT_EQ(read_vtkhdf(folder / "b.hdf").types.size(), 2u);
}

TEST(VtkhdfFile, TetrahedraRoundTrip) {
  const TemporaryFolder folder;
  TetrahedralMesh mesh;
  mesh.points.resize(5, 3);
  mesh.points << 0, 0, 0, 1, 0, 0, 0, 1, 0, 0, 0, 1, 1, 1, 1.0 / 3;
  mesh.tetrahedra.resize(2, 4);
  mesh.tetrahedra << 0, 1, 2, 3, 1, 4, 2, 3;
  write_tetrahedra(folder / "t.hdf", mesh);
  const TetrahedralMesh read = read_tetrahedra(folder / "t.hdf");
  EXPECT_TRUE((read.points.array() == mesh.points.array()).all());
  EXPECT_TRUE((read.tetrahedra.array() == mesh.tetrahedra.array()).all());
  write_vtkhdf(folder / "h.hdf", row_of_cubes(1));
  EXPECT_NE(input_error_of([&] { read_tetrahedra(folder / "h.hdf"); }).find("type 12"), std::string::npos);
  EXPECT_NE(input_error_of([&] { read_polygrid(folder / "h.hdf"); }).find("not a polygrid"), std::string::npos);
}

Polygrid one_cell() {
  Polygrid p;
  p.points.resize(8, 3);
  p.points << 0, 0, 0, 1, 0, 0, 1, 1, 0, 0, 1, 0, 0, 0, 1, 1, 0, 1, 1, 1, 1, 0, 1, 1;
  p.cells.resize(1, 8);
  p.cells << 0, 1, 2, 3, 4, 5, 6, 7;
  p.cell_layer = {1};
  p.point_lattice = p.points.cast<std::int32_t>();
  p.outer_twin = {-1, -1, -1, -1, 0, 1, 2, 3};
  p.boundary_quads.resize(1, 4);
  p.boundary_quads << 4, 5, 6, 7;
  p.point_normal = p.points / 3;
  p.cell_lattice.resize(1, 3);
  p.cell_lattice << -1, 2, -3;
  p.spacing = 0.1;
  p.graph.interior.resize(1, 3);
  p.graph.interior << .5, .5, .5;
  p.graph.boundary = VertexMatrix::Random(6, 3);
  p.graph.boundary_normal = VertexMatrix::Random(6, 3);
  p.graph.boundary_owner.assign(6, 0);
  p.graph.boundary_distance.assign(6, 1.0 / 7);
  p.graph.links.resize(1, 6);
  p.graph.links << -1, -2, -3, -4, -5, -6;
  p.graph.weights.resize(1, 6);
  p.graph.weights << 1, 2, 3, 4, 5, 1.0 / 6;
  p.graph.weight_condition = {3};
  p.graph.weight_method = {2};
  return p;
}

Polygrid one_cell_on_levels() {
  Polygrid p = one_cell();
  PolygridLevel level;
  level.graph = p.graph;
  level.graph.interior << 4, 5, 1.0 / 3;
  level.lattice.resize(1, 3);
  level.lattice << -1, 0, 7;
  level.parent = {0};
  level.boundary_parent = {0, 1, 2, 3, -1, 5};
  p.hierarchy = {level, level};
  return p;
}

// Parents that are no nodes of the next level, and lists of another length.
void expect_checked_parents(Polygrid p, PolygridParts parts) {
  const TemporaryFolder folder;
  const auto complaint = [&](const std::vector<std::int32_t>& parents) {
    p.hierarchy[1].parent = parents;
    write_polygrid(folder / "p.hdf", p);
    return input_error_of([&] { read_polygrid(folder / "p.hdf", parts); });
  };
  EXPECT_NE(complaint({1}).find("hierarchy/2: the array parent holds 1"), std::string::npos);
  EXPECT_NE(complaint({0, 0}).find("expected 1×1"), std::string::npos);
}

TEST(VtkhdfFile, PolygridRoundTrip) {
  const TemporaryFolder folder;
  const Polygrid p = one_cell();
  write_polygrid(folder / "p.hdf", p);
  const Polygrid read = read_polygrid(folder / "p.hdf");
  EXPECT_TRUE((read.points.array() == p.points.array()).all());
  EXPECT_TRUE((read.cells.array() == p.cells.array()).all());
  EXPECT_EQ(read.cell_layer, p.cell_layer);
  EXPECT_TRUE((read.point_lattice.array() == p.point_lattice.array()).all());
  EXPECT_EQ(read.outer_twin, p.outer_twin);
  EXPECT_TRUE((read.boundary_quads.array() == p.boundary_quads.array()).all());
  EXPECT_TRUE((read.point_normal.array() == p.point_normal.array()).all());
  EXPECT_TRUE((read.cell_lattice.array() == p.cell_lattice.array()).all());
  EXPECT_EQ(read.spacing, p.spacing);
  EXPECT_TRUE((read.graph.interior.array() == p.graph.interior.array()).all());
  EXPECT_TRUE((read.graph.boundary.array() == p.graph.boundary.array()).all());
  EXPECT_TRUE((read.graph.boundary_normal.array() == p.graph.boundary_normal.array()).all());
  EXPECT_EQ(read.graph.boundary_owner, p.graph.boundary_owner);
  EXPECT_EQ(read.graph.boundary_distance, p.graph.boundary_distance);
  EXPECT_TRUE((read.graph.links.array() == p.graph.links.array()).all());
  EXPECT_TRUE((read.graph.weights.array() == p.graph.weights.array()).all());
  EXPECT_EQ(read.graph.weight_condition, p.graph.weight_condition);
  EXPECT_EQ(read.graph.weight_method, p.graph.weight_method);
}

TEST(VtkhdfFile, ThePolygridsHierarchyComesBackAndStandsBesideVtk) {
  const TemporaryFolder folder;
  const Polygrid p = one_cell_on_levels();
  write_polygrid(folder / "p.hdf", p);
  EXPECT_EQ(read_vtkhdf(folder / "p.hdf").find_field("lattice"), nullptr);
  const Polygrid read = read_polygrid(folder / "p.hdf");
  ASSERT_EQ(read.hierarchy.size(), 2u);
  for (int l = 0; l < 2; ++l) {
    EXPECT_EQ(read.hierarchy[l].graph.interior, p.hierarchy[l].graph.interior);
    EXPECT_EQ(read.hierarchy[l].graph.links, p.hierarchy[l].graph.links);
    EXPECT_EQ(read.hierarchy[l].graph.weights, p.hierarchy[l].graph.weights);
    EXPECT_EQ(read.hierarchy[l].lattice, p.hierarchy[l].lattice);
    EXPECT_EQ(read.hierarchy[l].parent, p.hierarchy[l].parent);
    EXPECT_EQ(read.hierarchy[l].boundary_parent, p.hierarchy[l].boundary_parent);
  }
  expect_checked_parents(p, PolygridParts::all);
}

TEST(VtkhdfFile, PolygridsCellsAreReadWithoutGraphs) {
  const TemporaryFolder folder;
  Polygrid p = one_cell_on_levels();
  p.cell_layer = {0};
  write_polygrid(folder / "p.hdf", p);
  const Polygrid read = read_polygrid(folder / "p.hdf", PolygridParts::cells);
  EXPECT_EQ(read.points, p.points);
  EXPECT_EQ(read.cells, p.cells);
  EXPECT_EQ(read.cell_layer, p.cell_layer);
  EXPECT_EQ(read.cell_lattice, p.cell_lattice);
  EXPECT_EQ(read.point_lattice, p.point_lattice);
  EXPECT_EQ(read.outer_twin, p.outer_twin);
  EXPECT_EQ(read.boundary_quads, p.boundary_quads);
  EXPECT_EQ(read.spacing, p.spacing);
  EXPECT_EQ(read.point_normal.rows(), 0);
  EXPECT_EQ(read.graph.interior.rows(), 0);
  ASSERT_EQ(read.hierarchy.size(), 2u);
  for (const PolygridLevel& coarse : read.hierarchy) {
    EXPECT_EQ(coarse.lattice, p.hierarchy[0].lattice);
    EXPECT_EQ(coarse.parent, p.hierarchy[0].parent);
    EXPECT_EQ(coarse.graph.interior.rows(), 0);
  }
  expect_checked_parents(p, PolygridParts::cells);
}

TEST(VtkhdfFile, PolygridIndicesAreChecked) {
  const TemporaryFolder folder;
  Polygrid p = one_cell();
  p.graph.links(0, 2) = -7;
  write_polygrid(folder / "p.hdf", p);
  EXPECT_NE(input_error_of([&] { read_polygrid(folder / "p.hdf"); }).find("graph_links holds -7"), std::string::npos);
  p = one_cell();
  p.outer_twin[0] = 8;
  write_polygrid(folder / "p.hdf", p);
  EXPECT_NE(input_error_of([&] { read_polygrid(folder / "p.hdf"); }).find("outer_twin holds 8"), std::string::npos);
}

TEST(VtkhdfFile, InvalidGridsAreNeverWritten) {
  const TemporaryFolder folder;
  UnstructuredGrid grid = row_of_cubes(2);
  grid.connectivity[3] = 1000;
  EXPECT_THROW(write_vtkhdf(folder / "a.hdf", grid), InternalError);
  grid = row_of_cubes(2);
  grid.point_data[0].columns = 2;
  EXPECT_THROW(write_vtkhdf(folder / "a.hdf", grid), InternalError);
  EXPECT_EQ(folder.file_count(), 0u);
}

TEST(VtkhdfFile, RefusesForeignFiles) {
  const TemporaryFolder folder;
  write_raw(folder / "empty.hdf", "");
  write_raw(folder / "foreign.hdf", std::string(3000, 'x'));
  write_raw(folder / "signature.hdf", "\x89HDF\r\n\x1a\n" + std::string(3000, 'x'));
  for (const char* name : {"empty.hdf", "foreign.hdf", "signature.hdf", "missing.hdf"})
    EXPECT_EQ(input_error_of([&] { read_vtkhdf(folder / name); }).rfind(folder / name, 0), 0u);
}

TEST(VtkhdfFile, SurvivesDamage) {
  const TemporaryFolder folder;
  UnstructuredGrid grid = row_of_cubes(3);
  grid.field_data[1] = {"links", 6, std::vector<std::int32_t>(30000, -7)};
  const std::string path = folder / "a.hdf";
  write_vtkhdf(path, grid);
  expect_survives_damage(
      path, [&] { read_vtkhdf(path); }, 40, 160);
}

TEST(VtkhdfFile, PolygridsAndTetrahedraSurviveDamage) {
  const TemporaryFolder folder;
  const std::string path = folder / "p.hdf", tetrahedra_path = folder / "t.hdf";
  write_polygrid(path, one_cell());
  expect_survives_damage(
      path, [&] { read_polygrid(path); }, 20, 120);
  expect_survives_damage(
      path, [&] { read_polygrid(path, PolygridParts::cells); }, 5, 30);
  TetrahedralMesh mesh;
  mesh.points.resize(4, 3);
  mesh.points << 0, 0, 0, 1, 0, 0, 0, 1, 0, 0, 0, 1;
  mesh.tetrahedra.resize(1, 4);
  mesh.tetrahedra << 0, 1, 2, 3;
  write_tetrahedra(tetrahedra_path, mesh);
  expect_survives_damage(
      tetrahedra_path, [&] { read_tetrahedra(tetrahedra_path); }, 20, 120);
}

}  // namespace
}  // namespace shellgrid
