// SPDX-License-Identifier: AGPL-3.0-or-later
#include "synthesis/sample_archive.h"

#include <fmt/format.h>

#include <algorithm>
#include <cmath>
#include <functional>
#include <limits>

#include "meshing/core/error.h"
#include "meshing/shell/filled_box.h"
#include "synthesis/sample_builder.h"
#include "synthesis/sample_check.h"

namespace shellgrid {
namespace {

template <class T>
bool has_grid(const VdbArchive& archive, const std::string& name) {
  return std::any_of(archive.grids.begin(), archive.grids.end(), [&](const VdbArchive::Entry& entry) {
    return entry.name == name && std::holds_alternative<TwoLevelGrid<T>>(entry.grid);
  });
}

void expect_kind(const VdbArchive& archive, const std::string& kind, const std::string& maker) {
  const auto entry = archive.metadata.find("kind");
  if (entry == archive.metadata.end() || entry->second != kind)
    throw InputError(
        fmt::format("{}: {}; expected a {} as {} writes it", archive.path,
                    entry == archive.metadata.end() ? "is not one of this project's volumes" : "is a " + entry->second,
                    kind, maker));
}

int whole(const VdbArchive& archive, const std::string& key, double least, double most) {
  const double value = archive.number(key);
  if (!(value >= least && value <= most) || value != std::floor(value))
    throw InputError(fmt::format("{}: the metadata '{}' is {}, out of range", archive.path, key, value));
  return static_cast<int>(value);
}

Vec3i read_size(const VdbArchive& archive) {
  const std::vector<double> size = archive.numbers("size", 3);
  for (double n : size)
    if (!(n >= 1 && n <= 4096) || n != std::floor(n))
      throw InputError(fmt::format("{}: the metadata 'size' is out of range", archive.path));
  if (size[0] * size[1] * size[2] > 2e8) throw InputError(archive.path + ": the sample is too large");
  return {static_cast<int>(size[0]), static_cast<int>(size[1]), static_cast<int>(size[2])};
}

struct SampleHead {
  Vec3i size;
  double voxel, ior;
};

SampleHead read_head(const VdbArchive& archive) {
  const SampleHead head{read_size(archive), archive.number("voxel"), archive.number("ior")};
  if (!(head.voxel > 0) || !(head.ior >= 1))
    throw InputError(archive.path + ": the metadata 'voxel' or 'ior' is out of range");
  return head;
}

// The grid that tells where a volume from elsewhere is.
std::string main_grid(const VdbArchive& archive) {
  if (const auto kind = archive.metadata.find("kind"); kind != archive.metadata.end() && kind->second == "shell volume")
    throw InputError(archive.path + ": is a shell volume, grown over an object; expected a block of material");
  for (const char* name : {"extinction", "density"})
    if (has_grid<Vec3f>(archive, name) || has_grid<float>(archive, name)) return name;
  throw InputError(archive.path + ": has neither a grid 'extinction' nor a grid 'density'");
}

template <class Visit>
void for_each_index(const Vec3i& size, const Visit& visit) {
  std::size_t index = 0;
  for (int z = 0; z < size.z(); ++z)
    for (int y = 0; y < size.y(); ++y)
      for (int x = 0; x < size.x(); ++x) visit(index++, x, y, z);
}

VoxelKind to_kind(int value, const std::string& path) {
  if (value < 0 || value > 2) throw InputError(fmt::format("{}: kind {} is none of 0, 1, 2", path, value));
  return static_cast<VoxelKind>(value);
}

}  // namespace

VdbArchive archive_sample(const MaterialSample& sample) {
  VdbArchive archive;
  archive.frame = {Vec3::Zero(), sample.voxel};
  const auto add = [&](const std::string& name, const std::vector<Vec3f>& values) {
    archive.grids.push_back({name, filled_box<Vec3f>(sample.size, Vec3f::Zero(), [&](int x, int y, int z) {
                               return values[sample.index(x, y, z)];
                             })});
  };
  add("extinction", sample.extinction);
  add("albedo", sample.albedo);
  add("anisotropy", sample.anisotropy);
  add("normal", sample.normal);
  archive.grids.push_back({"kind", filled_box<std::int32_t>(sample.size, 0, [&](int x, int y, int z) {
                             return static_cast<std::int32_t>(sample.kind[sample.index(x, y, z)]);
                           })});
  if (!sample.surface_ior.empty())
    archive.grids.push_back({"surface_ior", filled_box<float>(sample.size, 0.0f, [&](int x, int y, int z) {
                               return sample.surface_ior[sample.index(x, y, z)];
                             })});
  archive.metadata["kind"] = "material sample";
  archive.set_numbers("size", {static_cast<double>(sample.size.x()), static_cast<double>(sample.size.y()),
                               static_cast<double>(sample.size.z())});
  archive.set_numbers("voxel", {sample.voxel});
  archive.set_numbers("ior", {sample.ior});
  return archive;
}

void require_sample_grids(const VdbArchive& archive) {
  if (!is_sample_archive(archive)) {
    main_grid(archive);
    return;
  }
  read_head(archive);
  for (const char* name : {"extinction", "albedo", "anisotropy", "normal"}) archive.get<Vec3f>(name);
  archive.get<std::int32_t>("kind");
}

bool is_sample_archive(const VdbArchive& archive) {
  const auto entry = archive.metadata.find("kind");
  return entry != archive.metadata.end() && entry->second == "material sample";
}

MaterialSample restore_sample(const VdbArchive& archive) {
  expect_kind(archive, "material sample", "sg-sample");
  const SampleHead head = read_head(archive);
  MaterialSample sample = allocate_sample(head.size, head.voxel, head.ior);
  const auto &extinction = archive.get<Vec3f>("extinction"), &albedo = archive.get<Vec3f>("albedo");
  const auto &anisotropy = archive.get<Vec3f>("anisotropy"), &normal = archive.get<Vec3f>("normal");
  const auto& kind = archive.get<std::int32_t>("kind");
  const auto* surface_ior = has_grid<float>(archive, "surface_ior") ? &archive.get<float>("surface_ior") : nullptr;
  if (surface_ior) sample.surface_ior.resize(sample.voxel_count());
  for_each_index(sample.size, [&](std::size_t i, int x, int y, int z) {
    if (surface_ior) sample.surface_ior[i] = surface_ior->value(x, y, z);
    sample.extinction[i] = extinction.value(x, y, z);
    sample.albedo[i] = albedo.value(x, y, z);
    sample.anisotropy[i] = anisotropy.value(x, y, z);
    sample.normal[i] = normal.value(x, y, z);
    sample.kind[i] = to_kind(kind.value(x, y, z), archive.path);
  });
  naming(archive.path, [&] { check_coefficients(sample); });
  return sample;
}

MaterialSample import_sample(const VdbArchive& archive, const VolumeImport& options) {
  const std::string main = main_grid(archive);
  Vec3i lower = Vec3i::Constant(std::numeric_limits<int>::max()), upper = -lower;
  const auto include = [&](int i, int j, int k, const auto&) {
    lower = lower.cwiseMin(Vec3i(i, j, k)), upper = upper.cwiseMax(Vec3i(i, j, k));
  };
  // Reads a colour from a vec3s or float grid; null where there is neither.
  const auto reader = [&](const std::string& name) -> std::function<Vec3f(int, int, int)> {
    if (has_grid<Vec3f>(archive, name)) {
      const auto& grid = archive.get<Vec3f>(name);
      return [&grid](int i, int j, int k) { return grid.value(i, j, k); };
    }
    if (has_grid<float>(archive, name)) {
      const auto& grid = archive.get<float>(name);
      return [&grid](int i, int j, int k) { return Vec3f(Vec3f::Constant(grid.value(i, j, k))); };
    }
    return nullptr;
  };
  const auto extinction = reader("extinction"), density = reader("density");
  if (has_grid<Vec3f>(archive, main))
    archive.get<Vec3f>(main).for_each_active(include);
  else
    archive.get<float>(main).for_each_active(include);
  if ((lower.array() > upper.array()).any())
    throw InputError(archive.path + ": the grid '" + main + "' has no active voxels");
  // Far corners may lie more than 2³¹ apart.
  const Vec3 extent = upper.cast<double>() - lower.cast<double>() + Vec3::Ones();
  if (extent.prod() > 2e8 || extent.x() < 4 || extent.y() < 4)
    throw InputError(fmt::format(
        "{}: the active voxels fill {} x {} x {}; a sample has 4 voxels at least in x and y and 2e8 at most in all",
        archive.path, extent.x(), extent.y(), extent.z()));
  MaterialSample sample = allocate_sample(extent.cast<int>(), archive.frame.voxel, options.ior);
  const auto albedo = reader("albedo"), anisotropy = reader("anisotropy");
  const bool has_kind = has_grid<std::int32_t>(archive, "kind"), has_normal = has_grid<Vec3f>(archive, "normal");
  for_each_index(sample.size, [&](std::size_t index, int x, int y, int z) {
    const int i = x + lower.x(), j = y + lower.y(), k = z + lower.z();
    const Vec3f value =
        extinction ? extinction(i, j, k) : Vec3f(density(i, j, k) * static_cast<float>(options.extinction_scale));
    const bool free = has_kind ? archive.get<std::int32_t>("kind").value(i, j, k) == 0
                               : !((extinction ? value : density(i, j, k)).maxCoeff() > options.least_density);
    if (free) {
      sample.kind[index] = VoxelKind::free_space;
      return;
    }
    sample.extinction[index] = value;
    sample.albedo[index] = albedo ? albedo(i, j, k) : Vec3f(options.albedo.matrix());
    sample.anisotropy[index] = anisotropy ? anisotropy(i, j, k) : Vec3f(options.anisotropy.matrix());
  });
  if (has_kind && has_normal) {
    for_each_index(sample.size, [&](std::size_t index, int x, int y, int z) {
      const int i = x + lower.x(), j = y + lower.y(), k = z + lower.z();
      sample.kind[index] = to_kind(archive.get<std::int32_t>("kind").value(i, j, k), archive.path);
      const Vec3f normal = archive.get<Vec3f>("normal").value(i, j, k);
      if (sample.kind[index] == VoxelKind::surface)
        sample.normal[index] = normal.norm() > 1e-6f ? Vec3f(normal.normalized()) : Vec3f(0, 0, -1);
    });
  } else {
    mark_surface(sample);
  }
  return sample;
}

namespace {

// Calls visit(texel, x, y, layer) for every texel; the layer is the grid's z.
template <class Visit>
void for_each_texel(const SampleLayers& layers, const Visit& visit) {
  for (int l = 0; l < layers.size(); ++l)
    for (int y = 0; y < layers[l].height; ++y)
      for (int x = 0; x < layers[l].width; ++x)
        visit(static_cast<std::size_t>(layers[l].first) + static_cast<std::size_t>(y) * layers[l].width + x, x, y, l);
}

template <class T, class Value>
TwoLevelGrid<T> fill_layers(const SampleLayers& layers, const T& background, const Value& value) {
  Vec3i size(0, 0, layers.size());
  for (const SampleLayer& layer : layers.list) size = size.cwiseMax(Vec3i(layer.width, layer.height, 0));
  TwoLevelGrid<T> grid(Vec3i::Zero(), (size.array() + 7) / 8, background);
  for_each_texel(layers, [&](std::size_t texel, int x, int y, int l) { grid.set(x, y, l, value(texel)); });
  return grid;
}

SampleLayers read_layers(const VdbArchive& archive) {
  const int samples = whole(archive, "samples", 1, 16), symmetry = whole(archive, "symmetry", 1, 4);
  if (symmetry == 3) throw InputError(archive.path + ": the metadata 'symmetry' is 3, out of range");
  std::vector<Eigen::Vector2i> sizes;
  const std::vector<double> numbers = archive.numbers("sizes", 2 * static_cast<std::size_t>(samples));
  for (std::size_t i = 0; i < numbers.size(); i += 2) {
    for (std::size_t k = i; k < i + 2; ++k)
      if (!(numbers[k] >= 1 && numbers[k] <= 4096) || numbers[k] != std::floor(numbers[k]))
        throw InputError(fmt::format("{}: the metadata 'sizes' is out of range", archive.path));
    sizes.emplace_back(static_cast<int>(numbers[i]), static_cast<int>(numbers[i + 1]));
  }
  return SampleLayers::make(sizes, symmetry);
}

}  // namespace

VdbArchive archive_textons(const TextonSet& textons) {
  VdbArchive archive;
  archive.frame = {Vec3::Zero(), textons.voxel};
  const SampleLayers& layers = textons.layers;
  const auto add_floats = [&](const std::string& name, const std::vector<float>& values) {
    for (int c = 0; c < TextonSet::dimension; ++c)
      archive.grids.push_back({fmt::format("{}_{}", name, c), fill_layers<float>(layers, 0.0f, [&](std::size_t texel) {
                                 return values[texel * TextonSet::dimension + c];
                               })});
  };
  const auto add_indices = [&](const std::string& name, const std::vector<std::int32_t>& values, int stride, int k) {
    archive.grids.push_back(
        {name, fill_layers<std::int32_t>(layers, -1, [&](std::size_t texel) { return values[texel * stride + k]; })});
  };
  archive.grids.push_back(
      {"color", fill_layers<Vec3f>(layers, Vec3f::Zero(), [&](std::size_t texel) { return textons.color[texel]; })});
  add_indices("texton", textons.textons, 1, 0);
  add_floats("feature", textons.features);
  const int candidates = textons.candidates_each();
  for (std::size_t l = 0; l < textons.levels.size(); ++l) {
    add_floats(fmt::format("appearance_{}", l), textons.levels[l].appearance);
    for (int k = 0; k < candidates; ++k)
      add_indices(fmt::format("candidate_{}_{}", l, k), textons.levels[l].candidates, candidates, k);
  }
  archive.metadata["kind"] = "texton set";
  std::vector<double> sizes;
  for (int s = 0; s < layers.sample_count; ++s)
    sizes.insert(sizes.end(), {static_cast<double>(layers[s].width), static_cast<double>(layers[s].height)});
  archive.set_numbers("samples", {static_cast<double>(layers.sample_count)});
  archive.set_numbers("symmetry", {static_cast<double>(layers.symmetry)});
  archive.set_numbers("sizes", sizes);
  archive.set_numbers("voxel", {textons.voxel});
  archive.set_numbers("levels", {static_cast<double>(textons.levels.size())});
  archive.set_numbers("candidates", {static_cast<double>(textons.candidate_count)});
  archive.set_numbers("textons", {static_cast<double>(textons.texton_count)});
  return archive;
}

TextonSet restore_textons(const VdbArchive& archive) {
  expect_kind(archive, "texton set", "sg-textons");
  TextonSet textons;
  textons.layers = read_layers(archive);
  const SampleLayers& layers = textons.layers;
  textons.voxel = archive.number("voxel");
  if (!(textons.voxel > 0)) throw InputError(archive.path + ": the metadata 'voxel' is out of range");
  textons.candidate_count = whole(archive, "candidates", 1, 8);
  textons.texton_count = whole(archive, "textons", 1, 1e6);
  const int levels = whole(archive, "levels", 1, 16);
  const std::size_t count = textons.texel_count();
  const auto read_floats = [&](const std::string& name) {
    std::vector<float> values(count * TextonSet::dimension);
    for (int c = 0; c < TextonSet::dimension; ++c) {
      const auto& grid = archive.get<float>(fmt::format("{}_{}", name, c));
      for_each_texel(layers, [&](std::size_t i, int x, int y, int l) {
        const float value = grid.value(x, y, l);
        if (!std::isfinite(value))
          throw InputError(fmt::format("{}: the grid '{}_{}' holds {}", archive.path, name, c, value));
        values[i * TextonSet::dimension + c] = value;
      });
    }
    return values;
  };
  const auto read_indices = [&](const std::string& name, std::vector<std::int32_t>& values, int stride, int k,
                                int least, int most) {
    const auto& grid = archive.get<std::int32_t>(name);
    for_each_texel(layers, [&](std::size_t i, int x, int y, int l) {
      const std::int32_t value = grid.value(x, y, l);
      if (value < least || value >= most)
        throw InputError(fmt::format("{}: the grid '{}' holds {}, out of range", archive.path, name, value));
      values[i * stride + k] = value;
    });
  };
  const auto& color = archive.get<Vec3f>("color");
  textons.color.resize(count);
  for_each_texel(layers, [&](std::size_t i, int x, int y, int l) { textons.color[i] = color.value(x, y, l); });
  textons.textons.resize(count);
  read_indices("texton", textons.textons, 1, 0, 0, textons.texton_count);
  textons.features = read_floats("feature");
  const int candidates = textons.candidates_each();
  for (int l = 0; l < levels; ++l) {
    TextonSet::Level level;
    level.appearance = read_floats(fmt::format("appearance_{}", l));
    level.candidates.resize(count * candidates);
    for (int k = 0; k < candidates; ++k)
      read_indices(fmt::format("candidate_{}_{}", l, k), level.candidates, candidates, k, -1, static_cast<int>(count));
    textons.levels.push_back(std::move(level));
  }
  return textons;
}

}  // namespace shellgrid
