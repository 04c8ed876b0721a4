// SPDX-License-Identifier: AGPL-3.0-or-later
#include "solvers/shell_texture/shell_texture_lookup.h"

#include <algorithm>
#include <cmath>
#include <utility>

#include "meshing/core/error.h"
#include "meshing/core/parallel.h"

namespace shellgrid {
namespace {

// A place between two neighbours of a row of cells whose middles are at ½, 1½, …
struct Between {
  int first, second;
  float t;
};

Between wrapped_between(float place, int count) {
  const float at = place - 0.5f, floor = std::floor(at);
  const auto wrapped = static_cast<int>(floor - static_cast<float>(count) * std::floor(floor / count));
  const int first = std::clamp(wrapped, 0, count - 1);
  return {first, first + 1 < count ? first + 1 : 0, at - floor};
}

Between clamped_between(float place, int count) {
  const float at = std::clamp(place - 0.5f, 0.0f, static_cast<float>(count - 1)), floor = std::floor(at);
  const int first = static_cast<int>(floor);
  return {first, std::min(first + 1, count - 1), at - floor};
}

}  // namespace

ShellTextureLookup::ShellTextureLookup(const ShellTexture& texture)
    : size_(texture.size),
      voxel_(texture.voxel),
      directions_(texture.directions),
      matter_(texture.matter),
      below_(texture.below),
      kernels_(texture.kernels) {
  const std::size_t voxels = static_cast<std::size_t>(size_.x()) * size_.y() * size_.z();
  const std::size_t texels = static_cast<std::size_t>(size_.x()) * size_.y();
  if (voxels == 0 || matter_.size() != voxels || below_.size() != texels * (directions_.count() + 1))
    throw InputError("shell texture function: its arrays do not have its size");
}

Vec3f ShellTextureLookup::below_at(float x, float y, int direction) const {
  const Between i = wrapped_between(x, size_.x()), j = wrapped_between(y, size_.y());
  const Vec3f* values = below_.data() + static_cast<std::size_t>(direction) * size_.x() * size_.y();
  const auto row = [&](int v) -> Vec3f {
    const std::size_t begin = static_cast<std::size_t>(v) * size_.x();
    return (1 - i.t) * values[begin + i.first] + i.t * values[begin + i.second];
  };
  return (1 - j.t) * row(j.first) + j.t * row(j.second);
}

PreparedLight ShellTextureLookup::prepare(std::vector<DirectionWeight> list) const {
  for (const DirectionWeight& part : list)
    if (part.direction < 0 || part.direction >= directions_.count())
      throw InputError("shell texture function: light from a direction that it does not have");
  PreparedLight light{std::move(list), {}};
  find_coefficients(light);
  return light;
}

Vec3f ShellTextureLookup::below(float x, float y, const PreparedLight& light) const {
  Vec3f sum = Vec3f::Zero();
  for (const DirectionWeight& part : light.list) sum += part.weight.cwiseProduct(below_at(x, y, part.direction));
  return sum;
}

Vec3f ShellTextureLookup::below_of_back_light(float x, float y) const { return below_at(x, y, directions_.back()); }

template <class Value, class Read>
Value ShellTextureReader::interpolate(const Vec3f& point, const Read& read) {
  const Vec3i& size = lookup_.size();
  const Between x = wrapped_between(point.x(), size.x()), y = wrapped_between(point.y(), size.y());
  Between z = clamped_between(point.z(), size.z());
  for (;;) {
    Value sum;
    float whole = 0;
    for (int corner = 0; corner < 8; ++corner) {
      const int i = corner & 1 ? x.second : x.first, j = corner & 2 ? y.second : y.first,
                k = corner & 4 ? z.second : z.first;
      const std::size_t index = (static_cast<std::size_t>(k) * size.y() + j) * size.x() + i;
      const float matter = lookup_.matter()[index];
      const float weight =
          matter * (corner & 1 ? x.t : 1 - x.t) * (corner & 2 ? y.t : 1 - y.t) * (corner & 4 ? z.t : 1 - z.t);
      if (!(matter > least_matter && weight > 0)) continue;
      sum.add(weight, read(index));
      whole += weight;
    }
    if (whole > 0) return sum.over(whole);
    if (z.first + 1 >= size.z()) return sum;
    z = {z.first + 1, std::min(z.first + 2, size.z() - 1), 0};
  }
}

namespace {

struct LightSum {
  VoxelLight value;
  void add(float weight, const VoxelLight& light) {
    value.single += weight * light.single;
    value.multiple += weight * light.multiple;
  }
  LightSum over(float whole) const { return {{value.single / whole, value.multiple / whole}}; }
};

struct ColourSum {
  Vec3f value = Vec3f::Zero();
  void add(float weight, const Vec3f& colour) { value += weight * colour; }
  ColourSum over(float whole) const { return {value / whole}; }
};

}  // namespace

VoxelLight ShellTextureReader::at(const Vec3f& point, const PreparedLight& light) {
  return interpolate<LightSum>(point, [&](std::size_t index) { return voxel_light(index, light); }).value;
}

Vec3f ShellTextureReader::back(const Vec3f& point) {
  return interpolate<ColourSum>(point, [&](std::size_t index) { return voxel_back(index); }).value;
}

namespace {

class PlainLookup : public ShellTextureLookup {
 public:
  PlainLookup(const ShellTexture& t, StoredVoxels voxels) : ShellTextureLookup(t), voxels_(std::move(voxels)) {}

  std::unique_ptr<ShellTextureReader> reader() const override;
  std::size_t bytes() const override {
    return voxels_.light.size() * sizeof(VoxelLight) + voxels_.back.size() * sizeof(Vec3f);
  }

 private:
  friend class PlainReader;
  StoredVoxels voxels_;
};

class PlainReader : public ShellTextureReader {
 public:
  explicit PlainReader(const PlainLookup& lookup) : ShellTextureReader(lookup), lookup_(lookup) {}
  VoxelLight voxel_light(std::size_t voxel_index, const PreparedLight& light) override {
    const VoxelLight* row = lookup_.voxels_.row(voxel_index);
    VoxelLight sum;
    for (const DirectionWeight& part : light.list) {
      sum.single += part.weight.cwiseProduct(row[part.direction].single);
      sum.multiple += part.weight.cwiseProduct(row[part.direction].multiple);
    }
    return sum;
  }
  Vec3f voxel_back(std::size_t voxel_index) override { return lookup_.voxels_.back[voxel_index]; }

 private:
  const PlainLookup& lookup_;
};

std::unique_ptr<ShellTextureReader> PlainLookup::reader() const { return std::make_unique<PlainReader>(*this); }

}  // namespace

namespace {

class BottomLookup : public ShellTextureLookup {
 public:
  explicit BottomLookup(const ShellTexture& t) : ShellTextureLookup(t) {}
  std::unique_ptr<ShellTextureReader> reader() const override {
    throw InternalError("shell texture function: only its bottom was read");
  }
  std::size_t bytes() const override { return 0; }
};

}  // namespace

std::unique_ptr<ShellTextureLookup> look_up_bottom(const ShellTexture& texture) {
  return std::make_unique<BottomLookup>(texture);
}

StoredVoxels::StoredVoxels(const ShellTexture& texture)
    : directions(texture.directions.count()), light(texture.voxel_count() * directions), back(texture.voxel_count()) {}

std::unique_ptr<ShellTextureLookup> look_up_voxels(const ShellTexture& texture, StoredVoxels voxels) {
  return std::make_unique<PlainLookup>(texture, std::move(voxels));
}

std::unique_ptr<ShellTextureLookup> look_up_as_it_is(const ShellTexture& t) {
  const std::size_t count = t.voxel_count();
  const int directions = t.directions.count();
  if (t.single.size() != count * directions || t.multiple.size() != count * (directions + 1))
    throw InputError("shell texture function: its arrays do not have its size");
  StoredVoxels voxels(t);
  std::copy(t.multiple.end() - static_cast<std::ptrdiff_t>(count), t.multiple.end(), voxels.back.begin());
  constexpr std::size_t block = 64;  // voxels: their lines stay in the cache from direction to direction
  parallel_for((count + block - 1) / block,
               [&](std::size_t b) {
                 for (int l = 0; l < directions; ++l)
                   for (std::size_t v = b * block; v < std::min(count, (b + 1) * block); ++v)
                     voxels.at(v, l) = {t.single[t.at(l, v)], t.multiple[t.at(l, v)]};
               },
               16);
  return look_up_voxels(t, std::move(voxels));
}

}  // namespace shellgrid
