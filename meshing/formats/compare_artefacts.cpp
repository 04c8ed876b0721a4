// SPDX-License-Identifier: AGPL-3.0-or-later
#include "meshing/formats/compare_artefacts.h"

#include <fmt/format.h>

#include <algorithm>
#include <array>
#include <cctype>
#include <filesystem>

#include "meshing/core/colour_map.h"
#include "meshing/core/error.h"
#include "meshing/core/parallel.h"
#include "meshing/formats/image_file.h"
#include "meshing/formats/mesh_file.h"
#include "meshing/formats/vdb_file.h"
#include "meshing/formats/vtkhdf_file.h"
#include "meshing/surface/closest_point.h"

namespace shellgrid {
namespace {

std::string extension_of(const std::string& path) {
  std::string extension = std::filesystem::path(path).extension().string();
  std::transform(extension.begin(), extension.end(), extension.begin(),
                 [](unsigned char c) { return std::tolower(c); });
  return extension;
}

std::string kind_of(const std::string& path) {
  const std::string extension = extension_of(path);
  if (extension == ".exr" || extension == ".png") return "image";
  if (extension == ".vdb") return "volume";
  if (extension == ".hdf" || extension == ".h5" || extension == ".vtkhdf") return "grid";
  if (extension == ".ply" || extension == ".obj" || extension == ".off" || extension == ".stl") return "mesh";
  throw InputError(fmt::format("{}: cannot compare files of extension '{}'", path, extension));
}

// Adds squares of differences; finish() takes roots. Not-finite differences count as zero.
void accumulate(float& sum, double value, double reference) {
  const double difference = value - reference;
  if (std::isfinite(difference)) sum += static_cast<float>(difference * difference);
}

void finish(std::vector<float>& difference) {
  for (float& value : difference) value = std::sqrt(value);
}

Image read_image(const std::string& path) { return extension_of(path) == ".png" ? read_png(path) : read_exr(path); }

ArtefactComparison compare_images(const std::string& path_a, const std::string& path_b) {
  const Image a = read_image(path_a), b = read_image(path_b);
  if (a.width != b.width || a.height != b.height)
    throw InputError(
        fmt::format("{}: {}×{} pixels, but {} has {}×{}", path_a, a.width, a.height, path_b, b.width, b.height));
  ArtefactComparison result;
  result.width = a.width, result.height = a.height;
  result.difference.assign(static_cast<std::size_t>(a.width) * static_cast<std::size_t>(a.height), 0.0f);
  // The picture shows the colour where both have it.
  const bool has_colour = a.find("R") && a.find("G") && a.find("B") && b.find("R") && b.find("G") && b.find("B");
  for (const Image::Channel& channel : a.channels) {
    const Image::Channel* other = b.find(channel.name);
    if (other == nullptr) {
      result.remarks.push_back(fmt::format("channel {} is in {} alone", channel.name, path_a));
      continue;
    }
    Comparison figures(channel.name);
    const bool shown = !has_colour || channel.name == "R" || channel.name == "G" || channel.name == "B";
    for (std::size_t i = 0; i < channel.values.size(); ++i) {
      figures.add(channel.values[i], other->values[i]);
      if (shown) accumulate(result.difference[i], channel.values[i], other->values[i]);
    }
    result.figures.push_back(figures);
  }
  for (const Image::Channel& channel : b.channels)
    if (a.find(channel.name) == nullptr)
      result.remarks.push_back(fmt::format("channel {} is in {} alone", channel.name, path_b));
  finish(result.difference);
  return result;
}

// Samples active in either grid; values where one is inactive are its background's.
template <class T>
void compare_grids(const std::string& name, const TwoLevelGrid<T>& a, const TwoLevelGrid<T>& b, const GridFrame& frame,
                   bool keep_points, ArtefactComparison& result) {
  Comparison figures(name);
  std::size_t active_in_one = 0;
  std::vector<Vec3> points;
  const auto add = [&](int i, int j, int k, const T& value, const T& reference) {
    float square = 0;
    if constexpr (std::is_same_v<T, Vec3f>) {
      for (int c = 0; c < 3; ++c) figures.add(value[c], reference[c]), accumulate(square, value[c], reference[c]);
    } else {
      figures.add(value, reference), accumulate(square, value, reference);
    }
    if (!keep_points) return;
    points.push_back(frame.to_world({i, j, k}));
    result.difference.push_back(square);
  };
  a.for_each_active([&](int i, int j, int k, const T& value) {
    if (!b.is_active(i, j, k)) ++active_in_one;
    add(i, j, k, value, b.value(i, j, k));
  });
  b.for_each_active([&](int i, int j, int k, const T& reference) {
    if (a.is_active(i, j, k)) return;
    ++active_in_one;
    add(i, j, k, a.value(i, j, k), reference);
  });
  if (active_in_one > 0)
    result.remarks.push_back(fmt::format("grid {}: {} samples are active in one file alone", name, active_in_one));
  if (keep_points) {
    result.mesh.vertices.resize(static_cast<Eigen::Index>(points.size()), 3);
    for (std::size_t i = 0; i < points.size(); ++i)
      result.mesh.vertices.row(static_cast<Eigen::Index>(i)) = points[i].transpose();
  }
  result.figures.push_back(figures);
}

ArtefactComparison compare_volumes(const std::string& path_a, const std::string& path_b) {
  const VdbArchive a = read_vdb(path_a), b = read_vdb(path_b);
  const auto kind = [](const VdbArchive& archive) {
    const auto found = archive.metadata.find("kind");
    return found == archive.metadata.end() ? std::string() : found->second;
  };
  if (!kind(a).empty() && !kind(b).empty() && kind(a) != kind(b))
    throw InputError(
        fmt::format("{} holds a {}, {} a {}; expected two of the same kind", path_a, kind(a), path_b, kind(b)));
  if (std::abs(a.frame.voxel - b.frame.voxel) > 1e-9 * b.frame.voxel ||
      (a.frame.origin - b.frame.origin).norm() > 1e-6 * b.frame.voxel)
    throw InputError(fmt::format("{}: its frame (voxel {} mm) differs from that of {} (voxel {} mm)", path_a,
                                 a.frame.voxel, path_b, b.frame.voxel));
  ArtefactComparison result;
  for (const VdbArchive::Entry& entry : a.grids) {
    const auto other = std::find_if(b.grids.begin(), b.grids.end(), [&](const VdbArchive::Entry& candidate) {
      return candidate.name == entry.name && candidate.grid.index() == entry.grid.index();
    });
    if (other == b.grids.end()) {
      result.remarks.push_back(fmt::format("grid {} is in {} alone", entry.name, path_a));
      continue;
    }
    // The points show the first common grid.
    const bool keep_points = result.figures.empty();
    std::visit(
        [&](const auto& grid) {
          using Grid = std::decay_t<decltype(grid)>;
          compare_grids(entry.name, grid, std::get<Grid>(other->grid), a.frame, keep_points, result);
        },
        entry.grid);
  }
  for (const VdbArchive::Entry& entry : b.grids)
    if (std::none_of(a.grids.begin(), a.grids.end(), [&](const VdbArchive::Entry& candidate) {
          return candidate.name == entry.name && candidate.grid.index() == entry.grid.index();
        }))
      result.remarks.push_back(fmt::format("grid {} is in {} alone", entry.name, path_b));
  finish(result.difference);
  return result;
}

Comparison compare_positions(const VertexMatrix& a, const VertexMatrix& b, std::vector<float>& difference) {
  // Relative to the reference's centre, so that moving both changes nothing.
  const Eigen::RowVector3d centre = b.colwise().mean();
  Comparison figures("position");
  for (Eigen::Index i = 0; i < a.rows(); ++i)
    for (int axis = 0; axis < 3; ++axis) {
      figures.add(a(i, axis) - centre[axis], b(i, axis) - centre[axis]);
      accumulate(difference[static_cast<std::size_t>(i)], a(i, axis), b(i, axis));
    }
  return figures;
}

void compare_arrays(const std::string& group, const std::vector<DataArray>& arrays_a,
                    const std::vector<DataArray>& arrays_b, std::vector<float>* difference,
                    ArtefactComparison& result) {
  for (const DataArray& a : arrays_a) {
    const auto b = std::find_if(arrays_b.begin(), arrays_b.end(), [&](const DataArray& x) { return x.name == a.name; });
    const std::string name = group + "/" + a.name;
    if (b == arrays_b.end()) {
      result.remarks.push_back("array " + name + " is in the first file alone");
      continue;
    }
    const auto size = [](const auto& values) { return values.size(); };
    if (a.columns != b->columns || std::visit(size, a.values) != std::visit(size, b->values)) {
      result.remarks.push_back("array " + name + " has different shapes");
      continue;
    }
    Comparison figures(name);
    std::visit(
        [&](const auto& values, const auto& references) {
          for (std::size_t i = 0; i < values.size(); ++i) {
            figures.add(static_cast<double>(values[i]), static_cast<double>(references[i]));
            if (difference != nullptr)
              accumulate((*difference)[i / static_cast<std::size_t>(a.columns)], static_cast<double>(values[i]),
                         static_cast<double>(references[i]));
          }
        },
        a.values, b->values);
    result.figures.push_back(figures);
  }
}

ArtefactComparison compare_unstructured_grids(const std::string& path_a, const std::string& path_b) {
  const UnstructuredGrid a = read_vtkhdf(path_a), b = read_vtkhdf(path_b);
  if (a.points.rows() != b.points.rows() || a.types != b.types || a.connectivity != b.connectivity)
    throw InputError(fmt::format("{}: its cells differ from those of {}", path_a, path_b));
  ArtefactComparison result;
  const auto points = static_cast<std::size_t>(a.points.rows());
  std::vector<float> moved(points, 0.0f);
  result.difference.assign(points, 0.0f);
  result.figures.push_back(compare_positions(a.points, b.points, moved));
  compare_arrays("PointData", a.point_data, b.point_data, &result.difference, result);
  compare_arrays("CellData", a.cell_data, b.cell_data, nullptr, result);
  compare_arrays("FieldData", a.field_data, b.field_data, nullptr, result);
  if (a.point_data.empty()) result.difference = moved;
  result.mesh.vertices = a.points;
  finish(result.difference);
  return result;
}

// Distances from the vertices and face centres of one surface to the other; those of the vertices come back.
std::vector<float> distances_to(const TriangleMesh& from, const TriangleMesh& to, Comparison& figures) {
  const ClosestPointQuery query(to);
  const auto vertices = static_cast<std::size_t>(from.vertex_count());
  std::vector<float> distance(vertices + static_cast<std::size_t>(from.face_count()));
  parallel_for(distance.size(), [&](std::size_t i) {
    const int f = static_cast<int>(i - vertices);
    const Vec3 point = i < vertices ? from.vertex(static_cast<int>(i))
                                    : Vec3((from.corner(f, 0) + from.corner(f, 1) + from.corner(f, 2)) / 3);
    distance[i] = static_cast<float>(std::sqrt(query.nearest(point).squared_distance));
  });
  for (float value : distance) figures.add(value, 0);
  distance.resize(vertices);
  return distance;
}

ArtefactComparison compare_meshes(const std::string& path_a, const std::string& path_b) {
  const AttributedMesh a = read_points(path_a), b = read_points(path_b);
  ArtefactComparison result;
  result.mesh = a.mesh;
  const auto vertices = static_cast<std::size_t>(a.mesh.vertex_count());
  if (a.mesh.vertex_count() == b.mesh.vertex_count() && a.mesh.face_count() == b.mesh.face_count() &&
      a.mesh.faces == b.mesh.faces) {
    std::vector<float> moved(vertices, 0.0f);
    result.difference.assign(vertices, 0.0f);
    result.figures.push_back(compare_positions(a.mesh.vertices, b.mesh.vertices, moved));
    for (const VertexProperty& property : a.properties) {
      const std::vector<float>* other = b.find(property.name);
      if (other == nullptr) {
        result.remarks.push_back(fmt::format("property {} is in {} alone", property.name, path_a));
        continue;
      }
      Comparison figures(property.name);
      // Preview colours and the preview's quality repeat what other properties say.
      const bool shown = property.name != "red" && property.name != "green" && property.name != "blue" &&
                         property.name != "alpha" && property.name != "quality";
      for (std::size_t i = 0; i < vertices; ++i) {
        figures.add(property.values[i], (*other)[i]);
        if (shown) accumulate(result.difference[i], property.values[i], (*other)[i]);
      }
      result.figures.push_back(figures);
    }
    for (const VertexProperty& property : b.properties)
      if (a.find(property.name) == nullptr)
        result.remarks.push_back(fmt::format("property {} is in {} alone", property.name, path_b));
    if (std::all_of(result.difference.begin(), result.difference.end(), [](float v) { return v == 0; }))
      result.difference = moved;
    finish(result.difference);
    return result;
  }
  if (a.mesh.face_count() == 0 || b.mesh.face_count() == 0)
    throw InputError(fmt::format("{}: other points than in {}, and no faces to measure distances to", path_a, path_b));
  result.remarks.push_back(
      "the meshes have different vertices or faces: distances between the surfaces, mm; relative to the diagonal");
  Comparison forth("distance from first to second"), back("distance from second to first");
  result.difference = distances_to(a.mesh, b.mesh, forth);
  distances_to(b.mesh, a.mesh, back);
  const double diagonal = (b.mesh.vertices.colwise().maxCoeff() - b.mesh.vertices.colwise().minCoeff()).norm();
  forth.set_scale(diagonal), back.set_scale(diagonal);
  result.figures = {forth, back};
  return result;
}

}  // namespace

ArtefactComparison compare_artefacts(const std::string& path, const std::string& reference_path) {
  const std::string kind = kind_of(path), other = kind_of(reference_path);
  if (kind != other)
    throw InputError(fmt::format("{}: a file of kind {}, but {} is a {}", path, kind, reference_path, other));
  ArtefactComparison result = kind == "image"    ? compare_images(path, reference_path)
                              : kind == "volume" ? compare_volumes(path, reference_path)
                              : kind == "grid"   ? compare_unstructured_grids(path, reference_path)
                                                 : compare_meshes(path, reference_path);
  result.kind = kind;
  if (result.figures.empty()) throw InputError(fmt::format("{}: nothing in common with {}", path, reference_path));
  return result;
}

void write_difference(const std::string& path, const ArtefactComparison& comparison, double white) {
  if (white <= 0)
    for (float value : comparison.difference) white = std::max(white, static_cast<double>(value));
  const auto colour = [&](float value) { return false_colour(white > 0 ? static_cast<double>(value) / white : 0); };
  const std::string expected = comparison.kind == "image" ? ".png" : ".ply";
  if (extension_of(path) != expected)
    throw InputError(
        fmt::format("{}: the difference of two files of kind {} is written as {}", path, comparison.kind, expected));
  if (comparison.kind == "image") {
    std::vector<std::uint8_t> rgb;
    rgb.reserve(3 * comparison.difference.size());
    for (float value : comparison.difference)
      for (std::uint8_t byte : colour(value)) rgb.push_back(byte);
    write_png(path, comparison.width, comparison.height, rgb);
    return;
  }
  std::vector<VertexProperty> properties{{"quality", comparison.difference}, {"red", {}}, {"green", {}}, {"blue", {}}};
  for (float value : comparison.difference) {
    const std::array<std::uint8_t, 3> bytes = colour(value);
    for (std::size_t c = 0; c < 3; ++c) properties[c + 1].values.push_back(bytes[c]);
  }
  if (comparison.mesh.face_count() > 0)
    write_ply(path, {comparison.mesh, properties});
  else
    write_point_ply(path, comparison.mesh.vertices, properties);
}

}  // namespace shellgrid
