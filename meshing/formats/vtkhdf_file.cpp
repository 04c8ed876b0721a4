// SPDX-License-Identifier: AGPL-3.0-or-later
#include "meshing/formats/vtkhdf_file.h"

#include <fmt/format.h>
#include <hdf5.h>

#include <algorithm>
#include <array>
#include <cmath>
#include <cstring>
#include <limits>
#include <mutex>
#include <utility>

#include "meshing/core/error.h"
#include "meshing/formats/output_file.h"
#include "meshing/formats/untrusted_file.h"

namespace shellgrid {
namespace {

// The file ends with this mark and the seal of all bytes before it; HDF5 ignores what follows its end.
const std::string seal_mark = "\nshellgrid seal ";
constexpr std::size_t seal_digits = 32;
// Integer arrays of at least this size are compressed.
constexpr std::size_t compress_from_bytes = 1 << 16;

std::mutex& library_mutex() {
  static std::mutex mutex;
  return mutex;
}

// Locks the library and keeps it from printing its error stack.
class Session {
 public:
  Session() : lock_(library_mutex()) { H5Eset_auto2(H5E_DEFAULT, nullptr, nullptr); }

 private:
  std::lock_guard<std::mutex> lock_;
};

// An HDF5 identifier that closes itself.
class Handle {
 public:
  Handle(hid_t id, herr_t (*close)(hid_t), const std::string& what) : id_(id), close_(close) {
    if (id_ < 0) throw InputError(what);
  }
  ~Handle() {
    if (id_ >= 0) close_(id_);
  }
  Handle(const Handle&) = delete;
  Handle& operator=(const Handle&) = delete;
  operator hid_t() const { return id_; }

 private:
  hid_t id_;
  herr_t (*close_)(hid_t);
};

template <class T>
hid_t memory_type() {
  if constexpr (std::is_same_v<T, float>)
    return H5T_NATIVE_FLOAT;
  else if constexpr (std::is_same_v<T, double>)
    return H5T_NATIVE_DOUBLE;
  else if constexpr (std::is_same_v<T, std::int32_t>)
    return H5T_NATIVE_INT32;
  else if constexpr (std::is_same_v<T, std::int64_t>)
    return H5T_NATIVE_INT64;
  else
    return H5T_NATIVE_UINT8;
}

template <class T>
hid_t file_type() {
  if constexpr (std::is_same_v<T, float>)
    return H5T_IEEE_F32LE;
  else if constexpr (std::is_same_v<T, double>)
    return H5T_IEEE_F64LE;
  else if constexpr (std::is_same_v<T, std::int32_t>)
    return H5T_STD_I32LE;
  else if constexpr (std::is_same_v<T, std::int64_t>)
    return H5T_STD_I64LE;
  else
    return H5T_STD_U8LE;
}

void check(herr_t status, const std::string& what) {
  if (status < 0) throw InternalError("HDF5: writing failed: " + what);
}

template <class T>
void write_dataset(hid_t group, const std::string& name, const T* values, const std::vector<hsize_t>& shape) {
  hsize_t count = 1;
  for (hsize_t extent : shape) count *= extent;
  const Handle space(H5Screate_simple(static_cast<int>(shape.size()), shape.data(), nullptr), H5Sclose, name);
  const Handle options(H5Pcreate(H5P_DATASET_CREATE), H5Pclose, name);
  check(H5Pset_obj_track_times(options, false), name);
  if (std::is_integral_v<T> && count * sizeof(T) >= compress_from_bytes) {
    std::vector<hsize_t> chunk = shape;
    const hsize_t row = count / shape[0];
    chunk[0] = std::clamp<hsize_t>((hsize_t{1} << 18) / (row * sizeof(T)), 1, shape[0]);
    check(H5Pset_chunk(options, static_cast<int>(chunk.size()), chunk.data()), name);
    check(H5Pset_shuffle(options), name);
    check(H5Pset_deflate(options, 1), name);
  }
  const Handle dataset(H5Dcreate2(group, name.c_str(), file_type<T>(), space, H5P_DEFAULT, options, H5P_DEFAULT),
                       H5Dclose, name);
  if (count > 0) check(H5Dwrite(dataset, memory_type<T>(), H5S_ALL, H5S_ALL, H5P_DEFAULT, values), name);
}

// One column is written as a vector, so that VTK takes it for scalars; one value as 1×1, to tell it from an attribute.
void write_array(hid_t group, const DataArray& array, bool is_field) {
  std::visit(
      [&](const auto& values) {
        if (array.columns < 1 || values.size() % static_cast<std::size_t>(array.columns) != 0)
          throw InternalError(
              fmt::format("array {}: {} values in {} columns", array.name, values.size(), array.columns));
        const hsize_t columns = static_cast<hsize_t>(array.columns);
        std::vector<hsize_t> shape{values.size() / columns};
        if (columns > 1 || (is_field && values.size() == 1)) shape.push_back(columns);
        write_dataset(group, array.name, values.data(), shape);
      },
      array.values);
}

std::size_t row_count(const DataArray& array) {
  return std::visit([&](const auto& values) { return values.size() / static_cast<std::size_t>(array.columns); },
                    array.values);
}

void check_lengths(const std::string& path, const UnstructuredGrid& grid) {
  const auto points = static_cast<std::size_t>(grid.points.rows());
  const auto fail = [&](const std::string& what) { throw InputError(path + ": " + what); };
  if (grid.offsets.size() != grid.types.size() + 1)
    fail(fmt::format("{} offsets for {} cells; expected one more than cells", grid.offsets.size(), grid.types.size()));
  if (grid.offsets.front() != 0 || grid.offsets.back() != static_cast<std::int64_t>(grid.connectivity.size()))
    fail("the offsets do not span the connectivity");
  for (std::size_t c = 0; c < grid.types.size(); ++c) {
    if (grid.offsets[c + 1] < grid.offsets[c]) fail(fmt::format("the offsets decrease at cell {}", c));
    const std::int64_t corners = grid.offsets[c + 1] - grid.offsets[c];
    const int type = grid.types[c];
    const int expected = type == 12 ? 8 : type == 10 || type == 9 ? 4 : type == 5 ? 3 : -1;
    if (expected >= 0 && corners != expected)
      fail(fmt::format("cell {} of type {} has {} corners; expected {}", c, type, corners, expected));
  }
  for (std::size_t i = 0; i < grid.connectivity.size(); ++i)
    if (grid.connectivity[i] < 0 || static_cast<std::size_t>(grid.connectivity[i]) >= points)
      fail(fmt::format("the connectivity names point {}; there are {} points", grid.connectivity[i], points));
  for (const DataArray& array : grid.point_data)
    if (row_count(array) != points)
      fail(fmt::format("the point array {} has {} rows for {} points", array.name, row_count(array), points));
  for (const DataArray& array : grid.cell_data)
    if (row_count(array) != grid.types.size())
      fail(fmt::format("the cell array {} has {} rows for {} cells", array.name, row_count(array), grid.types.size()));
  if (!grid.points.allFinite()) fail("a point has a coordinate that is not finite");
}

hid_t make_group(hid_t parent, const std::string& name) {
  const Handle options(H5Pcreate(H5P_GROUP_CREATE), H5Pclose, name);
  check(H5Pset_obj_track_times(options, false), name);
  return H5Gcreate2(parent, name.c_str(), H5P_DEFAULT, options, H5P_DEFAULT);
}

void write_root(hid_t file, const UnstructuredGrid& grid) {
  const Handle root(make_group(file, "VTKHDF"), H5Gclose, "VTKHDF");
  {
    const std::array<std::int64_t, 2> version{1, 0};
    const hsize_t two = 2;
    const Handle space(H5Screate_simple(1, &two, nullptr), H5Sclose, "Version");
    const Handle attribute(H5Acreate2(root, "Version", H5T_STD_I64LE, space, H5P_DEFAULT, H5P_DEFAULT), H5Aclose,
                           "Version");
    check(H5Awrite(attribute, H5T_NATIVE_INT64, version.data()), "Version");
    const std::string type_name = "UnstructuredGrid";
    const Handle text(H5Tcopy(H5T_C_S1), H5Tclose, "Type");
    check(H5Tset_size(text, type_name.size()), "Type");
    check(H5Tset_strpad(text, H5T_STR_NULLPAD), "Type");
    check(H5Tset_cset(text, H5T_CSET_ASCII), "Type");
    const Handle scalar(H5Screate(H5S_SCALAR), H5Sclose, "Type");
    const Handle type(H5Acreate2(root, "Type", text, scalar, H5P_DEFAULT, H5P_DEFAULT), H5Aclose, "Type");
    check(H5Awrite(type, text, type_name.data()), "Type");
  }
  const auto one = [&](const char* name, std::size_t value) {
    const auto count = static_cast<std::int64_t>(value);
    write_dataset(root, name, &count, {1});
  };
  const auto points = static_cast<hsize_t>(grid.points.rows());
  one("NumberOfPoints", points);
  one("NumberOfCells", grid.types.size());
  one("NumberOfConnectivityIds", grid.connectivity.size());
  write_dataset(root, "Points", grid.points.data(), {points, 3});
  write_dataset(root, "Connectivity", grid.connectivity.data(), {grid.connectivity.size()});
  write_dataset(root, "Offsets", grid.offsets.data(), {grid.offsets.size()});
  write_dataset(root, "Types", grid.types.data(), {grid.types.size()});
  const Handle point_data(make_group(root, "PointData"), H5Gclose, "PointData");
  for (const DataArray& array : grid.point_data) write_array(point_data, array, false);
  const Handle cell_data(make_group(root, "CellData"), H5Gclose, "CellData");
  for (const DataArray& array : grid.cell_data) write_array(cell_data, array, false);
  const Handle field_data(make_group(root, "FieldData"), H5Gclose, "FieldData");
  for (const DataArray& array : grid.field_data) write_array(field_data, array, true);
  for (const auto& [name, value] : grid.attributes) write_dataset(field_data, name, &value, {1});
}

void write_levels(hid_t file, const UnstructuredGrid& grid) {
  if (grid.levels.empty()) return;
  const Handle hierarchy(make_group(file, "hierarchy"), H5Gclose, "hierarchy");
  for (std::size_t l = 0; l < grid.levels.size(); ++l) {
    const Handle level(make_group(hierarchy, std::to_string(l + 1)), H5Gclose, "hierarchy");
    for (const DataArray& array : grid.levels[l]) write_array(level, array, false);
  }
}

// The whole file as bytes: made in memory, so that a full disk is met by our own writing.
std::string encode(const UnstructuredGrid& grid) {
  const Session session;
  const Handle access(H5Pcreate(H5P_FILE_ACCESS), H5Pclose, "file");
  check(H5Pset_fapl_core(access, std::size_t{1} << 22, false), "file");
  const Handle creation(H5Pcreate(H5P_FILE_CREATE), H5Pclose, "file");
  check(H5Pset_obj_track_times(creation, false), "file");
  const Handle file(H5Fcreate("memory.hdf", H5F_ACC_TRUNC, creation, access), H5Fclose, "file");
  write_root(file, grid);
  write_levels(file, grid);
  check(H5Fflush(file, H5F_SCOPE_GLOBAL), "file");
  const ssize_t bytes = H5Fget_file_image(file, nullptr, 0);
  if (bytes <= 0) throw InternalError("HDF5: no image of the file");
  std::string image(static_cast<std::size_t>(bytes), '\0');
  if (H5Fget_file_image(file, image.data(), image.size()) != bytes) throw InternalError("HDF5: no image of the file");
  return image;
}

// ---- reading

struct Shape {
  std::vector<hsize_t> extents;
  hsize_t count = 1;
};

// Checks a dataset's shape against the bytes that it occupies, before anything is allocated.
Shape shape_of(const std::string& path, hid_t dataset, const std::string& name) {
  const Handle space(H5Dget_space(dataset), H5Sclose, path + ": " + name + " has no shape");
  const int rank = H5Sget_simple_extent_ndims(space);
  if (rank < 0 || rank > 2)
    throw InputError(fmt::format("{}: {} has {} dimensions; expected 1 or 2", path, name, rank));
  Shape shape;
  shape.extents.resize(static_cast<std::size_t>(rank));
  H5Sget_simple_extent_dims(space, shape.extents.data(), nullptr);
  const Handle type(H5Dget_type(dataset), H5Tclose, path + ": " + name + " has no type");
  const hsize_t stored = H5Dget_storage_size(dataset);
  for (hsize_t extent : shape.extents) {
    // Deflate packs at most 1032 to 1.
    if (extent > 0 && shape.count > (std::numeric_limits<std::uint32_t>::max() + stored * 1100) / extent)
      throw InputError(fmt::format("{}: {} promises more than the file holds", path, name));
    shape.count *= extent;
  }
  if (shape.count > 0 && shape.count * H5Tget_size(type) > stored * 1100)
    throw InputError(fmt::format("{}: {} promises more than the file holds", path, name));
  return shape;
}

template <class T>
std::vector<T> read_values(const std::string& path, hid_t dataset, const std::string& name, hsize_t count) {
  std::vector<T> values(count);
  if (count > 0 && H5Dread(dataset, memory_type<T>(), H5S_ALL, H5S_ALL, H5P_DEFAULT, values.data()) < 0)
    throw InputError(fmt::format("{}: {} cannot be read: the file is corrupt", path, name));
  return values;
}

template <class T>
std::vector<T> read_dataset(const std::string& path, hid_t group, const std::string& name, hsize_t columns) {
  const Handle dataset(H5Dopen2(group, name.c_str(), H5P_DEFAULT), H5Dclose,
                       fmt::format("{}: the dataset {} is missing; expected a VTKHDF UnstructuredGrid", path, name));
  const Shape shape = shape_of(path, dataset, name);
  const Handle type(H5Dget_type(dataset), H5Tclose, path + ": " + name + " has no type");
  const H5T_class_t kind = H5Tget_class(type);
  if (kind != H5T_INTEGER && !(kind == H5T_FLOAT && std::is_floating_point_v<T>))
    throw InputError(
        fmt::format("{}: {} does not hold {}", path, name, std::is_integral_v<T> ? "integers" : "numbers"));
  if ((columns == 1) != (shape.extents.size() == 1) || (columns > 1 && shape.extents[1] != columns))
    throw InputError(fmt::format("{}: {} has the wrong shape; expected {} columns", path, name, columns));
  return read_values<T>(path, dataset, name, shape.count);
}

// Any numeric array, in the narrowest of our types that holds the file's.
DataArray read_array(const std::string& path, hid_t group, const std::string& name) {
  const Handle dataset(H5Dopen2(group, name.c_str(), H5P_DEFAULT), H5Dclose,
                       fmt::format("{}: the array {} cannot be opened", path, name));
  const Shape shape = shape_of(path, dataset, name);
  DataArray array;
  array.name = name;
  array.columns = shape.extents.size() == 2 ? static_cast<int>(std::min<hsize_t>(shape.extents[1], 1 << 20)) : 1;
  if (array.columns < 1) array.columns = 1;
  const Handle type(H5Dget_type(dataset), H5Tclose, path + ": " + name + " has no type");
  const H5T_class_t kind = H5Tget_class(type);
  const std::size_t bytes = H5Tget_size(type);
  if (kind == H5T_FLOAT && bytes <= 4)
    array.values = read_values<float>(path, dataset, name, shape.count);
  else if (kind == H5T_FLOAT)
    array.values = read_values<double>(path, dataset, name, shape.count);
  else if (kind == H5T_INTEGER && bytes == 1 && H5Tget_sign(type) == H5T_SGN_NONE)
    array.values = read_values<std::uint8_t>(path, dataset, name, shape.count);
  else if (kind == H5T_INTEGER && (bytes < 4 || (bytes == 4 && H5Tget_sign(type) == H5T_SGN_2)))
    array.values = read_values<std::int32_t>(path, dataset, name, shape.count);
  else if (kind == H5T_INTEGER)
    array.values = read_values<std::int64_t>(path, dataset, name, shape.count);
  else
    throw InputError(fmt::format("{}: the array {} does not hold numbers", path, name));
  return array;
}

std::vector<std::string> member_names(const std::string& path, hid_t group) {
  std::vector<std::string> names;
  const auto collect = [](hid_t, const char* name, const H5L_info_t*, void* into) -> herr_t {
    static_cast<std::vector<std::string>*>(into)->emplace_back(name);
    return 0;
  };
  if (H5Literate(group, H5_INDEX_NAME, H5_ITER_INC, nullptr, collect, &names) < 0)
    throw InputError(path + ": the file is corrupt: a group cannot be listed");
  return names;
}

std::vector<DataArray> read_arrays(const std::string& path, hid_t root, const char* group_name, int level,
                                   const ArrayFilter& wanted, std::map<std::string, double>* attributes) {
  std::vector<DataArray> arrays;
  if (H5Lexists(root, group_name, H5P_DEFAULT) <= 0) return arrays;
  const Handle group(H5Gopen2(root, group_name, H5P_DEFAULT), H5Gclose,
                     fmt::format("{}: {} is not a group", path, group_name));
  for (const std::string& name : member_names(path, group)) {
    if (wanted && !wanted(name, level)) continue;
    if (attributes != nullptr) {
      const Handle dataset(H5Dopen2(group, name.c_str(), H5P_DEFAULT), H5Dclose,
                           fmt::format("{}: the array {} cannot be opened", path, name));
      const Shape shape = shape_of(path, dataset, name);
      const Handle type(H5Dget_type(dataset), H5Tclose, path + ": " + name + " has no type");
      if (shape.extents.size() == 1 && shape.count == 1 && H5Tget_class(type) == H5T_FLOAT && H5Tget_size(type) == 8) {
        (*attributes)[name] = read_values<double>(path, dataset, name, 1)[0];
        continue;
      }
    }
    arrays.push_back(read_array(path, group, name));
  }
  return arrays;
}

void check_type(const std::string& path, hid_t root) {
  const std::string foreign = path + ": not a VTKHDF UnstructuredGrid: the attribute Type is missing";
  if (H5Aexists(root, "Type") <= 0) throw InputError(foreign);
  const Handle attribute(H5Aopen(root, "Type", H5P_DEFAULT), H5Aclose, foreign);
  const Handle type(H5Aget_type(attribute), H5Tclose, foreign);
  std::string text;
  if (H5Tget_class(type) == H5T_STRING && H5Tis_variable_str(type) == 0 && H5Tget_size(type) < 256) {
    text.resize(H5Tget_size(type));
    const Handle space(H5Aget_space(attribute), H5Sclose, foreign);
    if (H5Sget_simple_extent_npoints(space) != 1 || H5Aread(attribute, type, text.data()) < 0)
      throw InputError(foreign);
    text = text.c_str();
  }
  if (text != "UnstructuredGrid")
    throw InputError(fmt::format("{}: a VTKHDF file of type '{}'; expected UnstructuredGrid", path, one_line(text)));
}

UnstructuredGrid parse(const std::string& path, const ArrayFilter& wanted) {
  const Session session;
  const Handle file(H5Fopen(path.c_str(), H5F_ACC_RDONLY, H5P_DEFAULT), H5Fclose,
                    path + ": not a readable HDF5 file (foreign, truncated or corrupt)");
  const std::string foreign = path + ": an HDF5 file without the group VTKHDF; expected a VTKHDF UnstructuredGrid";
  if (H5Lexists(file, "VTKHDF", H5P_DEFAULT) <= 0) throw InputError(foreign);
  const Handle root(H5Gopen2(file, "VTKHDF", H5P_DEFAULT), H5Gclose, foreign);
  check_type(path, root);
  UnstructuredGrid grid;
  {
    const std::vector<double> points = read_dataset<double>(path, root, "Points", 3);
    grid.points = Eigen::Map<const VertexMatrix>(points.data(), static_cast<Eigen::Index>(points.size() / 3), 3);
  }
  grid.connectivity = read_dataset<std::int64_t>(path, root, "Connectivity", 1);
  grid.offsets = read_dataset<std::int64_t>(path, root, "Offsets", 1);
  grid.types = read_dataset<std::uint8_t>(path, root, "Types", 1);
  const auto expect = [&](const char* name, std::size_t value) {
    const std::vector<std::int64_t> count = read_dataset<std::int64_t>(path, root, name, 1);
    if (count.size() != 1)
      throw InputError(fmt::format("{}: {} partitions; only files of one partition are supported", path, count.size()));
    if (count[0] != static_cast<std::int64_t>(value))
      throw InputError(fmt::format("{}: {} is {}, but the arrays hold {}", path, name, count[0], value));
  };
  expect("NumberOfPoints", static_cast<std::size_t>(grid.points.rows()));
  expect("NumberOfCells", grid.types.size());
  expect("NumberOfConnectivityIds", grid.connectivity.size());
  grid.point_data = read_arrays(path, root, "PointData", 0, wanted, nullptr);
  grid.cell_data = read_arrays(path, root, "CellData", 0, wanted, nullptr);
  grid.field_data = read_arrays(path, root, "FieldData", 0, wanted, &grid.attributes);
  if (H5Lexists(file, "hierarchy", H5P_DEFAULT) > 0) {
    const Handle hierarchy(H5Gopen2(file, "hierarchy", H5P_DEFAULT), H5Gclose, path + ": hierarchy is not a group");
    for (int l = 1; l <= 64 && H5Lexists(hierarchy, std::to_string(l).c_str(), H5P_DEFAULT) > 0; ++l)
      grid.levels.push_back(read_arrays(path, hierarchy, std::to_string(l).c_str(), l, wanted, nullptr));
  }
  check_lengths(path, grid);
  return grid;
}

bool has_valid_seal(const std::string& bytes) {
  const std::size_t trailer = seal_mark.size() + seal_digits + 1;
  if (bytes.size() < trailer) return false;
  const std::size_t end = bytes.size() - trailer;
  return bytes.compare(end, seal_mark.size(), seal_mark) == 0 &&
         bytes.compare(end + seal_mark.size(), seal_digits, seal_of({bytes.data(), end})) == 0;
}

const DataArray* find_in(const std::vector<DataArray>& arrays, const std::string& name) {
  for (const DataArray& array : arrays)
    if (array.name == name) return &array;
  return nullptr;
}

}  // namespace

const DataArray* UnstructuredGrid::find_point(const std::string& name) const { return find_in(point_data, name); }
const DataArray* UnstructuredGrid::find_cell(const std::string& name) const { return find_in(cell_data, name); }
const DataArray* UnstructuredGrid::find_field(const std::string& name) const { return find_in(field_data, name); }

UnstructuredGrid read_vtkhdf(const std::string& path, const ArrayFilter& wanted) {
  {
    const std::string bytes = read_text(path);
    if (bytes.empty()) throw InputError(path + ": the file is empty");
    if (bytes.find("\x89HDF\r\n\x1a\n") == std::string::npos) throw InputError(path + ": not an HDF5 file");
    if (!has_valid_seal(bytes)) rehearse_reading(path, "VTKHDF", [&] { parse(path, wanted); });
  }
  return parse(path, wanted);
}

void write_vtkhdf(const std::string& path, const UnstructuredGrid& grid) {
  try {
    check_lengths(path, grid);
  } catch (const InputError& error) {
    throw InternalError(error.what());
  }
  std::string bytes = encode(grid);
  bytes += seal_mark + seal_of(bytes) + "\n";
  write_text_atomically(path, bytes);
}

}  // namespace shellgrid
