// SPDX-License-Identifier: AGPL-3.0-or-later
#include <fmt/format.h>

#include <algorithm>
#include <cmath>
#include <filesystem>
#include <limits>
#include <optional>

#include "meshing/core/error.h"
#include "meshing/formats/scalar_volume_file.h"
#include "meshing/formats/vdb_file.h"
#include "pipeline/scene/sample_recipe.h"
#include "synthesis/sample_archive.h"
#include "synthesis/sample_resize.h"
#include "synthesis/volume_classification.h"

namespace shellgrid {
namespace {

// The box of active samples of a float grid.
ScalarVolume box_of(const VdbArchive& archive, const std::string& name) {
  const TwoLevelGrid<float>& grid = archive.get<float>(name);
  Vec3i lower = Vec3i::Constant(std::numeric_limits<int>::max()),
        upper = Vec3i::Constant(std::numeric_limits<int>::min());
  grid.for_each_active([&](int i, int j, int k, float) {
    lower = lower.cwiseMin(Vec3i(i, j, k)), upper = upper.cwiseMax(Vec3i(i, j, k));
  });
  if ((lower.array() > upper.array()).any())
    throw InputError(archive.path + ": the grid '" + name + "' has no active voxels");
  const Vec3 extent = upper.cast<double>() - lower.cast<double>() + Vec3::Ones();
  if (extent.prod() > 2e8)
    throw InputError(fmt::format("{}: the active voxels fill {} x {} x {}, more than 2e8 in all", archive.path,
                                 extent.x(), extent.y(), extent.z()));
  ScalarVolume volume;
  volume.size = extent.cast<int>();
  volume.spacing = Vec3::Constant(archive.frame.voxel);
  volume.values.resize(volume.count());
  std::size_t index = 0;
  for (int z = lower.z(); z <= upper.z(); ++z)
    for (int y = lower.y(); y <= upper.y(); ++y)
      for (int x = lower.x(); x <= upper.x(); ++x) {
        const float value = grid.value(x, y, z);
        if (!std::isfinite(value))
          throw InputError(fmt::format("{}: the value at ({}, {}, {}) is not finite", archive.path, x, y, z));
        volume.values[index++] = value;
      }
  return volume;
}

// Where measured values come from.
struct MeasuredSource {
  std::vector<std::string> files;
  bool images = false;
  std::optional<RawLayout> raw;
  std::string grid;
  Vec3 spacing = Vec3::Zero();   // zero: the file's
  std::vector<int> first, size;  // of the part that is used; empty: all

  ScalarVolume read() const {
    ScalarVolume volume;
    const std::string extension = std::filesystem::path(files.front()).extension().string();
    if (images)
      volume = read_image_stack(files);
    else if (raw)
      volume = read_raw_volume(files.front(), *raw);
    else if (extension == ".vdb")
      volume = box_of(read_vdb(files.front()), grid);
    else
      volume = read_nrrd(files.front());
    if (spacing.x() > 0) volume.spacing = spacing;
    if (first.empty()) return volume;
    ScalarVolume part;
    part.size = Vec3i(size[0], size[1], size[2]);
    part.spacing = volume.spacing;
    for (int axis = 0; axis < 3; ++axis)
      if (first[axis] + size[axis] > volume.size[axis])
        throw InputError(fmt::format("{}: crop: {} values from {} on reach beyond the {} along {}", files.front(),
                                     size[axis], first[axis], volume.size[axis], "xyz"[axis]));
    part.values.reserve(part.count());
    for (int z = 0; z < size[2]; ++z)
      for (int y = 0; y < size[1]; ++y)
        for (int x = 0; x < size[0]; ++x) part.values.push_back(volume.at(first[0] + x, first[1] + y, first[2] + z));
    return part;
  }
};

MeasuredSource read_source(DescriptionSection& root) {
  MeasuredSource source;
  for (const std::string& image : root.texts("images")) source.files.push_back(root.file(image));
  source.images = !source.files.empty();
  const std::string name = root.text("file", "");
  if (name.empty() == source.files.empty())
    root.fail("file", "expected either a file (.vdb, .nrrd, .nhdr or raw values) or a list of images");
  if (!name.empty()) source.files = {root.file(name)};
  const std::string extension = std::filesystem::path(source.files.front()).extension().string();
  if (root.has("raw")) {
    DescriptionSection raw = root.section("raw");
    RawLayout layout;
    const std::vector<int> size = raw.integers("size", {0, 0, 0}, 1, 1000000, "[x, y, z]");
    if (size[0] == 0) raw.fail("size", "is missing; expected [x, y, z]");
    layout.size = Vec3i(size[0], size[1], size[2]);
    try {
      layout.type = scalar_type(raw.text("type", "uint8"));
    } catch (const InputError& error) {
      raw.fail("type", error.what());
    }
    layout.big_endian = raw.boolean("big_endian", false);
    layout.offset = static_cast<std::size_t>(raw.number("offset", 0, 0, 1e15));
    raw.finish();
    source.raw = layout;
  } else if (!source.images && extension != ".vdb" && extension != ".nrrd" && extension != ".nhdr") {
    root.fail("raw", fmt::format("is missing; '{}' is no .vdb and no .nrrd, so its size and type must be told", name));
  }
  source.grid = root.text("grid", "density");
  const Rgb spacing = root.color("spacing", Rgb::Zero(), 1e-6, 1e4);
  source.spacing = spacing.cast<double>().matrix();
  if (root.has("crop")) {
    DescriptionSection crop = root.section("crop");
    source.first = crop.integers("first", {0, 0, 0}, 0, 1000000, "[x, y, z]");
    source.size = crop.integers("size", {0, 0, 0}, 1, 1000000, "[x, y, z]");
    if (source.size[0] == 0) crop.fail("size", "is missing; expected [x, y, z]");
    crop.finish();
  }
  return source;
}

std::vector<VoxelClass> read_classes(DescriptionSection& root) {
  std::vector<VoxelClass> classes;
  for (DescriptionSection& section : root.list("classes")) {
    VoxelClass one;
    one.free = section.boolean("free", false);
    if (section.has("value")) {
      one.from = one.to = section.number("value", 0, -1e30, 1e30);
      if (section.has("from") || section.has("to")) section.fail("value", "stands for both from and to");
    } else {
      one.from = section.number("from", std::numeric_limits<double>::quiet_NaN(), -1e30, 1e30);
      one.to = section.number("to", std::numeric_limits<double>::quiet_NaN(), -1e30, 1e30);
      if (!std::isfinite(one.from) || !std::isfinite(one.to)) section.fail("value", "is missing; or from and to");
    }
    if (!one.free)
      one.material = read_material(section.section("material"));
    else if (section.has("material"))
      section.fail("material", "free space has none");
    section.finish();
    classes.push_back(one);
  }
  if (classes.empty()) root.fail("classes", "expected at least one class");
  return classes;
}

void describe_classified(DescriptionSection& root, SampleRecipe& recipe) {
  const MeasuredSource source = read_source(root);
  ClassificationOptions options;
  options.classes = read_classes(root);
  for (const VoxelClass& one : options.classes)
    if (!one.free) recipe.materials.push_back(one.material);
  const std::string down = root.word("down", "z", {"x", "-x", "y", "-y", "z", "-z"});
  options.down = down.back() - 'x';
  options.descend = down.front() != '-';
  options.mirror = root.boolean("mirror", false);
  options.trace_borders = root.word("borders", "traced", {"traced", "by-value"}) == "traced";
  options.surface = root.number("surface", options.surface, 1e-3, 1);
  recipe.files = source.files;
  if (!source.images && !source.raw && std::filesystem::path(source.files.front()).extension() == ".vdb")
    recipe.check = [source] { read_vdb_outline(source.files.front()).get<float>(source.grid); };
  recipe.make = [source, options](const SampleExtent& extent) {
    ClassificationOptions now = options;
    if (extent.voxel_given) now.voxel = extent.voxel;
    now.ior = extent.ior;
    ClassificationResult result = classify_volume(source.read(), now);
    MadeSample made;
    made.figures = {{"class_shares", result.shares}, {"enclosed_free_space", result.enclosed_free}};
    made.sample = std::move(result.sample);
    if (source.raw) {
      const std::uintmax_t bytes = std::filesystem::file_size(source.files.front());
      const auto values = static_cast<std::uintmax_t>(source.raw->size.cast<std::int64_t>().prod());
      const std::uintmax_t needed = source.raw->offset + values * value_bytes(source.raw->type);
      if (bytes > needed)
        made.warnings.push_back(
            fmt::format("{}: holds {} bytes, {} more than \"raw\" tells of; look at size, type and offset",
                        source.files.front(), bytes, bytes - needed));
    }
    return made;
  };
}

}  // namespace

void describe_volume(DescriptionSection& root, SampleRecipe& recipe) {
  if (root.has("classes")) {
    describe_classified(root, recipe);
    return;
  }
  VolumeImport import;
  import.extinction_scale = root.number("extinction_scale", 1, 0, 1e6);
  import.albedo = root.color("albedo", import.albedo, 0, 1);
  import.anisotropy = root.color("anisotropy", import.anisotropy, -0.999, 0.999);
  import.least_density = root.number("least_density", 0, -1e9, 1e9);
  const std::string name = root.text("file", "");
  if (name.empty()) root.fail("file", "is missing; expected a .vdb");
  const std::string file = root.file(name);
  if (std::filesystem::path(file).extension() != ".vdb")
    root.fail("classes", "is missing: what the values of " + name + " mean");
  recipe.files = {file};
  recipe.check = [file] { require_sample_grids(read_vdb_outline(file)); };
  const bool rescale = recipe.extent.voxel_given;
  recipe.make = [import, file, rescale](const SampleExtent& extent) {
    MadeSample made;
    made.sample = import_sample(read_vdb(file), import);
    if (rescale) made.sample.voxel = extent.voxel;
    return made;
  };
}

}  // namespace shellgrid
