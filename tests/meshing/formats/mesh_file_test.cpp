// SPDX-License-Identifier: AGPL-3.0-or-later
#include "meshing/formats/mesh_file.h"

#include <fmt/format.h>
#include <gtest/gtest.h>

#include <algorithm>
#include <cstring>
#include <limits>

#include "tests/meshing/formats/format_shapes.h"

namespace shellgrid {
namespace {

AttributedMesh coloured_octahedron() {
  AttributedMesh mesh{octahedron(), {}};
  mesh.mesh.vertices(0, 0) = 1.0 / 3.0;
  for (const char* name : {"quality", "red", "green", "blue", "texture_u"}) {
    mesh.properties.push_back({name, {}});
    for (int i = 0; i < 6; ++i) mesh.properties.back().values.push_back(static_cast<float>(10 * i + name[0] % 7));
  }
  mesh.properties[0].values[2] = 0.1f;
  mesh.properties[4].values[1] = -1e-30f;
  return mesh;
}

void expect_same(const TriangleMesh& a, const TriangleMesh& b) {
  ASSERT_EQ(a.vertex_count(), b.vertex_count());
  ASSERT_EQ(a.face_count(), b.face_count());
  EXPECT_TRUE((a.vertices.array() == b.vertices.array()).all());
  EXPECT_TRUE((a.faces.array() == b.faces.array()).all());
}

// The octahedron as a PLY file of the given order, with float coordinates.
std::string ply_bytes(bool big_endian) {
  std::string bytes = fmt::format(
      "ply\r\nformat binary_{}_endian 1.0\r\ncomment x\r\nelement vertex 6\r\nproperty float x\r\nproperty float y\r\n"
      "property float z\r\nproperty short quality\r\nelement face 8\r\nproperty uchar flags\r\n"
      "property list uint uint vertex_index\r\nend_header\n",
      big_endian ? "big" : "little");
  const auto put = [&](auto value) {
    std::string raw(sizeof value, '\0');
    std::memcpy(raw.data(), &value, sizeof value);
    if (big_endian) std::reverse(raw.begin(), raw.end());
    bytes += raw;
  };
  const TriangleMesh mesh = octahedron();
  for (int i = 0; i < 6; ++i) {
    for (int axis = 0; axis < 3; ++axis) put(static_cast<float>(mesh.vertices(i, axis)));
    put(static_cast<std::int16_t>(-300 * i));
  }
  for (int f = 0; f < 8; ++f) {
    put(std::uint8_t{7});
    put(std::uint32_t{3});
    for (int k = 0; k < 3; ++k) put(static_cast<std::uint32_t>(mesh.faces(f, k)));
  }
  return bytes;
}

TEST(MeshFile, PlyRoundTripIsLosslessAndDeterministic) {
  const TemporaryFolder folder;
  const AttributedMesh mesh = coloured_octahedron();
  write_ply(folder / "a.ply", mesh);
  const AttributedMesh read = read_mesh(folder / "a.ply");
  expect_same(mesh.mesh, read.mesh);
  ASSERT_EQ(read.properties.size(), mesh.properties.size());
  for (std::size_t p = 0; p < mesh.properties.size(); ++p) {
    EXPECT_EQ(read.properties[p].name, mesh.properties[p].name);
    EXPECT_EQ(read.properties[p].values, mesh.properties[p].values);
  }
  write_ply(folder / "b.ply", read);
  EXPECT_EQ(read_text(folder / "a.ply"), read_text(folder / "b.ply"));
}

TEST(MeshFile, ColoursAreClampedBytes) {
  const TemporaryFolder folder;
  AttributedMesh mesh{octahedron(), {{"red", {-3, 0.4f, 0.6f, 254.7f, 300, std::nanf("")}}}};
  write_ply(folder / "a.ply", mesh);
  EXPECT_NE(read_text(folder / "a.ply").find("property uchar red\n"), std::string::npos);
  EXPECT_EQ(*read_mesh(folder / "a.ply").find("red"), (std::vector<float>{0, 0, 1, 255, 255, 0}));
}

TEST(MeshFile, PointsHaveNoFaces) {
  const TemporaryFolder folder;
  write_point_ply(folder / "p.ply", octahedron().vertices, {{"quality", {1, 2, 3, 4, 5, 6}}});
  EXPECT_EQ(read_points(folder / "p.ply").mesh.vertex_count(), 6);
  EXPECT_NE(input_error_of([&] { read_mesh(folder / "p.ply"); }).find("no faces"), std::string::npos);
}

TEST(MeshFile, ReadsEveryPlyEncoding) {
  const TemporaryFolder folder;
  for (bool big_endian : {false, true}) {
    write_raw(folder / "a.ply", ply_bytes(big_endian));
    const AttributedMesh mesh = read_mesh(folder / "a.ply");
    expect_same(mesh.mesh, octahedron());
    EXPECT_EQ(mesh.find("quality")->at(5), -1500.0f);
  }
  std::string text =
      "ply\nformat ascii 1.0\nelement vertex 4\nproperty double x\nproperty double y\nproperty double z\n"
      "element face 1\nproperty list uchar int vertex_indices\nelement edge 1\nproperty int a\nend_header\n"
      "0 0 0\n1 0 0\n1 +1 0 0 1e0\n0\n4 0 1 2 3\n17\n";
  write_raw(folder / "a.ply", text);
  const AttributedMesh mesh = read_mesh(folder / "a.ply");
  EXPECT_EQ(mesh.mesh.face_count(), 2);
  EXPECT_EQ(mesh.mesh.faces(1, 2), 3);
}

TEST(MeshFile, ReadsObjWithRelativeIndicesAndTextures) {
  const TemporaryFolder folder;
  write_raw(folder / "a.obj",
            "# c\nmtllib a.mtl\nv 0 0 0\nv 1 0 0 0.5 0.5 0.5\nv 0 1 0 # x\nvt 0 0\nf 1/1 2/1/1 3//1\nv 0 0 1\n"
            "f -1 -2 -3\nf 1 2 3 4\n");
  const TriangleMesh mesh = read_mesh(folder / "a.obj").mesh;
  FaceMatrix faces(4, 3);
  faces << 0, 1, 2, 3, 2, 1, 0, 1, 2, 0, 2, 3;
  EXPECT_TRUE((mesh.faces.array() == faces.array()).all());
  EXPECT_EQ(mesh.vertices(3, 2), 1.0);
}

TEST(MeshFile, ReadsOffVariants) {
  const TemporaryFolder folder;
  const std::string body = "0 0 0\n1 0 0\n\n# c\n0 1 0\n3 0 1 2\n";
  for (const char* header : {"OFF\n3 1 0\n", "OFF 3 1 0\n", "# c\nOFF\n\n3 1\n", "COFF\n3 1 0\n"}) {
    write_raw(folder / "a.off", std::string(header) + body);
    EXPECT_EQ(read_mesh(folder / "a.off").mesh.face_count(), 1) << header;
  }
}

TEST(MeshFile, StlCornersAreMerged) {
  const TemporaryFolder folder;
  const TriangleMesh mesh = octahedron();
  std::string binary(80, ' '), ascii = "solid a b\n";
  const auto put = [&](auto value) { binary.append(reinterpret_cast<const char*>(&value), sizeof value); };
  put(std::uint32_t{8});
  for (int f = 0; f < 8; ++f) {
    ascii += "facet normal 0 0 0\nouter loop\n";
    for (int k = 0; k < 3; ++k) put(0.0f);
    for (int k = 0; k < 3; ++k) {
      for (int axis = 0; axis < 3; ++axis) put(static_cast<float>(mesh.corner(f, k)[axis]));
      const Vec3 p = mesh.corner(f, k);
      // −0 and 0 are one coordinate.
      ascii += fmt::format("vertex {} {} {}\n", p.x(), p.y() == 0 && f % 2 ? -0.0 : p.y(), p.z());
    }
    put(std::uint16_t{0});
    ascii += "endloop\nendfacet\n";
  }
  write_raw(folder / "b.stl", binary);
  write_raw(folder / "a.stl", ascii + "endsolid a b\n");
  for (const char* name : {"a.stl", "b.stl"}) {
    const TriangleMesh read = read_mesh(folder / name).mesh;
    EXPECT_EQ(read.vertex_count(), 6);
    ASSERT_EQ(read.face_count(), 8);
    for (int f = 0; f < 8; ++f)
      for (int k = 0; k < 3; ++k) EXPECT_EQ(read.corner(f, k), mesh.corner(f, k));
  }
  binary.replace(0, 5, "solid");  // some writers do
  write_raw(folder / "b.stl", binary);
  EXPECT_EQ(read_mesh(folder / "b.stl").mesh.face_count(), 8);
}

struct BadMesh {
  const char* name;
  std::string bytes;
  const char* expected;
};

TEST(MeshFile, RefusesBadFilesWithOneLineThatSaysWhatIsWrong) {
  const TemporaryFolder folder;
  const std::string header =
      "ply\nformat ascii 1.0\nelement vertex 3\nproperty float x\nproperty float y\nproperty float z\n"
      "element face 1\nproperty list uchar int vertex_indices\nend_header\n";
  const std::string promising =
      "ply\nformat binary_little_endian 1.0\nelement vertex 4000000000\nproperty float x\nproperty float y\n"
      "property float z\nelement face 1\nproperty list uchar int vertex_indices\nend_header\nxxxx";
  std::string stl(84, ' ');
  stl.replace(80, 4, "\xff\xff\xff\xff");
  const std::vector<BadMesh> cases{
      {"empty.ply", "", "empty"},
      {"empty.obj", "", "empty"},
      {"empty.off", "", "empty"},
      {"empty.stl", "", "empty"},
      {"comment.obj", "# nothing\n", "no vertices"},
      {"blank.off", "\n\n", "no OFF header"},
      {"promise.ply", promising, "promises 4000000000"},
      {"promise.off", "OFF\n4000000000 1 0\n0 0 0\n", "promises 4000000000"},
      {"promise.stl", stl, "promises 4294967295"},
      {"nan.ply", header + "0 0 0\n1 nan 0\n0 1 0\n3 0 1 2\n", "vertex 1 has a coordinate that is not finite"},
      {"inf.obj", "v 0 0 inf\n", "not finite"},
      {"huge.obj", "v 0 0 1e999\n", "not a number"},
      {"index.ply", header + "0 0 0\n1 0 0\n0 1 0\n3 0 1 3\n", "face 0 has the vertex index 3"},
      {"negative.ply", header + "0 0 0\n1 0 0\n0 1 0\n3 0 1 -1\n", "out of range"},
      {"index.off", "OFF\n3 1 0\n0 0 0\n1 0 0\n0 1 0\n3 0 1 7\n", "vertex index 7"},
      {"index.obj", "v 0 0 0\nv 1 0 0\nv 0 1 0\nf 1 2 -4\n", "vertex index -4"},
      {"zero.obj", "v 0 0 0\nv 1 0 0\nv 0 1 0\nf 0 1 2\n", "not a face corner"},
      {"corners.ply", header + "0 0 0\n1 0 0\n0 1 0\n2 0 1\n", "face 0 has 2 corners"},
      {"word.ply", header + "0 0 0\n1 x 0\n0 1 0\n3 0 1 2\n", "'x' is not a number"},
      {"short.ply", header + "0 0 0\n1 0 0\n0 1 0\n3 0 1\n", "truncated"},
      {"header.ply", header.substr(0, 54), "truncated"},
      {"foreign.ply", "hello\n", "not a PLY file"},
      {"foreign.off", "ply\n", "not an OFF file"},
      {"type.ply", "ply\nformat ascii 1.0\nelement vertex 1\nproperty quad x\nend_header\n", "unknown type 'quad'"},
      {"axes.ply", "ply\nformat ascii 1.0\nelement vertex 1\nproperty float x\nend_header\n1\n", "no x, y and z"},
      {"none.ply", "ply\nformat ascii 1.0\nelement vertex 9\nend_header\n1\n", "no properties"},
      {"format.ply", "ply\nelement vertex 0\nend_header\n", "no format"},
      {"cut.stl", "solid a\nfacet normal 0 0 1\nouter loop\nvertex 0 0 0\n", "truncated"},
      {"cut.off", "OFF\n3 1 0\n0 0 0\n1 0 0 0 0 0 0 0 0\n", "truncated"},
      {"x.txt", "v 0 0 0\n", "unknown mesh format"},
  };
  for (const BadMesh& bad : cases) {
    const std::string path = folder / bad.name;
    write_raw(path, bad.bytes);
    const std::string message = input_error_of([&] { read_mesh(path); });
    EXPECT_EQ(message.rfind(path + ": ", 0), 0u) << message;
    EXPECT_NE(message.find(bad.expected), std::string::npos) << message;
    EXPECT_EQ(message.find('\n'), std::string::npos) << message;
  }
}

TEST(MeshFile, SurvivesDamage) {
  const TemporaryFolder folder;
  write_ply(folder / "a.ply", coloured_octahedron());
  write_raw(folder / "b.ply", ply_bytes(true));
  std::string off = "OFF\n6 8 0\n", obj;
  const TriangleMesh mesh = octahedron();
  for (int i = 0; i < 6; ++i) {
    const std::string line = fmt::format("{} {} {}\n", mesh.vertices(i, 0), mesh.vertices(i, 1), mesh.vertices(i, 2));
    off += line, obj += "v " + line;
  }
  for (int f = 0; f < 8; ++f) {
    off += fmt::format("3 {} {} {}\n", mesh.faces(f, 0), mesh.faces(f, 1), mesh.faces(f, 2));
    obj += fmt::format("f {} {} {}\n", mesh.faces(f, 0) + 1, mesh.faces(f, 1) + 1, mesh.faces(f, 2) + 1);
  }
  write_raw(folder / "c.off", off);
  write_raw(folder / "d.obj", obj);
  write_raw(folder / "e.stl",
            "solid a\nfacet normal 0 0 1\nouter loop\nvertex 0 0 0\nvertex 1 0 0\nvertex 0 1 0\nendloop\nendfacet\n"
            "endsolid a\n");
  std::string stl(80, ' ');
  const auto put = [&](auto value) { stl.append(reinterpret_cast<const char*>(&value), sizeof value); };
  put(std::uint32_t{8});
  for (int f = 0; f < 8; ++f) {
    for (int k = 0; k < 4; ++k)
      for (int axis = 0; axis < 3; ++axis) put(k == 0 ? 0.0f : static_cast<float>(mesh.corner(f, k - 1)[axis]));
    put(std::uint16_t{0});
  }
  write_raw(folder / "f.stl", stl);
  for (const char* name : {"a.ply", "b.ply", "c.off", "d.obj", "e.stl", "f.stl"}) {
    const std::string path = folder / name;
    expect_survives_damage(
        path, [&] { read_mesh(path); }, 150, 600);
  }
}

}  // namespace
}  // namespace shellgrid
