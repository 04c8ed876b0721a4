// SPDX-License-Identifier: AGPL-3.0-or-later
#include "solvers/shell_texture/incident_light.h"

#include <Eigen/Geometry>
#include <algorithm>
#include <array>
#include <bit>
#include <limits>
#include <utility>

#include "meshing/core/error.h"
#include "meshing/surface/box_tree.h"
#include "solvers/shell_texture/shadow_rays.h"
#include "solvers/shell_texture/shared_visibility.h"

namespace shellgrid {

Mat3 TexturedFrames::frame(int vertex) const {
  const Vec3 normal = normals.row(vertex).transpose(), u = directions.row(vertex).transpose();
  Mat3 rows;
  rows.row(0) = u.transpose();
  rows.row(1) = normal.cross(u).transpose();
  rows.row(2) = normal.transpose();
  return rows;
}

namespace {

// Ordered so that each so many of them that follow each other come from about the same direction: halves along the
// axis in which they differ most, again and again.
void put_together(std::vector<SimpleLight>& lights) {
  struct One {
    Vec3 from;
    std::size_t index;
  };
  std::vector<One> all;
  for (std::size_t i = 0; i < lights.size(); ++i) {
    const IncidentBeam beam = incident_beam(lights[i], Vec3::Zero());
    all.push_back({beam.direction, i});
  }
  const auto split = [&](const auto& self, std::size_t begin, std::size_t end) -> void {
    constexpr std::size_t together = SceneGeometry::most_rays;
    if (end - begin <= together) return;
    Box box;
    for (std::size_t i = begin; i < end; ++i) box.add(all[i].from);
    int axis = 0;
    (box.upper - box.lower).maxCoeff(&axis);
    std::stable_sort(all.begin() + static_cast<std::ptrdiff_t>(begin), all.begin() + static_cast<std::ptrdiff_t>(end),
                     [&](const One& a, const One& b) { return a.from[axis] < b.from[axis]; });
    const std::size_t middle = begin + ((end - begin) / 2 + together - 1) / together * together;
    self(self, begin, middle);
    self(self, middle, end);
  };
  split(split, 0, all.size());
  std::vector<SimpleLight> ordered;
  for (const One& one : all) ordered.push_back(lights[one.index]);
  lights = std::move(ordered);
}

constexpr int lanes = DirectionBlends::lanes;

// Light of one direction, summed up by the table's.
class LightByDirection {
 public:
  explicit LightByDirection(const LightDirections& table)
      : table_(table), sums_(static_cast<std::size_t>(table.count()), Float4{}) {}

  // Of the lights in `seen`; x, y, z: towards them, in the sample's frame.
  void add(const DirectionBlends::Numbers (&to)[3], const Float4* irradiance, std::uint32_t seen) {
    const DirectionBlends blends(table_, to[0], to[1], to[2]);
    for (; seen != 0; seen &= seen - 1) {
      const int lane = std::countr_zero(seen);
      for (std::size_t k = 0; k < blends.weights.size(); ++k)
        sums_[blends.directions[k][lane]] += blends.weights[k][lane] * irradiance[lane];
    }
  }
  std::vector<DirectionWeight> list() const {
    const auto lit = [](Float4 sum) { return sum[0] > 0 || sum[1] > 0 || sum[2] > 0; };
    std::vector<DirectionWeight> list;
    list.reserve(static_cast<std::size_t>(std::count_if(sums_.begin(), sums_.end(), lit)));
    for (std::size_t d = 0; d < sums_.size(); ++d)
      if (lit(sums_[d])) list.push_back({static_cast<int>(d), Vec3f(sums_[d][0], sums_[d][1], sums_[d][2])});
    return list;
  }

 private:
  const LightDirections& table_;
  std::vector<Float4> sums_;
};

}  // namespace

IncidentLight::IncidentLight(const TexturedFrames& frames, const SceneGeometry& geometry,
                             const std::vector<Light>& lights, const LightDirections& directions, int samples,
                             bool shared)
    : frames_(frames), geometry_(geometry), directions_(directions) {
  if (frames.normals.rows() != frames.mesh.vertex_count() || frames.directions.rows() != frames.mesh.vertex_count())
    throw InputError("the surface's frames do not have its size");
  std::vector<SimpleLight> parallel;
  Rgb all = Rgb::Zero();
  for (const SimpleLight& light : simple_lights(lights, samples)) {
    const auto* one = std::get_if<DirectionalLight>(&light);
    if (!one) near_.push_back(light);
    if (!one || !(one->irradiance > 0).any()) continue;
    parallel.push_back(light);
    all += one->irradiance;
  }
  put_together(near_);
  put_together(parallel);
  bool any_faint = false;
  std::vector<Vec3> towards;
  for (std::size_t i = 0; i < parallel.size(); ++i) {
    if (i % lanes == 0) parallel_.emplace_back();
    Block& block = parallel_.back();
    const IncidentBeam beam = incident_beam(parallel[i], Vec3::Zero());
    const std::size_t lane = i % lanes;
    for (int axis = 0; axis < 3; ++axis) block.towards[axis][lane] = static_cast<float>(beam.direction[axis]);
    block.irradiance[lane] = to_lanes(beam.irradiance);
    block.lit |= 1u << lane;
    if (shared && !(beam.irradiance > static_cast<float>(faint_share) * all).any()) {
      block.faint |= 1u << lane;
      any_faint = true;
    }
    towards.push_back(beam.direction);
  }
  if (any_faint) visibility_ = std::make_unique<const SharedVisibility>(frames_, geometry_, std::move(towards));
}

IncidentLight::~IncidentLight() = default;

IncidentLightStatistics IncidentLight::statistics() const {
  return {shadow_rays_ + (visibility_ ? visibility_->shadow_rays() : 0), shadow_rays_skipped_, shadow_rays_shared_};
}

std::vector<DirectionWeight> IncidentLight::at(int vertex) const {
  const Mat3 frame = frames_.frame(vertex);
  const Vec3 normal = frames_.normals.row(vertex).transpose();
  const Vec3 origin = frames_.mesh.vertex(vertex) + geometry_.offset() * normal;
  const Eigen::Matrix3f turn = frame.cast<float>();
  const SharedVisibility::Agreed* agreed = visibility_ ? visibility_->about(vertex) : nullptr;
  LightByDirection light(directions_);
  ShadowRays rays(geometry_, origin);
  std::int64_t skipped = 0, told = 0;
  std::vector<std::uint32_t> seen(parallel_.size(), 0);
  const auto unhide = [&](int which) { seen[which / lanes] |= 1u << which % lanes; };
  for (std::size_t b = 0; b < parallel_.size(); ++b) {
    const Block& block = parallel_[b];
    const DirectionBlends::Numbers height =
        turn(2, 0) * block.towards[0] + turn(2, 1) * block.towards[1] + turn(2, 2) * block.towards[2];
    std::uint32_t above = 0;
    // Asked first and shifted then: with its sanitizers GCC 12 takes lane 0 for all that are shifted as they are asked.
    for (int lane = 0; lane < lanes; ++lane)
      if (height[lane] > 0) above |= 1u << lane;
    above &= block.lit;
    const std::uint32_t known = agreed ? above & block.faint & agreed->known(b) : 0;
    if (agreed) seen[b] |= known & agreed->seen(b);
    for (std::uint32_t open = above & ~known; open != 0; open &= open - 1) {
      const int lane = std::countr_zero(open);
      rays.ask(static_cast<int>(b) * lanes + lane,
               Vec3f(block.towards[0][lane], block.towards[1][lane], block.towards[2][lane]).cast<double>(),
               std::numeric_limits<double>::infinity(), unhide);
    }
    skipped += std::popcount(block.lit & ~above);
    told += std::popcount(known);
  }
  rays.finish(unhide);
  const auto shine = [&](const DirectionBlends::Numbers(&towards)[3], const Float4* irradiance, std::uint32_t lit) {
    DirectionBlends::Numbers local[3];
    for (int axis = 0; axis < 3; ++axis)
      local[axis] = turn(axis, 0) * towards[0] + turn(axis, 1) * towards[1] + turn(axis, 2) * towards[2];
    light.add(local, irradiance, lit);
  };
  for (std::size_t b = 0; b < parallel_.size(); ++b)
    if (seen[b] != 0) shine(parallel_[b].towards, parallel_[b].irradiance.data(), seen[b]);
  for (std::size_t first = 0; first < near_.size(); first += lanes) {
    const std::size_t count = std::min<std::size_t>(lanes, near_.size() - first);
    Block block;
    std::uint32_t lit = 0;
    for (std::size_t k = 0; k < count; ++k) {
      const IncidentBeam beam = incident_beam(near_[first + k], origin);
      if (!(beam.direction.dot(normal) > 0) || !(beam.irradiance > 0).any()) {
        ++skipped;
        continue;
      }
      for (int axis = 0; axis < 3; ++axis) block.towards[axis][k] = static_cast<float>(beam.direction[axis]);
      block.irradiance[k] = to_lanes(beam.irradiance);
      rays.ask(static_cast<int>(k), beam.direction, beam.distance, [&](int which) { lit |= 1u << which; });
    }
    rays.finish([&](int which) { lit |= 1u << which; });
    if (lit != 0) shine(block.towards, block.irradiance.data(), lit);
  }
  shadow_rays_ += rays.traced();
  shadow_rays_skipped_ += skipped;
  shadow_rays_shared_ += told;
  return light.list();
}

}  // namespace shellgrid
