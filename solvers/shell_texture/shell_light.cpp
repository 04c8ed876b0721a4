// SPDX-License-Identifier: AGPL-3.0-or-later
#include "solvers/shell_texture/shell_light.h"

#include <Eigen/Geometry>
#include <algorithm>
#include <cmath>
#include <numbers>
#include <utility>

#include "meshing/core/error.h"
#include "solvers/transport/phase.h"

namespace shellgrid {

namespace {

constexpr float pi = std::numbers::pi_v<float>;
constexpr std::int32_t free_space_kind = 0;
constexpr float gentle = 0.5f;

}  // namespace

ShellLight::ShellLight(const ShellVolume& shell, const TexturedFrames& frames, const SpreadLight& incident,
                       const ShellTextureLookup& texture, const std::vector<Rgb>& core, const ShellLightParts& parts,
                       const ShellCurvature* curvature)
    : shell_(shell),
      frames_(frames),
      incident_(incident),
      texture_(texture),
      core_(core),
      parts_(parts),
      curvature_(curvature),
      relative_ior_(shell.ior),
      vertices_(frames.mesh.vertices),
      leaves_(static_cast<std::size_t>(shell.texture_coordinate.leaf_count())),
      lights_(static_cast<std::size_t>(frames.mesh.vertex_count())) {
  if (!core.empty() && core.size() != lights_.size())
    throw InputError("the core's exitance does not have the surface's size");
  const TriangleMesh& mesh = frames.mesh;
  first_face_.assign(lights_.size() + 1, 0);
  for (int f = 0; f < mesh.face_count(); ++f)
    for (int k = 0; k < 3; ++k) ++first_face_[mesh.faces(f, k) + 1];
  for (std::size_t v = 0; v < lights_.size(); ++v) first_face_[v + 1] += first_face_[v];
  std::vector<int> next(first_face_.begin(), first_face_.end() - 1);
  faces_about_.resize(static_cast<std::size_t>(first_face_.back()));
  for (int f = 0; f < mesh.face_count(); ++f)
    for (int k = 0; k < 3; ++k) faces_about_[next[mesh.faces(f, k)]++] = f;
}

ShellLight::Counts ShellLight::counts() const {
  return {voxels_, static_cast<std::int64_t>(owned_.size()), lit_vertices_};
}

ShellLight::Leaf& ShellLight::leaf(int leaf_index) const {
  Leaf* found = leaves_[leaf_index].load(std::memory_order_acquire);
  if (found) return *found;
  const std::lock_guard lock(mutex_);
  found = leaves_[leaf_index].load(std::memory_order_acquire);
  if (!found) {
    owned_.push_back(std::make_unique<Leaf>());
    found = owned_.back().get();
    leaves_[leaf_index].store(found, std::memory_order_release);
  }
  return *found;
}

Vec3 ShellLight::refracted_direction(int direction) const {
  const Vec3 towards = texture_.directions().direction(direction);
  const Vec3 within(towards.x() / relative_ior_, towards.y() / relative_ior_, 0);
  return {within.x(), within.y(), std::sqrt(std::max(0.0, 1 - within.squaredNorm()))};
}

ShellLight::SurfacePlace ShellLight::place_about(int vertex, const Vec3& point) const {
  const TriangleMesh& mesh = frames_.mesh;
  SurfacePlace best{{vertex, vertex, vertex}, {1, 0, 0}};
  double least = -std::numeric_limits<double>::infinity();
  for (int i = first_face_[vertex]; i < first_face_[vertex + 1]; ++i) {
    const int face = faces_about_[i];
    const Vec3 a = mesh.vertex(mesh.faces(face, 0)), u = mesh.vertex(mesh.faces(face, 1)) - a,
               v = mesh.vertex(mesh.faces(face, 2)) - a, at = point - a;
    const Vec3 normal = u.cross(v);
    const double square = normal.squaredNorm();
    if (!(square > 0)) continue;
    const double second = at.cross(v).dot(normal) / square, third = u.cross(at).dot(normal) / square;
    const Vec3 weights(1 - second - third, second, third);
    if (!(weights.minCoeff() > least)) continue;
    least = weights.minCoeff();
    const Vec3 kept = weights.cwiseMax(0) / weights.cwiseMax(0).sum();
    for (int k = 0; k < 3; ++k) {
      best.vertices[k] = mesh.faces(face, k);
      best.weights[k] = static_cast<float>(kept[k]);
    }
  }
  return best;
}

ShellLight::SurfaceLight ShellLight::prepared(std::vector<DirectionWeight> list) const {
  SurfaceLight made;
  for (const DirectionWeight& one : list)
    made.irradiance += one.weight * static_cast<float>(texture_.directions().direction(one.direction).z());
  made.light = texture_.prepare(std::move(list));
  return made;
}

// Where the light is nearly that of the nearest vertex it is the same in another strength.
template <class PartOf, class LookUp>
Vec3f ShellLight::between(const SurfacePlace& place, const VertexLight& own, const PartOf& part,
                          const LookUp& look_up) const {
  const auto scaled = [&](const Part& one, const Vec3f& to) -> Vec3f {
    return look_up(one.light.light).array() *
           (one.list.array() > 0).select(to.array() / one.list.array().max(1e-30f), 1.0f);
  };
  Vec3f mean = Vec3f::Zero();
  for (int k = 0; k < 3; ++k)
    if (place.weights[k] > 0) mean += place.weights[k] * part(light_at(place.vertices[k])).strength;
  const Part nearest = part(own);
  if (((mean - nearest.strength).array().abs() <= gentle * nearest.strength.array()).all())
    return scaled(nearest, mean);
  Vec3f sum = Vec3f::Zero();
  for (int k = 0; k < 3; ++k) {
    if (!(place.weights[k] > 0)) continue;
    const Part one = part(light_at(place.vertices[k]));
    sum += place.weights[k] * scaled(one, one.strength);
  }
  return sum;
}

const ShellLight::VertexLight& ShellLight::light_at(int vertex) const {
  if (const VertexLight* found = lights_[vertex].load(std::memory_order_acquire)) return *found;
  auto made = std::make_unique<VertexLight>();
  made->light = prepared(parts_.outside ? incident_.at(vertex) : std::vector<DirectionWeight>());
  if (parts_.outside) {
    SpreadLight::Bands bands = incident_.spread(vertex);
    made->own = std::move(bands.own);
    made->strength = std::move(bands.strength);
    made->spread.reserve(bands.list.size());
    for (std::vector<DirectionWeight>& band : bands.list) made->spread.push_back(prepared(std::move(band)));
  }
  double sum = 0, weights = 0;
  for (const DirectionWeight& one : made->light.light.list) {
    const double weight = static_cast<double>(one.weight.sum()) * texture_.directions().direction(one.direction).z();
    sum += weight / (1 + 1 / refracted_direction(one.direction).z());
    weights += weight;
  }
  // That of one beam which scatters as much back, straight up, as all these do.
  if (weights > 0) made->way = static_cast<float>(weights / sum - 1);
  const std::lock_guard lock(mutex_);
  if (const VertexLight* found = lights_[vertex].load(std::memory_order_acquire)) return *found;
  owned_lights_.push_back(std::move(made));
  lights_[vertex].store(owned_lights_.back().get(), std::memory_order_release);
  ++lit_vertices_;
  return *owned_lights_.back();
}

std::size_t ShellLight::sample_voxel(const Vec3f& place, Vec3f& offset) const {
  const Vec3i& size = texture_.size();
  const auto wrapped = [](int i, int n) { return ((i % n) + n) % n; };
  const Vec3i at(static_cast<int>(std::floor(place.x())), static_cast<int>(std::floor(place.y())),
                 std::clamp(static_cast<int>(std::floor(place.z())), 0, size.z() - 1));
  offset = place - (at.cast<float>() + Vec3f::Constant(0.5f));
  offset.z() = -offset.z();
  return (static_cast<std::size_t>(at.z()) * size.y() + wrapped(at.y(), size.y())) * size.x() +
         wrapped(at.x(), size.x());
}

ShellLight::VoxelFluence ShellLight::work_out(int leaf_index, int offset, const Vec3i& voxel,
                                              ShellTextureReader& texture, int& vertex) const {
  VoxelFluence value;
  const std::int32_t kind = shell_.kind.leaf_values(leaf_index)[offset];
  if (kind == free_space_kind || kind == core_voxel_kind) return value;
  value.matter = true;
  vertex = vertices_.nearest(shell_.frame.to_world(voxel), vertex);
  value.vertex = vertex;
  const Vec3f& place = shell_.texture_coordinate.leaf_values(leaf_index)[offset];
  const VertexLight& light = light_at(vertex);
  const std::size_t sampled = sample_voxel(place, value.offset);
  value.whole = texture_.matter()[sampled] > 0.999f;
  const SurfacePlace on_surface = place_about(vertex, shell_.frame.to_world(voxel));
  const PreparedLight& own = light.light.light;
  if (light.strength.empty()) {
    const VoxelLight around = texture.at(place, own);
    value.multiple = around.multiple;
    value.single = value.whole ? texture.voxel_light(sampled, own).single : around.single;
  } else {
    // Of one light both are found at once.
    const PreparedLight* looked_up = nullptr;
    VoxelLight around;
    const auto at_place = [&](const PreparedLight& part) -> const VoxelLight& {
      if (&part != looked_up) around = texture.at(place, part);
      looked_up = &part;
      return around;
    };
    const int band = texture_.kernels().band_of(static_cast<int>(place.z()));
    value.multiple = between(
        on_surface, light,
        [&](const VertexLight& at) -> Part {
          return {at.in_band(band), at.list_strength(band), at.strength_in_band(band)};
        },
        [&](const PreparedLight& part) -> const Vec3f& { return at_place(part).multiple; });
    value.single = between(
        on_surface, light,
        [](const VertexLight& at) -> Part {
          return {at.light, at.light.irradiance, at.light.irradiance};
        },
        [&](const PreparedLight& part) -> Vec3f {
          return value.whole ? texture.voxel_light(sampled, part).single : at_place(part).single;
        });
  }
  value.multiple = value.multiple.max(0);
  value.single = value.single.max(0);
  Rgb back = Rgb::Ones();
  if (curvature_) {
    const BentShell::Ratios bent = curvature_->at(vertex, place.z());
    value.multiple *= bent.multiple;
    value.single *= bent.single;
    value.bent = bent.single;
    back = bent.back;
  }
  // Radiance M/π from below, and a fluence of 2π times that in I_m(ω_b).
  if (has_core()) value.multiple += 2 * core_exitance(on_surface) * back * texture.back(place).array().max(0);
  ++voxels_;
  return value;
}

const ShellLight::VoxelFluence* ShellLight::Reader::at(const Vec3i& voxel) {
  const auto& grid = light_.shell_.texture_coordinate;
  const Vec3i leaf_at = TwoLevelGrid<Vec3f>::leaf_of(voxel.x(), voxel.y(), voxel.z());
  if (leaf_at != leaf_at_) {
    leaf_at_ = leaf_at;
    leaf_index_ = grid.find_leaf(leaf_at);
    leaf_ = leaf_index_ < 0 ? nullptr : &light_.leaf(leaf_index_);
  }
  if (!leaf_) return nullptr;
  const int offset = TwoLevelGrid<Vec3f>::offset_of(voxel.x(), voxel.y(), voxel.z());
  Leaf& leaf = *leaf_;
  VoxelFluence* value = &leaf.values[offset];
  if (leaf.flags[offset].load(std::memory_order_acquire) != 2) {
    if (!TwoLevelGrid<Vec3f>::mask_test(grid.leaf_mask(leaf_index_), offset)) return nullptr;
    const VoxelFluence found = light_.work_out(leaf_index_, offset, voxel, *texture_, vertex_);
    std::uint8_t unknown = 0;
    if (leaf.flags[offset].compare_exchange_strong(unknown, 1)) {
      *value = found;
      leaf.flags[offset].store(2, std::memory_order_release);
    } else {
      // Another thread is writing the same.
      value = &spare_[next_spare_++ % spare_.size()];
      *value = found;
    }
  }
  return value->matter ? value : nullptr;
}

Rgb ShellLight::Reader::multiple(const Vec3& index, std::int32_t& vertex) {
  const Vec3i low(static_cast<int>(std::floor(index.x())), static_cast<int>(std::floor(index.y())),
                  static_cast<int>(std::floor(index.z())));
  const Vec3f part = (index - low.cast<double>()).cast<float>();
  Rgb sum = Rgb::Zero();
  float weights = 0, greatest = 0;
  for (int corner = 0; corner < 8; ++corner) {
    const Vec3i step(corner & 1, corner >> 1 & 1, corner >> 2);
    float weight = 1;
    for (int a = 0; a < 3; ++a) weight *= step[a] ? part[a] : 1 - part[a];
    if (!(weight > 0)) continue;
    const VoxelFluence* value = at(low + step);
    if (!value) continue;
    sum += weight * value->multiple;
    weights += weight;
    if (weight > greatest) {
      greatest = weight;
      vertex = value->vertex;
    }
  }
  return weights > 0 ? Rgb(sum / weights) : Rgb(Rgb::Zero());
}

Rgb ShellLight::Reader::beams(const Vec3i& voxel, const Vec3& index, const Vec3& direction, const Vec3f& anisotropy,
                              const Rgb& extinction, Rgb& growth) {
  growth = Rgb::Zero();
  const VoxelFluence* found = at(voxel);
  if (!found || !light_.parts_.outside) return Rgb::Zero();
  const VoxelFluence& value = *found;
  const VertexLight& light = light_.light_at(value.vertex);
  const Mat3 frame = light_.frames_.frame(value.vertex);
  Rgb source;
  if (anisotropy.cwiseAbs().maxCoeff() < static_cast<float>(isotropic_below)) {
    source = value.single / (4 * pi);
  } else {
    if (value.vertex != phase_vertex_ || direction != phase_direction_ || anisotropy != phase_anisotropy_) {
      phase_vertex_ = value.vertex;
      phase_direction_ = direction;
      phase_anisotropy_ = anisotropy;
      const Vec3 seen = frame * direction;
      std::vector<DirectionWeight> list = light.light.light.list;
      for (DirectionWeight& one : list) {
        const double cosine = light_.refracted_direction(one.direction).dot(seen);
        for (int c = 0; c < 3; ++c)
          one.weight[c] *= static_cast<float>(henyey_greenstein(static_cast<double>(anisotropy[c]), cosine)) / (2 * pi);
      }
      phase_light_ = light_.texture_.prepare(std::move(list));
    }
    Vec3f offset;
    const Vec3f& place = light_.shell_.texture_coordinate.value(voxel.x(), voxel.y(), voxel.z());
    source = (value.whole ? texture_->voxel_light(light_.sample_voxel(place, offset), phase_light_).single
                          : texture_->at(place, phase_light_).single)
                 .array()
                 .max(0) *
             value.bent;
  }
  if (!value.whole) return source;
  // e^{−σ s} over its mean in the voxel, s the beams' way from the depth of the voxel's middle.
  const Vec3f from_middle = value.offset + (frame * (index - voxel.cast<double>())).cast<float>();
  growth = extinction * (light.way * (frame * direction).cast<float>().z());
  const Rgb across = (extinction * (light.way * static_cast<float>(light_.shell_.frame.voxel))).min(60.0f);
  const Rgb half = across / 2, square = half.square();
  const Rgb mean = (half > 2).select((half.exp() - (-half).exp()) / (2 * half.max(1e-6f)),
                                     1 + square / 6 * (1 + square / 20 * (1 + square / 42)));
  return source * (across * from_middle.z()).min(60.0f).exp() / mean;
}

}  // namespace shellgrid
