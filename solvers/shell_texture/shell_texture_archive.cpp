// SPDX-License-Identifier: AGPL-3.0-or-later
#include "solvers/shell_texture/shell_texture_archive.h"

#include <fmt/format.h>

#include <algorithm>
#include <cmath>
#include <limits>
#include <utility>

#include "meshing/core/error.h"
#include "meshing/core/parallel.h"
#include "meshing/shell/filled_box.h"

namespace shellgrid {
namespace {

constexpr const char* kind = "shell texture function";

std::string name_of(const char* part, int direction, int count) {
  return direction == count ? fmt::format("{}_back", part) : fmt::format("{}_{:02d}", part, direction);
}

std::vector<float> mean_errors(const ShellTexture& t) {
  std::vector<float> result(t.voxel_count(), -1.0f);
  for (std::size_t v = 0; v < result.size(); ++v) {
    double sum = 0;
    int known = 0;
    for (int l = 0; l <= t.directions.count(); ++l) {
      const double e = t.error[t.at(l, v)];
      if (e < 0) continue;
      sum += e * e;
      ++known;
    }
    if (known > 0) result[v] = static_cast<float>(std::sqrt(sum / known));
  }
  return result;
}

int whole(const VdbArchive& archive, double value, const char* key, double most) {
  if (!(value >= 1 && value <= most) || value != std::floor(value))
    throw InputError(fmt::format("{}: the metadata '{}' is out of range", archive.path, key));
  return static_cast<int>(value);
}

void archive_kernels(const ShellTexture& t, VdbArchive& archive) {
  const IrradianceKernels& kernels = t.kernels;
  if (kernels.empty()) return;
  archive.grids.push_back({"kernel", filled_box<std::int32_t>({t.size.x(), t.size.y(), 1}, 0, [&](int x, int y, int) {
                             return kernels.of_texel[static_cast<std::size_t>(y) * t.size.x() + x];
                           })});
  archive.set_numbers("kernel_sizes", {static_cast<double>(kernels.count()), static_cast<double>(kernels.bands()),
                                       static_cast<double>(kernels.rings), kernels.ring});
  archive.set_numbers("kernel_layers", {kernels.first_layer.begin(), kernels.first_layer.end()});
  std::vector<double> values;
  for (const Vec3f& value : kernels.values)
    for (int c = 0; c < 3; ++c) values.push_back(static_cast<double>(value[c]));
  archive.set_numbers("kernel_values", values);
}

void restore_kernels(const VdbArchive& archive, ShellTexture& t) {
  if (!archive.metadata.contains("kernel_sizes")) return;
  IrradianceKernels& kernels = t.kernels;
  const std::vector<double> sizes = archive.numbers("kernel_sizes", 4);
  const int count = whole(archive, sizes[0], "kernel_sizes", 256), bands = whole(archive, sizes[1], "kernel_sizes", 64);
  kernels.rings = whole(archive, sizes[2], "kernel_sizes", 4096);
  kernels.ring = sizes[3];
  for (const double layer : archive.numbers("kernel_layers", bands))
    kernels.first_layer.push_back(static_cast<int>(layer));
  const std::vector<double> values =
      archive.numbers("kernel_values", 3 * static_cast<std::size_t>(count) * bands * kernels.rings);
  for (std::size_t k = 0; k < values.size(); k += 3)
    kernels.values.push_back(Eigen::Vector3d(values[k], values[k + 1], values[k + 2]).cast<float>());
  const auto& grid = archive.get<std::int32_t>("kernel");
  for (int y = 0; y < t.size.y(); ++y)
    for (int x = 0; x < t.size.x(); ++x)
      kernels.of_texel.push_back(static_cast<std::uint8_t>(std::clamp(grid.value(x, y, 0), 0, 255)));
  if (!kernels.is_sound(t.size)) throw InputError(archive.path + ": its irradiance kernels do not fit together");
}

}  // namespace

VdbArchive archive_shell_texture(const ShellTexture& t) {
  VdbArchive archive;
  archive.frame = {Vec3::Constant(0.5 * t.voxel), t.voxel};
  const int count = t.directions.count();
  const auto voxel_at = [&](int x, int y, int z) {
    return (static_cast<std::size_t>(z) * t.size.y() + y) * t.size.x() + x;
  };
  const auto add = [&](const char* part, const std::vector<Vec3f>& values, int l) {
    archive.grids.push_back(
        {name_of(part, l, count), filled_box<Vec3f>(t.size, Vec3f::Zero(), [&](int x, int y, int z) {
           return values[t.at(l, voxel_at(x, y, z))];
         })});
  };
  for (int l = 0; l < count; ++l) add("single", t.single, l);
  for (int l = 0; l <= count; ++l) add("multiple", t.multiple, l);
  const std::vector<float> errors = mean_errors(t);
  const auto add_numbers = [&](const char* name, const std::vector<float>& values, float background) {
    archive.grids.push_back(
        {name, filled_box<float>(t.size, background, [&](int x, int y, int z) { return values[voxel_at(x, y, z)]; })});
  };
  add_numbers("error", errors, -1.0f);
  add_numbers("matter", t.matter, 0.0f);
  archive.grids.push_back(
      {"below", filled_box<Vec3f>({t.size.x(), t.size.y(), count + 1}, Vec3f::Zero(), [&](int x, int y, int l) {
         return t.below[l * t.texel_count() + voxel_at(x, y, 0)];
       })});
  archive.metadata["kind"] = kind;
  archive.set_numbers(
      "size", {static_cast<double>(t.size.x()), static_cast<double>(t.size.y()), static_cast<double>(t.size.z())});
  archive.set_numbers("voxel", {t.voxel});
  archive.set_numbers("rings", {static_cast<double>(t.directions.rings)});
  archive.set_numbers("turns", {static_cast<double>(t.directions.turns)});
  archive_kernels(t, archive);
  return archive;
}

std::vector<std::string> shell_texture_grids(ShellTextureParts parts) {
  if (parts == ShellTextureParts::all) return {};
  return {"matter", "below", "kernel"};
}

ShellTexture restore_shell_texture(const VdbArchive& archive, ShellTextureParts parts) {
  const auto entry = archive.metadata.find("kind");
  if (entry == archive.metadata.end() || entry->second != kind)
    throw InputError(archive.path + ": not a shell texture function as sg-irradiance writes it");
  ShellTexture t;
  const std::vector<double> size = archive.numbers("size", 3);
  for (int axis = 0; axis < 3; ++axis) t.size[axis] = whole(archive, size[axis], "size", 4096);
  t.voxel = archive.number("voxel");
  if (!(t.voxel > 0)) throw InputError(archive.path + ": the metadata 'voxel' is out of range");
  t.directions.rings = whole(archive, archive.number("rings"), "rings", 1000);
  t.directions.turns = whole(archive, archive.number("turns"), "turns", 1000);
  const int count = t.directions.count();
  const std::size_t voxels = static_cast<std::size_t>(t.size.x()) * t.size.y() * t.size.z();
  if (static_cast<double>(voxels) * (count + 1) > 1e9) throw InputError(archive.path + ": too large");
  const auto read = [&](const auto& grid, const auto& put, int layers = 0) {
    std::size_t index = 0;
    for (int z = 0; z < (layers > 0 ? layers : t.size.z()); ++z)
      for (int y = 0; y < t.size.y(); ++y)
        for (int x = 0; x < t.size.x(); ++x) {
          if (!grid.is_active(x, y, z)) throw InputError(archive.path + ": a grid does not fill its size");
          put(index++, grid.value(x, y, z));
        }
  };
  t.matter.resize(voxels);
  read(archive.get<float>("matter"), [&](std::size_t v, float value) { t.matter[v] = value; });
  const auto checked = [&](const std::string& name, const Vec3f& value) {
    if (!value.allFinite() || (value.array() < 0).any())
      throw InputError(fmt::format("{}: a value of {} is negative or not finite", archive.path, name));
    return value;
  };
  t.below.resize(t.texel_count() * (count + 1));
  read(
      archive.get<Vec3f>("below"), [&](std::size_t k, const Vec3f& value) { t.below[k] = checked("below", value); },
      count + 1);
  if (parts == ShellTextureParts::all) {
    t.single.resize(count * voxels);
    t.multiple.resize((count + 1) * voxels);
    t.error.resize((count + 1) * voxels);
    read(archive.get<float>("error"), [&](std::size_t v, float value) {
      for (int l = 0; l <= count; ++l) t.error[t.at(l, v)] = value;
    });
    const auto colours = [&](const char* part, int l, std::vector<Vec3f>& to) {
      const std::string name = name_of(part, l, count);
      read(archive.get<Vec3f>(name), [&](std::size_t v, const Vec3f& value) { to[t.at(l, v)] = checked(name, value); });
    };
    parallel_for(
        static_cast<std::size_t>(count + 1),
        [&](std::size_t k) {
          const int l = static_cast<int>(k);
          if (l < count) colours("single", l, t.single);
          colours("multiple", l, t.multiple);
        },
        1);
  }
  restore_kernels(archive, t);
  return t;
}

std::unique_ptr<ShellTextureLookup> look_up_archive(const VdbArchive& archive) {
  const ShellTexture head = restore_shell_texture(archive, ShellTextureParts::bottom);
  const int count = head.directions.count();
  const Vec3i& size = head.size;
  std::vector<const TwoLevelGrid<Vec3f>*> single, multiple;
  for (int l = 0; l <= count; ++l) {
    if (l < count) single.push_back(&archive.get<Vec3f>(name_of("single", l, count)));
    multiple.push_back(&archive.get<Vec3f>(name_of("multiple", l, count)));
  }
  StoredVoxels voxels(head);
  using Grid = TwoLevelGrid<Vec3f>;
  // Leaf by leaf of all grids, of which those of one place stay in the cache.
  const Vec3i leaves = (size.array() + 7) / 8;
  parallel_for(
      static_cast<std::size_t>(leaves.prod()),
      [&](std::size_t n) {
        const int at = static_cast<int>(n);
        const Vec3i leaf(at % leaves.x(), at / leaves.x() % leaves.y(), at / (leaves.x() * leaves.y()));
        const Vec3i first = 8 * leaf, end = (first.array() + 8).min(size.array());
        const auto take = [&](const Grid& grid, const char* part, int l, const auto& put) {
          const int found = grid.find_leaf(leaf);
          if (found < 0) throw InputError(archive.path + ": a grid does not fill its size");
          const Vec3f* values = grid.leaf_values(found);
          bool is_sound = true, is_full = true;
          for (int z = first.z(); z < end.z(); ++z)
            for (int y = first.y(); y < end.y(); ++y)
              for (int x = first.x(); x < end.x(); ++x) {
                const int offset = Grid::offset_of(x, y, z);
                const Vec3f& value = values[offset];
                is_full = is_full && Grid::mask_test(grid.leaf_mask(found), offset);
                is_sound = is_sound && value.minCoeff() >= 0 && value.sum() < std::numeric_limits<float>::infinity();
                put((static_cast<std::size_t>(z) * size.y() + y) * size.x() + x, value);
              }
          if (!is_full) throw InputError(archive.path + ": a grid does not fill its size");
          if (!is_sound)
            throw InputError(
                fmt::format("{}: a value of {} is negative or not finite", archive.path, name_of(part, l, count)));
        };
        for (int l = 0; l < count; ++l) {
          take(*single[l], "single", l, [&](std::size_t v, const Vec3f& value) { voxels.at(v, l).single = value; });
          take(*multiple[l], "multiple", l,
               [&](std::size_t v, const Vec3f& value) { voxels.at(v, l).multiple = value; });
        }
        take(*multiple[count], "multiple", count, [&](std::size_t v, const Vec3f& value) { voxels.back[v] = value; });
      },
      1);
  return look_up_voxels(head, std::move(voxels));
}

AttributedMesh view_shell_texture(const ShellTexture& t) {
  AttributedMesh view;
  std::vector<std::size_t> shown;
  for (std::size_t v = 0; v < t.voxel_count(); ++v)
    if (t.matter[v] > 0.25f) shown.push_back(v);
  view.mesh.vertices.resize(static_cast<Eigen::Index>(shown.size()), 3);
  std::vector<Vec3f> light(shown.size(), Vec3f::Zero());
  float brightest = 0;
  const std::vector<float> errors = mean_errors(t);
  VertexProperty channels[3] = {{"red", {}}, {"green", {}}, {"blue", {}}}, quality{"quality", {}};
  for (std::size_t k = 0; k < shown.size(); ++k) {
    const std::size_t v = shown[k];
    const auto x = static_cast<double>(v % t.size.x()), y = static_cast<double>(v / t.size.x() % t.size.y()),
               z = static_cast<double>(v / (static_cast<std::size_t>(t.size.x()) * t.size.y()));
    // Depth downwards, as one looks at it.
    view.mesh.vertices.row(static_cast<Eigen::Index>(k)) = t.voxel * Eigen::RowVector3d(x + 0.5, y + 0.5, -z - 0.5);
    for (int l = 0; l < t.directions.turns; ++l)
      light[k] += (t.single[t.at(l, v)] + t.multiple[t.at(l, v)]) / static_cast<float>(t.directions.turns);
    brightest = std::max(brightest, light[k].maxCoeff());
    quality.values.push_back(errors[v]);
  }
  for (const Vec3f& value : light)
    for (int c = 0; c < 3; ++c)
      channels[c].values.push_back(brightest > 0 ? std::pow(value[c] / brightest, 1 / 2.2f) : 0.0f);
  for (VertexProperty& channel : channels) view.properties.push_back(std::move(channel));
  view.properties.push_back(std::move(quality));
  return view;
}

}  // namespace shellgrid
