// SPDX-License-Identifier: AGPL-3.0-or-later
// The only file that includes OpenVDB.
#include "meshing/formats/vdb_file.h"

#include <fmt/format.h>
#include <oneapi/tbb/enumerable_thread_specific.h>
#include <openvdb/io/Archive.h>
#include <openvdb/io/File.h>
#include <openvdb/io/io.h>
#include <openvdb/openvdb.h>
#include <openvdb/tools/SignedFloodFill.h>
#include <openvdb/tools/VolumeToMesh.h>
#include <openvdb/util/logging.h>

#include <algorithm>
#include <cmath>
#include <cstdio>
#include <cstdlib>
#include <limits>
#include <new>
#include <sstream>
#include <system_error>
#include <type_traits>

#include "meshing/core/error.h"
#include "meshing/core/guarded_child.h"
#include "meshing/core/parallel.h"
#include "meshing/formats/output_file.h"
#include "meshing/formats/untrusted_file.h"

namespace shellgrid {
namespace {

// The file's header: magic number, versions, a flag, then the id as 36 characters, then the content.
constexpr std::size_t id_at = 8 + 4 + 8 + 1;
constexpr std::size_t id_size = 36;
// Of the dense top array, in leaves.
constexpr double most_top_cells = double{1 << 28};
// Bounds what making leaves of tiles may allocate.
constexpr openvdb::Index64 most_tile_voxels = openvdb::Index64{1} << 28;

// Grid metadata: "voxel x y z".
constexpr const char* frame_note = "shellgrid_frame";

template <class T>
struct VdbGridOf;
template <>
struct VdbGridOf<float> {
  using Type = openvdb::FloatGrid;
};
template <>
struct VdbGridOf<std::int32_t> {
  using Type = openvdb::Int32Grid;
};
template <>
struct VdbGridOf<Vec3f> {
  using Type = openvdb::Vec3SGrid;
};

template <class T>
auto to_vdb(const T& value) {
  if constexpr (std::is_same_v<T, Vec3f>)
    return openvdb::Vec3s(value.x(), value.y(), value.z());
  else
    return value;
}

template <class V>
auto from_vdb(const V& value) {
  if constexpr (std::is_same_v<V, openvdb::Vec3s>)
    return Vec3f(value.x(), value.y(), value.z());
  else
    return value;
}

// Gives access to the writer for any stream.
class StreamArchive : public openvdb::io::Archive {
 public:
  std::string encode(const openvdb::GridCPtrVec& grids, const openvdb::MetaMap& metadata) const {
    std::ostringstream stream(std::ios::binary);
    openvdb::io::Archive::write(stream, grids, /*seekable=*/true, metadata);
    if (!stream) throw std::bad_alloc();  // a stream into memory fails for no other reason
    return std::move(stream).str();
  }
};

void initialize_library() {
  static const bool once = [] {
    openvdb::initialize();
    openvdb::logging::setLevel(openvdb::logging::Level::Fatal);
    return true;
  }();
  (void)once;
}

std::string id_of(std::string id) {
  for (std::size_t at : {8, 13, 18, 23}) id.insert(at, "-");
  return id;
}

std::string id_of_content(const std::string& bytes) {
  const std::string_view all = bytes;
  return id_of(seal_of(all.substr(0, id_at), all.substr(id_at + id_size)));
}

// head: the file's first bytes.
bool has_valid_seal(const std::string& path, const std::string& head) {
  return head.size() == id_at + id_size && head.compare(id_at, id_size, id_of(seal_of_file(path, id_at, id_size))) == 0;
}

openvdb::math::Transform::Ptr transform_of(const GridFrame& frame) {
  constexpr double least_voxel = 1.5e-5;  // OpenVDB takes a volume below 3e-15 for zero
  if (!(frame.voxel >= least_voxel))
    throw InputError(fmt::format("a voxel of {} mm is too small for an OpenVDB file; expected {} mm at least",
                                 frame.voxel, least_voxel));
  const openvdb::Vec3d origin(frame.origin.x(), frame.origin.y(), frame.origin.z());
  return std::make_shared<openvdb::math::Transform>(
      openvdb::math::MapBase::Ptr(new openvdb::math::UniformScaleTranslateMap(frame.voxel, origin)));
}

GridFrame frame_of(const std::string& path, const openvdb::GridBase& grid) {
  const auto fail = [&] {
    throw InputError(
        fmt::format("{}: the transform of the grid '{}' is not uniform scale and translation", path, grid.getName()));
  };
  if (!grid.transform().isLinear()) fail();
  const openvdb::Mat4R matrix = grid.transform().baseMap()->getAffineMap()->getMat4();
  GridFrame frame;
  frame.voxel = grid.voxelSize().x();
  if (!(frame.voxel > 0) || !std::isfinite(frame.voxel)) fail();
  for (int row = 0; row < 3; ++row) {
    for (int column = 0; column < 3; ++column) {
      const double expected = row == column ? frame.voxel : 0;
      if (!(std::abs(matrix(row, column) - expected) <= 1e-9 * frame.voxel)) fail();
    }
    frame.origin[row] = matrix(3, row);
    if (!std::isfinite(frame.origin[row])) fail();
  }
  // OpenVDB rounds the transform when it writes: our own note of the frame is exact.
  const auto note = grid.getMetadata<openvdb::StringMetadata>(frame_note);
  GridFrame exact;
  if (note && std::sscanf(note->value().c_str(), "%lf %lf %lf %lf", &exact.voxel, &exact.origin[0], &exact.origin[1],
                          &exact.origin[2]) == 4) {
    const double tolerance = 1e-9 * (frame.voxel + frame.origin.norm());
    if (std::abs(exact.voxel - frame.voxel) <= tolerance && (exact.origin - frame.origin).norm() <= tolerance)
      return exact;
  }
  return frame;
}

template <class T>
typename VdbGridOf<T>::Type::Ptr to_vdb_grid(const TwoLevelGrid<T>& grid, const GridFrame& frame) {
  using Grid = typename VdbGridOf<T>::Type;
  using Leaf = typename Grid::TreeType::LeafNodeType;
  auto result = Grid::create(to_vdb(grid.background()));
  result->setTransform(transform_of(frame));
  result->insertMeta(frame_note, openvdb::StringMetadata(fmt::format("{} {} {} {}", frame.voxel, frame.origin.x(),
                                                                     frame.origin.y(), frame.origin.z())));
  for (int leaf_index = 0; leaf_index < grid.leaf_count(); ++leaf_index) {
    const Vec3i base = grid.leaf_coordinate(leaf_index) * TwoLevelGrid<T>::leaf_edge;
    auto* leaf = new Leaf(openvdb::Coord(base.x(), base.y(), base.z()), to_vdb(grid.background()), false);
    const T* from = grid.leaf_values(leaf_index);
    auto* to = leaf->buffer().data();
    for (int n = 0; n < TwoLevelGrid<T>::leaf_size; ++n) to[n] = to_vdb(from[n]);
    typename Leaf::NodeMaskType mask;
    for (int word = 0; word < 8; ++word)
      mask.template getWord<openvdb::Index64>(static_cast<openvdb::Index>(word)) =
          grid.leaf_mask(leaf_index)[static_cast<std::size_t>(word)];
    leaf->setValueMask(mask);
    result->tree().addLeaf(leaf);
  }
  return result;
}

// Tiles become leaves where they are active or hold another value than the background, as inside a level set: every
// voxel keeps its value and its state.
template <class T>
TwoLevelGrid<T> from_vdb_grid(const std::string& path, const typename VdbGridOf<T>::Type& grid) {
  using Tree = typename VdbGridOf<T>::Type::TreeType;
  using Leaf = typename Tree::LeafNodeType;
  constexpr int edge = TwoLevelGrid<T>::leaf_edge;
  const T background = from_vdb(grid.background());
  struct Piece {
    openvdb::Coord origin;
    const Leaf* leaf;  // or none, in a tile
    T value;
    bool active;
  };
  std::vector<Piece> pieces;
  for (auto it = grid.tree().cbeginLeaf(); it; ++it) pieces.push_back({it->origin(), &*it, background, false});
  auto tiles = grid.tree().cbeginValueAll();
  tiles.setMaxDepth(Tree::ValueAllCIter::LEAF_DEPTH - 1);
  openvdb::Index64 voxels = 0;
  for (; tiles; ++tiles) {
    const T value = from_vdb(tiles.getValue());
    if (!tiles.isValueOn() && value == background) continue;
    voxels += tiles.getVoxelCount();
    if (voxels > most_tile_voxels)
      throw InputError(fmt::format("{}: the tiles of the grid '{}' hold more than 2^28 voxels", path, grid.getName()));
    const openvdb::CoordBBox box = tiles.getBoundingBox();
    for (int x = box.min().x(); x <= box.max().x() - (edge - 1); x += edge)
      for (int y = box.min().y(); y <= box.max().y() - (edge - 1); y += edge)
        for (int z = box.min().z(); z <= box.max().z() - (edge - 1); z += edge)
          pieces.push_back({openvdb::Coord(x, y, z), nullptr, value, tiles.isValueOn()});
  }
  std::sort(pieces.begin(), pieces.end(), [](const Piece& a, const Piece& b) { return a.origin < b.origin; });
  if (pieces.empty()) return TwoLevelGrid<T>(Vec3i::Zero(), Vec3i::Zero(), background);
  Vec3i lower = Vec3i::Constant(std::numeric_limits<int>::max()),
        upper = Vec3i::Constant(std::numeric_limits<int>::min());
  const auto leaf_coordinate = [](const Piece& piece) {
    return Vec3i(piece.origin.x() >> 3, piece.origin.y() >> 3, piece.origin.z() >> 3);
  };
  for (const Piece& piece : pieces) {
    lower = lower.cwiseMin(leaf_coordinate(piece));
    upper = upper.cwiseMax(leaf_coordinate(piece));
  }
  const Vec3 counts = (upper.cast<double>() - lower.cast<double>()).array() + 1;
  if (counts.prod() > most_top_cells)
    throw InputError(fmt::format("{}: the grid '{}' spans {:.0f}×{:.0f}×{:.0f} leaves, too many for a dense top array",
                                 path, grid.getName(), counts.x(), counts.y(), counts.z()));
  TwoLevelGrid<T> result(lower, upper - lower + Vec3i::Ones(), background);
  std::vector<Vec3i> leaves;
  leaves.reserve(pieces.size());
  for (const Piece& piece : pieces) leaves.push_back(leaf_coordinate(piece));
  result.allocate_leaves(leaves);
  for (const Piece& piece : pieces) {
    const int leaf_index = result.find_leaf(leaf_coordinate(piece));
    T* to = result.leaf_values(leaf_index);
    typename TwoLevelGrid<T>::Mask& mask = result.leaf_mask(leaf_index);
    if (!piece.leaf) {
      std::fill_n(to, TwoLevelGrid<T>::leaf_size, piece.value);
      mask.fill(piece.active ? ~std::uint64_t{0} : 0);
      continue;
    }
    const auto* from = piece.leaf->buffer().data();
    for (int n = 0; n < TwoLevelGrid<T>::leaf_size; ++n) to[n] = from_vdb(from[n]);
    for (int word = 0; word < 8; ++word)
      mask[static_cast<std::size_t>(word)] =
          piece.leaf->getValueMask().template getWord<openvdb::Index64>(static_cast<openvdb::Index>(word));
  }
  return result;
}

// Adds the grid to the archive if it is of type T.
template <class T>
bool take(const std::string& path, const openvdb::GridBase::Ptr& grid, VdbArchive& archive) {
  const auto typed = openvdb::gridPtrCast<typename VdbGridOf<T>::Type>(grid);
  if (!typed) return false;
  archive.grids.push_back({grid->getName(), from_vdb_grid<T>(path, *typed)});
  return true;
}

// Blosc, which unpacks for OpenVDB, crashes where an allocation fails: what it may need must be there beforehand.
void require_memory_for(const std::string& path) {
  constexpr std::size_t least = std::size_t{16} << 20;
  const std::unique_ptr<char[]> probe(new char[least + 2 * file_size(path)]);
  volatile char* kept = probe.get();  // or the compiler may leave the allocation out
  kept[0] = 0;
}

// Whether several threads may read: not so in a forked child, which has but one. outline: without samples.
enum class Reading { at_once, one_by_one, outline };

// The grids of these names, each read by itself, as entries in their order; those of other types are left empty.
void read_grids(const std::string& path, const std::vector<std::string>& names, Reading reading, VdbArchive& archive) {
  std::vector<VdbArchive> read(names.size());
  const auto read_one = [&](openvdb::io::File& file, std::size_t n) {
    openvdb::GridBase::Ptr grid;
    {
      const ForeignCode foreign;
      grid = reading == Reading::outline ? file.readGridMetadata(names[n]) : file.readGrid(names[n]);
    }
    if (!grid || (!take<float>(path, grid, read[n]) && !take<std::int32_t>(path, grid, read[n]) &&
                  !take<Vec3f>(path, grid, read[n])))
      return;
    read[n].frame = frame_of(path, *grid);
  };
  const auto opened = [&] {
    const ForeignCode foreign;
    auto file = std::make_unique<openvdb::io::File>(path);
    file->open(/*delayLoad=*/false);
    return file;
  };
  if (reading != Reading::at_once) {
    const auto file = opened();
    for (std::size_t n = 0; n < names.size(); ++n) read_one(*file, n);
  } else {
    oneapi::tbb::enumerable_thread_specific<std::unique_ptr<openvdb::io::File>> files(opened);
    parallel_for(
        names.size(), [&](std::size_t n) { read_one(*files.local(), n); }, 1);
  }
  for (VdbArchive& one : read) {
    if (one.grids.empty()) continue;
    if (!archive.grids.empty() && (one.frame.voxel != archive.frame.voxel || one.frame.origin != archive.frame.origin))
      throw InputError(fmt::format("{}: the grid '{}' lies in another frame than '{}'", path, one.grids.front().name,
                                   archive.grids.front().name));
    archive.frame = one.frame;
    archive.grids.push_back(std::move(one.grids.front()));
  }
}

VdbArchive parse(const std::string& path, const std::vector<std::string>& wanted, Reading reading) {
  require_memory_for(path);
  VdbArchive archive;
  try {
    openvdb::MetaMap::Ptr metadata;
    std::vector<std::string> names;
    {
      const ForeignCode foreign;
      openvdb::io::File file(path);
      file.open(/*delayLoad=*/false);
      metadata = file.getMetadata();
      for (auto name = file.beginName(); name != file.endName(); ++name) names.push_back(*name);
    }
    if (!wanted.empty())
      std::erase_if(names, [&](const std::string& name) { return std::ranges::find(wanted, name) == wanted.end(); });
    for (auto it = metadata->beginMeta(); it != metadata->endMeta(); ++it)
      archive.metadata[it->first] = it->second ? it->second->str() : std::string();
    read_grids(path, names, reading, archive);
  } catch (const InputError&) {
    throw;
  } catch (const std::bad_alloc&) {
    throw;
  } catch (const std::system_error&) {
    throw;  // no memory for a thread
  } catch (const std::exception& error) {
    throw InputError(fmt::format("{}: not a readable OpenVDB file: {}", path, one_line(error.what())));
  }
  if (archive.grids.empty() && wanted.empty())
    throw InputError(path + ": the file holds no float, int32 or vec3s grid");
  return archive;
}

template <class T>
const TwoLevelGrid<T>* find(const VdbArchive& archive, const std::string& name) {
  for (const VdbArchive::Entry& entry : archive.grids)
    if (entry.name == name)
      if (const auto* grid = std::get_if<TwoLevelGrid<T>>(&entry.grid)) return grid;
  return nullptr;
}

}  // namespace

template <class T>
const TwoLevelGrid<T>& VdbArchive::get(const std::string& name) const {
  if (const auto* grid = find<T>(*this, name)) return *grid;
  const char* type = std::is_same_v<T, float> ? "float" : std::is_same_v<T, Vec3f> ? "vec3s" : "int32";
  throw InputError(fmt::format("{}: no grid '{}' of type {}", path.empty() ? "volume" : path, name, type));
}
template const TwoLevelGrid<float>& VdbArchive::get(const std::string&) const;
template const TwoLevelGrid<std::int32_t>& VdbArchive::get(const std::string&) const;
template const TwoLevelGrid<Vec3f>& VdbArchive::get(const std::string&) const;

double VdbArchive::number(const std::string& key) const { return numbers(key, 1)[0]; }

std::vector<double> VdbArchive::numbers(const std::string& key, std::size_t count) const {
  const std::string shown = path.empty() ? "volume" : path;
  const auto entry = metadata.find(key);
  if (entry == metadata.end()) throw InputError(fmt::format("{}: the metadata '{}' is missing", shown, key));
  std::vector<double> values;
  const char* text = entry->second.c_str();
  for (;;) {
    char* end = nullptr;
    const double value = std::strtod(text, &end);
    if (end == text) break;
    values.push_back(value);
    text = end;
  }
  while (*text == ' ') ++text;
  if (*text != '\0' || values.size() != count ||
      !std::all_of(values.begin(), values.end(), [](double v) { return std::isfinite(v); }))
    throw InputError(fmt::format("{}: the metadata '{}' is '{}'; expected {} number{}", shown, key,
                                 one_line(entry->second), count, count == 1 ? "" : "s"));
  return values;
}

void VdbArchive::set_numbers(const std::string& key, const std::vector<double>& values) {
  metadata[key] = fmt::format("{}", fmt::join(values, " "));
}

namespace {

VdbArchive read_checked(const std::string& path, const std::vector<std::string>& wanted, bool outline) {
  initialize_library();
  {
    const std::string head = read_head(path, id_at + id_size);
    if (head.empty()) throw InputError(path + ": the file is empty");
    if (head.size() < 8 || head.compare(0, 8, std::string(" BDV\0\0\0\0", 8)) != 0)
      throw InputError(path + ": not an OpenVDB file");
    if (!has_valid_seal(path, head))
      rehearse_reading(path, "OpenVDB",
                       [&] { new VdbArchive(parse(path, wanted, outline ? Reading::outline : Reading::one_by_one)); });
  }
  VdbArchive archive = parse(path, wanted, outline ? Reading::outline : Reading::at_once);
  archive.path = path;
  return archive;
}

}  // namespace

VdbArchive read_vdb(const std::string& path, const std::vector<std::string>& wanted) {
  return read_checked(path, wanted, false);
}
VdbArchive read_vdb_outline(const std::string& path) { return read_checked(path, {}, true); }
bool is_as_written(const std::string& path) { return has_valid_seal(path, read_head(path, id_at + id_size)); }

void write_vdb(const std::string& path, const VdbArchive& archive) {
  initialize_library();
  std::string bytes;
  try {
    openvdb::GridCPtrVec grids;
    for (const VdbArchive::Entry& entry : archive.grids) {
      const openvdb::GridBase::Ptr grid = std::visit(
          [&](const auto& typed) -> openvdb::GridBase::Ptr { return to_vdb_grid(typed, archive.frame); }, entry.grid);
      grid->setName(entry.name);
      grids.push_back(grid);
    }
    openvdb::MetaMap metadata;
    for (const auto& [key, text] : archive.metadata) metadata.insertMeta(key, openvdb::StringMetadata(text));
    StreamArchive stream;
    stream.setCompression(
        openvdb::io::COMPRESS_ACTIVE_MASK |
        (openvdb::io::Archive::hasBloscCompression() ? openvdb::io::COMPRESS_BLOSC : openvdb::io::COMPRESS_ZIP));
    stream.setGridStatsMetadataEnabled(false);
    bytes = stream.encode(grids, metadata);
  } catch (const openvdb::Exception& error) {
    throw InternalError(fmt::format("{}: OpenVDB: {}", path, one_line(error.what())));
  }
  bytes.replace(id_at, id_size, id_of_content(bytes));
  write_text_atomically(path, bytes);
}

DistanceField read_distance_field(const std::string& path) {
  const VdbArchive archive = read_vdb(path);
  DistanceField field;
  field.frame = archive.frame;
  field.inside_band = archive.number("inside_band");
  field.outside_band = archive.number("outside_band");
  field.distance = archive.get<float>("distance");
  field.nearest_vertex = archive.get<std::int32_t>("nearest_vertex");
  field.nearest_point = archive.get<Vec3f>("nearest_point");
  return field;
}

void write_distance_field(const std::string& path, const DistanceField& field) {
  VdbArchive archive;
  archive.frame = field.frame;
  archive.grids = {
      {"distance", field.distance}, {"nearest_vertex", field.nearest_vertex}, {"nearest_point", field.nearest_point}};
  archive.metadata["kind"] = "distance field";
  archive.set_numbers("inside_band", {field.inside_band});
  archive.set_numbers("outside_band", {field.outside_band});
  write_vdb(path, archive);
}

namespace {

std::vector<double> components(const Rgb& colour) { return {colour[0], colour[1], colour[2]}; }

Rgb colour_of(const VdbArchive& archive, const std::string& key) {
  const std::vector<double> values = archive.numbers(key, 3);
  return {static_cast<float>(values[0]), static_cast<float>(values[1]), static_cast<float>(values[2])};
}

}  // namespace

ShellVolume read_shell_volume(const std::string& path, ShellParts parts, std::map<std::string, std::string>* notes) {
  std::vector<std::string> wanted = {"texture_coordinate", "kind", "surface_ior", "extinction", "albedo", "anisotropy"};
  if (parts == ShellParts::all) wanted.emplace_back("normal");
  VdbArchive archive = read_vdb(path, wanted);
  if (notes) *notes = archive.metadata;
  ShellVolume shell;
  shell.frame = archive.frame;
  const auto move = [&](const char* name, auto& to) {
    using Grid = std::remove_reference_t<decltype(to)>;
    for (VdbArchive::Entry& entry : archive.grids)
      if (entry.name == name)
        if (auto* grid = std::get_if<Grid>(&entry.grid)) return void(to = std::move(*grid));
    if (&to != static_cast<void*>(&shell.surface_ior))
      to = archive.get<std::decay_t<decltype(to.background())>>(name);  // says what lacks
  };
  move("texture_coordinate", shell.texture_coordinate);
  move("kind", shell.kind);
  move("extinction", shell.extinction);
  move("albedo", shell.albedo);
  move("anisotropy", shell.anisotropy);
  if (parts == ShellParts::all) move("normal", shell.normal);
  move("surface_ior", shell.surface_ior);
  shell.core.extinction = colour_of(archive, "core_extinction");
  shell.core.albedo = colour_of(archive, "core_albedo");
  shell.core.anisotropy = colour_of(archive, "core_anisotropy");
  if (const auto fill = archive.metadata.find("core"); fill != archive.metadata.end()) {
    if (fill->second != "homogeneous" && fill->second != "interpolated")
      throw InputError(path + ": core is '" + fill->second + "'; expected homogeneous or interpolated");
    shell.core_interpolated = fill->second == "interpolated";
  }
  shell.thickness = archive.number("thickness");
  shell.ior = archive.number("ior");
  return shell;
}

void write_shell_volume(const std::string& path, const ShellVolume& shell,
                        const std::map<std::string, std::string>& notes) {
  VdbArchive archive;
  archive.metadata = notes;
  archive.frame = shell.frame;
  archive.grids = {{"texture_coordinate", shell.texture_coordinate},
                   {"extinction", shell.extinction},
                   {"albedo", shell.albedo},
                   {"anisotropy", shell.anisotropy},
                   {"normal", shell.normal},
                   {"kind", shell.kind}};
  if (shell.surface_ior.leaf_count() > 0) archive.grids.push_back({"surface_ior", shell.surface_ior});
  archive.metadata["kind"] = "shell volume";
  archive.metadata["core"] = shell.core_interpolated ? "interpolated" : "homogeneous";
  archive.set_numbers("core_extinction", components(shell.core.extinction));
  archive.set_numbers("core_albedo", components(shell.core.albedo));
  archive.set_numbers("core_anisotropy", components(shell.core.anisotropy));
  archive.set_numbers("thickness", {shell.thickness});
  archive.set_numbers("ior", {shell.ior});
  write_vdb(path, archive);
}

TriangleMesh extract_isosurface(const TwoLevelGrid<float>& grid, const GridFrame& frame, double isovalue) {
  initialize_library();
  const auto volume = to_vdb_grid(grid, frame);
  // Of a signed distance, the unallocated leaves inside hold the outside's background: give them the inside's sign.
  if (grid.background() > isovalue && grid.leaf_count() > 0) {
    for (auto leaf = volume->tree().beginLeaf(); leaf; ++leaf)
      for (int n = 0; n < 512; ++n) leaf->buffer().data()[n] -= static_cast<float>(isovalue);
    const float outside = static_cast<float>(grid.background() - isovalue);
    volume->tree().root().setBackground(outside, false);
    openvdb::tools::signedFloodFillWithValues(volume->tree(), outside, -outside);
    isovalue = 0;
  }
  std::vector<openvdb::Vec3s> points;
  std::vector<openvdb::Vec3I> triangles;
  std::vector<openvdb::Vec4I> quads;
  openvdb::tools::volumeToMesh(*volume, points, triangles, quads, isovalue, 0.0);
  TriangleMesh mesh;
  mesh.vertices.resize(static_cast<Eigen::Index>(points.size()), 3);
  for (std::size_t i = 0; i < points.size(); ++i)
    mesh.vertices.row(static_cast<Eigen::Index>(i)) << points[i].x(), points[i].y(), points[i].z();
  mesh.faces.resize(static_cast<Eigen::Index>(triangles.size() + 2 * quads.size()), 3);
  Eigen::Index f = 0;
  const auto add = [&](openvdb::Index32 a, openvdb::Index32 b, openvdb::Index32 c) {
    mesh.faces.row(f++) << static_cast<int>(a), static_cast<int>(b), static_cast<int>(c);
  };
  for (const openvdb::Vec3I& t : triangles) add(t[0], t[1], t[2]);
  for (const openvdb::Vec4I& q : quads) add(q[0], q[1], q[2]), add(q[0], q[2], q[3]);
  return mesh;
}

}  // namespace shellgrid
