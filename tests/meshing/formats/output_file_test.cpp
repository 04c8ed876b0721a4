// SPDX-License-Identifier: AGPL-3.0-or-later
#include "meshing/formats/output_file.h"

#include <gtest/gtest.h>
#include <sys/stat.h>

#include <chrono>
#include <filesystem>

#include "meshing/formats/output_set.h"
#include "tests/meshing/formats/format_shapes.h"

namespace shellgrid {
namespace {

namespace fs = std::filesystem;

TEST(OutputFile, LeavesTheOldFileAndNoTemporaryWhereWritingFails) {
  const TemporaryFolder folder;
  write_raw(folder / "a.ply", "old");
  EXPECT_THROW(write_atomically(folder / "a.ply",
                                [](const std::string& temporary) {
                                  write_raw(temporary, "half");
                                  throw InputError("stop");
                                }),
               InputError);
  EXPECT_EQ(read_text(folder / "a.ply"), "old");
  EXPECT_EQ(folder.file_count(), 1u);
}

TEST(OutputFile, TemporaryLiesBesideWithTheSameExtension) {
  const TemporaryFolder folder;
  write_atomically(folder / "a.hdf", [&](const std::string& temporary) {
    EXPECT_EQ(fs::path(temporary).parent_path(), fs::path(folder / "x").parent_path());
    EXPECT_EQ(fs::path(temporary).extension(), ".hdf");
    EXPECT_NE(temporary, folder / "a.hdf");
    EXPECT_FALSE(fs::exists(folder / "a.hdf"));
    write_raw(temporary, "x");
  });
  EXPECT_EQ(read_text(folder / "a.hdf"), "x");
  EXPECT_EQ(folder.file_count(), 1u);
}

TEST(OutputFile, EqualBytesKeepTheTimeAndOtherBytesChangeIt) {
  const TemporaryFolder folder;
  const std::string path = folder / "a.txt";
  write_text_atomically(path, "same");
  const auto old_time = fs::last_write_time(path) - std::chrono::hours(1);
  fs::last_write_time(path, old_time);
  write_text_atomically(path, "same");
  EXPECT_EQ(fs::last_write_time(path), old_time);
  write_text_atomically(path, "diff");
  EXPECT_NE(fs::last_write_time(path), old_time);
  EXPECT_EQ(read_text(path), "diff");
}

TEST(OutputSet, AppearsTogetherOrNotAtAll) {
  const TemporaryFolder folder;
  write_raw(folder / "a.txt", "old");
  {
    OutputSet set;
    write_text_atomically(folder / "a.txt", "new");
    write_text_atomically(folder / "b.txt", "first");
    write_text_atomically(folder / "b.txt", "second");
    EXPECT_EQ(read_text(folder / "a.txt"), "old");
    EXPECT_FALSE(fs::exists(folder / "b.txt"));
    EXPECT_EQ(read_text(OutputSet::present_path(folder / "a.txt")), "new");
    EXPECT_EQ(OutputSet::present_path(folder / "c.txt"), folder / "c.txt");
    EXPECT_THROW(OutputSet(), InternalError);
    {
      const OutputSet::Aside at_once;
      write_text_atomically(folder / "state.txt", "kept");
    }
    EXPECT_EQ(read_text(folder / "state.txt"), "kept");
  }
  EXPECT_EQ(read_text(folder / "a.txt"), "old");
  EXPECT_EQ(folder.file_count(), 2u);
  OutputSet set;
  fs::create_symlink("a.txt", folder / "link.txt");
  write_text_atomically(folder / "link.txt", "new");
  write_text_atomically(folder / "b.txt", "second");
  set.publish();
  EXPECT_EQ(read_text(folder / "a.txt"), "new");
  EXPECT_EQ(read_text(folder / "b.txt"), "second");
  EXPECT_TRUE(fs::is_symlink(folder / "link.txt"));
  EXPECT_EQ(folder.file_count(), 4u);
}

TEST(OutputSet, EqualBytesKeepTheTime) {
  const TemporaryFolder folder;
  const std::string path = folder / "a.txt";
  write_text_atomically(path, "same");
  const auto old_time = fs::last_write_time(path) - std::chrono::hours(1);
  fs::last_write_time(path, old_time);
  OutputSet set;
  write_text_atomically(path, "same");
  set.publish();
  EXPECT_EQ(fs::last_write_time(path), old_time);
  EXPECT_EQ(folder.file_count(), 1u);
}

TEST(OutputFile, RefusesFoldersDevicesAndMissingFolders) {
  const TemporaryFolder folder;
  EXPECT_NE(input_error_of([&] { write_text_atomically(folder / "none/a.txt", "x"); }).find("there is no folder"),
            std::string::npos);
  fs::create_directory(folder / "sub");
  EXPECT_THROW(write_text_atomically(folder / "sub", "x"), InputError);
  EXPECT_THROW(write_text_atomically("/dev/full", "x"), InputError);
  EXPECT_THROW(write_text_atomically("", "x"), InputError);
  EXPECT_THROW(read_text(folder / "sub"), InputError);
  EXPECT_THROW(read_text(folder / "missing"), InputError);
  EXPECT_THROW(hash_file(folder / "missing"), InputError);
  ASSERT_EQ(::mkfifo((folder / "pipe").c_str(), 0600), 0);
  EXPECT_THROW(read_text(folder / "pipe"), InputError);
  EXPECT_THROW(write_text_atomically(folder / "pipe", "x"), InputError);
}

TEST(OutputFile, RemovesTheTemporariesOfDeadProcessesOnly) {
  const TemporaryFolder folder;
  // Process numbers end below 2^22.
  write_raw(folder / ".a.partial-99999999-0.ply", "dead");
  write_raw(folder / (".a.partial-" + std::to_string(::getpid()) + "-77.ply"), "alive");
  // Killed, but not waited for: it still has a number.
  const pid_t zombie = ::fork();
  if (zombie == 0) ::_exit(0);
  siginfo_t ended{};
  ASSERT_EQ(::waitid(P_PID, static_cast<id_t>(zombie), &ended, WEXITED | WNOWAIT), 0);
  const std::string left = ".a.partial-" + std::to_string(zombie) + "-0.ply";
  write_raw(folder / left, "dead, too");
  write_raw(folder / ".b.partial-99999999-0.ply", "another file's");
  write_text_atomically(folder / "a.ply", "x");
  EXPECT_FALSE(fs::exists(folder / ".a.partial-99999999-0.ply"));
  EXPECT_FALSE(fs::exists(folder / left));
  ::waitpid(zombie, nullptr, 0);
  EXPECT_EQ(folder.file_count(), 3u);
}

TEST(OutputFile, WritesThroughASymbolicLink) {
  const TemporaryFolder folder;
  write_raw(folder / "target.txt", "old");
  fs::create_symlink("target.txt", folder / "link.txt");
  write_text_atomically(folder / "link.txt", "new");
  EXPECT_TRUE(fs::is_symlink(folder / "link.txt"));
  EXPECT_EQ(read_text(folder / "target.txt"), "new");
}

// Published values of XXH64 with seed 0.
TEST(OutputFile, HashIsXxh64) {
  const TemporaryFolder folder;
  write_raw(folder / "empty", "");
  write_raw(folder / "abc", "abc");
  EXPECT_EQ(hash_file(folder / "empty"), "ef46db3751d8e999");
  EXPECT_EQ(hash_file(folder / "abc"), "44bc2cf5ad770999");
  EXPECT_EQ(file_size(folder / "abc"), 3u);
}

TEST(OutputFile, NamesAreData) {
  const TemporaryFolder folder;
  for (const char* name : {"$(shell touch x).ply", "a b.ply", "#.ply", "no extension", ".hidden", "a\nb.ply"}) {
    write_text_atomically(folder / name, name);
    EXPECT_EQ(read_text(folder / name), name);
  }
  EXPECT_EQ(folder.file_count(), 6u);
}

}  // namespace
}  // namespace shellgrid
