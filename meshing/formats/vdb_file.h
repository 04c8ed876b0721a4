// SPDX-License-Identifier: AGPL-3.0-or-later
#pragma once
#include <map>
#include <string>
#include <variant>
#include <vector>

#include "meshing/core/grid_frame.h"
#include "meshing/distance/distance_field.h"
#include "meshing/shell/shell_volume.h"
#include "meshing/shell/two_level_grid.h"

namespace shellgrid {

using AnyGrid = std::variant<TwoLevelGrid<float>, TwoLevelGrid<std::int32_t>, TwoLevelGrid<Vec3f>>;

// What one .vdb file holds: named grids in one frame, and metadata as text (numbers and vectors are
// written with enough digits to come back exactly).
struct VdbArchive {
  struct Entry {
    std::string name;
    AnyGrid grid;
  };
  GridFrame frame;
  std::vector<Entry> grids;
  std::map<std::string, std::string> metadata;
  std::string path;  // where it was read from, for messages

  // Throws: InputError "PATH: no grid NAME of that type" where it is missing.
  template <class T>
  const TwoLevelGrid<T>& get(const std::string& name) const;
  // Metadata as finite numbers separated by blanks, digits enough to come back exactly. Throws: InputError where they
  // are missing or malformed.
  double number(const std::string& key) const;
  std::vector<double> numbers(const std::string& key, std::size_t count) const;
  void set_numbers(const std::string& key, const std::vector<double>& values);
};

// Reads every float, int32 and vec3s grid of an OpenVDB file; other grids are skipped. Files that
// this project did not write are validated in a child process with limits first, because the library
// may crash on corrupt ones.
// Throws: InputError for a missing, empty, truncated or corrupt file, one that is not OpenVDB, a
// transform that is not uniform scale and translation.
// wanted: names of the grids to read, where they are there; empty: all of them.
VdbArchive read_vdb(const std::string& path, const std::vector<std::string>& wanted = {});
// The same without the grids' samples: their names, types, frame, and the metadata.
VdbArchive read_vdb_outline(const std::string& path);
// Whether the file is as write_vdb left it, not saved anew by another program since. Throws: InputError.
bool is_as_written(const std::string& path);

// Writes an OpenVDB file whose leaves are the grids' leaves. Same grids, same bytes: the file's id is
// a hash of its content. Written atomically.
void write_vdb(const std::string& path, const VdbArchive& archive);

DistanceField read_distance_field(const std::string& path);
void write_distance_field(const std::string& path, const DistanceField& field);
// matter: where its voxels are, and what; all: and the normals.
enum class ShellParts { matter, all };
// notes: what the file's metadata say beside the shell.
ShellVolume read_shell_volume(const std::string& path, ShellParts parts = ShellParts::all,
                              std::map<std::string, std::string>* notes = nullptr);
void write_shell_volume(const std::string& path, const ShellVolume& shell,
                        const std::map<std::string, std::string>& notes = {});

// The isosurface of a float grid as a closed triangle mesh, by OpenVDB's volumeToMesh.
TriangleMesh extract_isosurface(const TwoLevelGrid<float>& grid, const GridFrame& frame, double isovalue);

}  // namespace shellgrid
