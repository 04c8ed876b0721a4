// SPDX-License-Identifier: AGPL-3.0-or-later
#include "solvers/shell_texture/shell_light.h"

#include <Eigen/Geometry>
#include <algorithm>
#include <cmath>
#include <numbers>
#include <thread>
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
                       const ShellCurvature* curvature, const BodyShape& shape)
    : shell_(shell),
      frames_(frames),
      incident_(incident),
      texture_(texture),
      core_(core),
      parts_(parts),
      curvature_(curvature),
      shape_(shape),
      relative_ior_(shell.ior),
      vertices_(frames.mesh.vertices) {
  leaves_.resize(static_cast<std::size_t>(shell.texture_coordinate.leaf_count()));
  lights_.resize(static_cast<std::size_t>(frames.mesh.vertex_count()));
  if (!core.empty() && core.size() != lights_.size())
    throw InputError("the core's exitance does not have the surface's size");
  if (!shape.ratios.empty() && shape.ratios.size() != lights_.size())
    throw InputError("the shape's ratios do not have the surface's size");
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
  return {voxels_, static_cast<std::int64_t>(leaves_.made()), static_cast<std::int64_t>(lights_.made())};
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
  return lights_.get(vertex, [&] {
    VertexLight made;
    made.light = prepared(parts_.outside ? incident_.at(vertex) : std::vector<DirectionWeight>());
    if (parts_.outside) {
      SpreadLight::Bands bands = incident_.spread(vertex);
      made.own = std::move(bands.own);
      made.strength = std::move(bands.strength);
      made.spread.reserve(bands.list.size());
      for (std::vector<DirectionWeight>& band : bands.list) made.spread.push_back(prepared(std::move(band)));
    }
    double sum = 0, weights = 0;
    for (const DirectionWeight& one : made.light.light.list) {
      const double weight = static_cast<double>(one.weight.sum()) * texture_.directions().direction(one.direction).z();
      sum += weight / (1 + 1 / refracted_direction(one.direction).z());
      weights += weight;
    }
    // That of one beam which scatters as much back, straight up, as all these do.
    if (weights > 0) made.way = static_cast<float>(weights / sum - 1);
    return made;
  });
}

std::size_t ShellLight::sample_voxel(const Vec3f& place, float& outwards) const {
  const Vec3i& size = texture_.size();
  const auto wrapped = [](int i, int n) { return ((i % n) + n) % n; };
  const Vec3i at(static_cast<int>(std::floor(place.x())), static_cast<int>(std::floor(place.y())),
                 std::clamp(static_cast<int>(std::floor(place.z())), 0, size.z() - 1));
  outwards = static_cast<float>(at.z()) + 0.5f - place.z();
  return (static_cast<std::size_t>(at.z()) * size.y() + wrapped(at.y(), size.y())) * size.x() +
         wrapped(at.x(), size.x());
}

void ShellLight::work_out(int leaf_index, int offset, const Vec3i& voxel, ShellTextureReader& texture, int& vertex,
                          Float4& multiple_and_matter, Beams& beams) const {
  multiple_and_matter = Float4{};
  beams = Beams();
  if (!TwoLevelGrid<Vec3f>::mask_test(shell_.texture_coordinate.leaf_mask(leaf_index), offset)) return;
  const std::int32_t kind = shell_.kind.leaf_values(leaf_index)[offset];
  if (kind == free_space_kind || kind == core_voxel_kind) return;
  vertex = vertices_.nearest(shell_.frame.to_world(voxel), vertex);
  beams.vertex = vertex;
  const Vec3f& place = shell_.texture_coordinate.leaf_values(leaf_index)[offset];
  const VertexLight& light = light_at(vertex);
  const std::size_t sampled = sample_voxel(place, beams.from_middle);
  const bool is_whole = is_matter(sampled);
  Rgb multiple, single;
  const SurfacePlace on_surface = place_about(vertex, shell_.frame.to_world(voxel));
  const PreparedLight& own = light.light.light;
  if (light.strength.empty()) {
    const VoxelLight around = texture.at(place, own);
    multiple = around.multiple;
    single = is_whole ? texture.voxel_light(sampled, own).single : around.single;
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
    multiple = between(
        on_surface, light,
        [&](const VertexLight& at) -> Part {
          return {at.in_band(band), at.list_strength(band), at.strength_in_band(band)};
        },
        [&](const PreparedLight& part) -> const Vec3f& { return at_place(part).multiple; });
    single = between(
        on_surface, light,
        [](const VertexLight& at) -> Part {
          return {at.light, at.light.irradiance, at.light.irradiance};
        },
        [&](const PreparedLight& part) -> Vec3f {
          return is_whole ? texture.voxel_light(sampled, part).single : at_place(part).single;
        });
  }
  multiple = multiple.max(0);
  single = single.max(0);
  Rgb back = Rgb::Ones();
  beams.share.setOnes();
  if (curvature_) {
    const BentShell::Ratios bent = curvature_->at(vertex, place.z());
    single *= bent.single;
    beams.share = bent.single;
    if (!shape_.whole) {
      multiple *= bent.multiple;
      back = bent.back;
    }
  }
  if (!shape_.ratios.empty()) {
    const Rgb ratio = at_place(shape_.ratios, on_surface);
    multiple *= ratio;
    back *= ratio;
  }
  // Radiance M/π from below, and a fluence of 2π times that in I_m(ω_b).
  if (has_core()) multiple += 2 * core_exitance(on_surface) * back * texture.back(place).array().max(0);
  multiple_and_matter = to_lanes(multiple);
  multiple_and_matter[3] = 1;
  beams.source = single / (4 * pi);
  if (is_whole) {
    // e^{−σ s} in the middle over its mean in the voxel, s the beams' way.
    beams.way = light.way;
    beams.normal = frames_.normals.row(vertex).transpose().cast<float>();
    const Rgb extinction = shell_.extinction.value(voxel.x(), voxel.y(), voxel.z()).array();
    beams.fall = (extinction * (light.way * static_cast<float>(shell_.frame.voxel))).min(60.0f);
    const Rgb half = beams.fall / 2, square = half.square();
    const Rgb mean = (half > 2).select((half.exp() - (-half).exp()) / (2 * half.max(1e-6f)),
                                       1 + square / 6 * (1 + square / 20 * (1 + square / 42)));
    beams.source /= mean;
    beams.share /= mean;
  }
  ++voxels_;
}

const ShellLight::Reader::Found& ShellLight::Reader::find_leaf(const Vec3i& leaf_at) {
  Found& found = leaves_[(leaf_at.x() & 1) | (leaf_at.y() & 1) << 1 | (leaf_at.z() & 1) << 2];
  if (leaf_at != found.at) {
    found.at = leaf_at;
    found.index = light_.shell_.texture_coordinate.find_leaf(leaf_at);
    found.leaf = found.index < 0 ? nullptr : &light_.leaves_.get(found.index, [] { return Leaf(); });
  }
  return found;
}

void ShellLight::Reader::need(const Found& found, int offset, const Vec3i& voxel) {
  std::atomic<std::uint8_t>& flag = found.leaf->flags[offset];
  if (flag.load(std::memory_order_acquire) == 2) return;
  Float4 multiple;
  Beams beams;
  light_.work_out(found.index, offset, voxel, *texture_, vertex_, multiple, beams);
  std::uint8_t unknown = 0;
  if (flag.compare_exchange_strong(unknown, 1)) {
    found.leaf->multiple[offset] = multiple;
    found.leaf->beams[offset] = beams;
    flag.store(2, std::memory_order_release);
  } else {
    // Another thread is writing the same.
    while (flag.load(std::memory_order_acquire) != 2) std::this_thread::yield();
  }
}

namespace {

using Grid = TwoLevelGrid<Vec3f>;

// The eight voxels about a point: the lowest one, and weights, x the fastest.
struct EightAbout {
  Vec3i low;
  std::array<float, 8> weights;
  explicit EightAbout(const Vec3& index) {
    const Vec3 floor(std::floor(index.x()), std::floor(index.y()), std::floor(index.z()));
    low = floor.cast<int>();
    const Vec3f high = (index - floor).cast<float>(), rest = Vec3f::Ones() - high;
    for (int corner = 0; corner < 8; ++corner)
      weights[corner] =
          (corner & 1 ? high : rest).x() * (corner & 2 ? high : rest).y() * (corner & 4 ? high : rest).z();
  }
  static Vec3i step(int corner) { return {corner & 1, corner >> 1 & 1, corner >> 2}; }
};

}  // namespace

Rgb ShellLight::Reader::multiple(const Vec3& index) {
  const EightAbout eight(index);
  const Vec3i& low = eight.low;
  Float4 sum = {};
  if ((low.x() & 7) != 7 && (low.y() & 7) != 7 && (low.z() & 7) != 7) {
    const Found& found = find_leaf(Grid::leaf_of(low.x(), low.y(), low.z()));
    if (!found.leaf) return Rgb::Zero();
    const int first = Grid::offset_of(low.x(), low.y(), low.z());
    static constexpr std::array<int, 8> steps = {0, 64, 8, 72, 1, 65, 9, 73};
    std::uint8_t all = 2;
    for (const int step : steps) all &= found.leaf->flags[first + step].load(std::memory_order_acquire);
    if (all != 2)
      for (int corner = 0; corner < 8; ++corner)
        if (eight.weights[corner] > 0) need(found, first + steps[corner], low + EightAbout::step(corner));
    for (int corner = 0; corner < 8; ++corner)
      if (eight.weights[corner] > 0) sum += eight.weights[corner] * found.leaf->multiple[first + steps[corner]];
  } else {
    for (int corner = 0; corner < 8; ++corner) {
      if (!(eight.weights[corner] > 0)) continue;
      const Vec3i voxel = low + EightAbout::step(corner);
      const Found& found = find_leaf(Grid::leaf_of(voxel.x(), voxel.y(), voxel.z()));
      if (!found.leaf) continue;
      const int offset = Grid::offset_of(voxel.x(), voxel.y(), voxel.z());
      need(found, offset, voxel);
      sum += eight.weights[corner] * found.leaf->multiple[offset];
    }
  }
  return sum[3] > 0 ? Rgb(Rgb(sum[0], sum[1], sum[2]) / sum[3]) : Rgb(Rgb::Zero());
}

std::int32_t ShellLight::Reader::vertex(const Vec3& index) {
  const EightAbout eight(index);
  std::int32_t vertex = -1;
  float greatest = 0;
  for (int corner = 0; corner < 8; ++corner) {
    const Vec3i voxel = eight.low + EightAbout::step(corner);
    const Found& found = find_leaf(Grid::leaf_of(voxel.x(), voxel.y(), voxel.z()));
    if (!found.leaf || !(eight.weights[corner] > greatest)) continue;
    const int offset = Grid::offset_of(voxel.x(), voxel.y(), voxel.z());
    need(found, offset, voxel);
    if (found.leaf->beams[offset].vertex < 0) continue;
    greatest = eight.weights[corner];
    vertex = found.leaf->beams[offset].vertex;
  }
  return vertex;
}

Rgb ShellLight::Reader::beams(const Vec3i& voxel, const Vec3& index, const Vec3& direction, const Vec3f& anisotropy,
                              const Rgb& extinction, Rgb& growth) {
  growth = Rgb::Zero();
  const Found& found = find_leaf(Grid::leaf_of(voxel.x(), voxel.y(), voxel.z()));
  if (!found.leaf || !light_.parts_.outside) return Rgb::Zero();
  const int offset = Grid::offset_of(voxel.x(), voxel.y(), voxel.z());
  need(found, offset, voxel);
  const Beams& value = found.leaf->beams[offset];
  if (value.vertex < 0) return Rgb::Zero();
  Rgb source = value.source;
  if (!(anisotropy.cwiseAbs().maxCoeff() < static_cast<float>(isotropic_below))) {
    if (value.vertex != phase_vertex_ || direction != phase_direction_ || anisotropy != phase_anisotropy_) {
      phase_vertex_ = value.vertex;
      phase_direction_ = direction;
      phase_anisotropy_ = anisotropy;
      const Vec3 seen = light_.frames_.frame(value.vertex) * direction;
      std::vector<DirectionWeight> list = light_.light_at(value.vertex).light.light.list;
      for (DirectionWeight& one : list) {
        const double cosine = light_.refracted_direction(one.direction).dot(seen);
        for (int c = 0; c < 3; ++c)
          one.weight[c] *= static_cast<float>(henyey_greenstein(static_cast<double>(anisotropy[c]), cosine)) / (2 * pi);
      }
      phase_light_ = light_.texture_.prepare(std::move(list));
    }
    float outwards;
    const Vec3f& place = light_.shell_.texture_coordinate.value(voxel.x(), voxel.y(), voxel.z());
    const std::size_t sampled = light_.sample_voxel(place, outwards);
    source = (light_.is_matter(sampled) ? texture_->voxel_light(sampled, phase_light_).single
                                        : texture_->at(place, phase_light_).single)
                 .array()
                 .max(0) *
             value.share;
  }
  if (!(value.way > 0)) return source;
  const float outwards = value.from_middle + value.normal.dot((index - voxel.cast<double>()).cast<float>());
  growth = extinction * (value.way * value.normal.dot(direction.cast<float>()));
  return source * (value.fall * outwards).min(60.0f).exp();
}

}  // namespace shellgrid
