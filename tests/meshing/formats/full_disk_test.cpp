// SPDX-License-Identifier: AGPL-3.0-or-later
#include <gtest/gtest.h>
#include <signal.h>
#include <sys/resource.h>

#include <functional>
#include <map>

#include "meshing/formats/image_file.h"
#include "meshing/formats/mesh_file.h"
#include "meshing/formats/vdb_file.h"
#include "meshing/formats/vtkhdf_file.h"
#include "tests/meshing/formats/format_shapes.h"

namespace shellgrid {
namespace {

// While it lives, files cannot grow beyond `bytes`, as on a full disk.
class SmallFiles {
 public:
  explicit SmallFiles(rlim_t bytes) : handler_(::signal(SIGXFSZ, SIG_IGN)) {
    ::getrlimit(RLIMIT_FSIZE, &before_);
    const rlimit small{bytes, before_.rlim_max};
    ::setrlimit(RLIMIT_FSIZE, &small);
  }
  ~SmallFiles() {
    ::setrlimit(RLIMIT_FSIZE, &before_);
    ::signal(SIGXFSZ, handler_);
  }

 private:
  rlimit before_;
  void (*handler_)(int);
};

TEST(FullDisk, EveryWriterThrowsInputErrorAndLeavesTheOldFile) {
  const TemporaryFolder folder;
  AttributedMesh mesh{octahedron(), {}};
  TetrahedralMesh tets;
  tets.points = VertexMatrix::Random(500, 3);
  tets.tetrahedra.resize(1, 4);
  tets.tetrahedra << 0, 1, 2, 3;
  VdbArchive archive;
  TwoLevelGrid<float> grid(Vec3i::Zero(), Vec3i::Ones(), 0.0f);
  for (int n = 0; n < 512; ++n) grid.set(n >> 6, n >> 3 & 7, n & 7, static_cast<float>(n * n));
  archive.grids = {{"x", grid}};
  Image image;
  image.width = image.height = 64;
  std::vector<float>& red = image.add("R").values;
  for (std::size_t i = 0; i < red.size(); ++i) red[i] = 1 / static_cast<float>(i + 1);
  std::vector<std::uint8_t> rgb(64 * 64 * 3);
  for (std::size_t i = 0; i < rgb.size(); ++i) rgb[i] = static_cast<std::uint8_t>(i * i * i >> 5);
  const std::map<std::string, std::function<void(const std::string&)>> writers{
      {"a.ply", [&](const std::string& path) { write_ply(path, mesh); }},
      {"a.hdf", [&](const std::string& path) { write_tetrahedra(path, tets); }},
      {"a.vdb", [&](const std::string& path) { write_vdb(path, archive); }},
      {"a.exr", [&](const std::string& path) { write_exr(path, image); }},
      {"a.png", [&](const std::string& path) { write_png(path, 64, 64, rgb); }},
  };
  for (const auto& [name, write] : writers) {
    const std::string path = folder / name;
    write_raw(path, "old");
    std::string message;
    {
      const SmallFiles limit(100);
      message = input_error_of([&] { write(path); });
    }
    EXPECT_EQ(message.rfind(path + ": cannot be written: ", 0), 0u) << message;
    EXPECT_EQ(read_text(path), "old");
    write(path);
    EXPECT_NE(read_text(path), "old");
  }
  EXPECT_EQ(folder.file_count(), writers.size());
}

}  // namespace
}  // namespace shellgrid
