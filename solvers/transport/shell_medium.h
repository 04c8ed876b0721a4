// SPDX-License-Identifier: AGPL-3.0-or-later
// The matter of a shell of voxels over a homogeneous core, as light paths see it.
#pragma once
#include <algorithm>
#include <cmath>
#include <cstdint>
#include <functional>
#include <limits>
#include <vector>

#include "meshing/shell/shell_volume.h"
#include "solvers/transport/clearance_grid.h"
#include "solvers/transport/diffuse_leap.h"
#include "solvers/transport/light_path.h"
#include "solvers/transport/path_tally.h"
#include "solvers/transport/spectral_weight.h"

namespace shellgrid {

// How paths cross a leaf of 8×8×8 voxels.
enum class LeafMethod : std::uint8_t {
  uniform,  // one matter: no look-ups
  voxels,   // from voxel to voxel
  delta     // delta tracking below the leaf's own majorant
};

struct LeafMethodCounts {
  std::size_t uniform = 0, voxels = 0, delta = 0, without_leaf = 0;
  bool one_majorant = false;  // so thin that one majorant serves all
};

// Throws: InputError where a voxel or the core has coefficients that no matter has.
void check_shell_materials(const ShellVolume& shell);

// Voxels that are not matter but space, for the surface of free space: the shell's, and beyond the outer surface those
// above them. `inside`: whether a point lies within the outer surface.
std::vector<Vec3i> free_voxels_of(const ShellVolume& shell, const std::function<bool(const Vec3&)>& inside);

// Voxel (i, j, k) fills the cube about its sample. Where there is none the core is. Voxels just outside the object, and
// free ones that touch matter, have the matter of their nearest neighbour: the surfaces, not the voxels, say where
// light meets matter.
class ShellMedium {
 public:
  // free_voxels: to be free_voxels_of the shell, or null. method: nothing, or one that all leaves take. Throws:
  // InputError for coefficients that no matter has.
  ShellMedium(const ShellVolume& shell, const std::function<bool(const Vec3&)>& inside,
              std::vector<Vec3i>* free_voxels = nullptr, const LeafMethod* method = nullptr);

  const LeafMethodCounts& methods() const { return methods_; }

  // As HomogeneousMedium::fly.
  template <class Ahead, class Tally>
  bool fly(LightPath& path, double clearance, const Ahead& ahead, Tally& tally) const;

  // As HomogeneousMedium's: of the core, and of matter so thick that a few voxels of it hold many mean free paths.
  const ChannelLeaps* leaps(const LightPath& path) const {
    const std::int32_t index = leaps_of_matter_[path.matter];
    return index >= 0 ? &leaps_[static_cast<std::size_t>(index)] : nullptr;
  }
  double reach(const LightPath& path) const;

  ScatteringPlace place(const LightPath& path) const {
    ScatteringPlace place;
    const Float4 albedo = matter_[path.matter].albedo;
    const auto code = static_cast<std::uint32_t>(albedo[3]);
    const Float4 anisotropy = anisotropy_[code >> 2];
    place.white = code & 1;
    place.region = code & 2 ? 0 : 1;
    place.one_anisotropy = anisotropy[3] != 0;
    place.albedo = to_double(albedo);
    place.anisotropy = to_double(anisotropy);
    place.albedo[3] = place.anisotropy[3] = 0;
    return place;
  }

 private:
  // One kind of matter; voxels name theirs. Many voxels share one, so that all of them stay in the processor's caches.
  struct Matter {
    Float4 extinction = {};
    Float4 albedo = {};  // the last lane: 1 white + 2 core + 4 · index of the anisotropy
  };
  struct Leaf {
    std::uint32_t first = 0;  // of its voxels; of a uniform one its matter
    LeafMethod method = LeafMethod::uniform;
    float majorant = 0;  // mm⁻¹
  };
  // A flight: since its last draw, what one channel has left to go and all have gone through.
  struct Flight {
    int channel = 0;
    double left = 0;  // optical length
    Double4 gone = {};
    bool drawn = false;

    void draw(LightPath& path) {
      channel = choose_channel(path.weight, path.random.next());
      left = path.random.exponential();
      gone = Double4{};
      drawn = true;
    }
    // The weights after what has been gone through.
    void settle(LightPath& path) const {
      path.weight = reweighted(path.weight, path.weight * lane_exponential(lane_broadcast(gone[channel]) - gone));
    }
    void collide(LightPath& path, Double4 extinction) const {
      path.weight =
          reweighted(path.weight, path.weight * extinction * lane_exponential(lane_broadcast(gone[channel]) - gone));
    }
  };

  struct VoxelPlace {
    std::int32_t leaf = -1;  // none
    int offset = 0;
  };
  VoxelPlace voxel_place(const Vec3i& voxel) const {
    const int x = voxel.x() >> 3, y = voxel.y() >> 3, z = voxel.z() >> 3;
    if (!(static_cast<unsigned>(x) < static_cast<unsigned>(count_.x()) &&
          static_cast<unsigned>(y) < static_cast<unsigned>(count_.y()) &&
          static_cast<unsigned>(z) < static_cast<unsigned>(count_.z())))
      return {};
    return {top_[(static_cast<std::size_t>(x) * count_.y() + y) * count_.z() + z],
            (voxel.x() & 7) << 6 | (voxel.y() & 7) << 3 | (voxel.z() & 7)};
  }
  std::uint32_t matter_at(const VoxelPlace& place) const {
    if (place.leaf < 0) return 0;
    const Leaf& leaf = leaves_[static_cast<std::size_t>(place.leaf)];
    return leaf.method == LeafMethod::uniform ? leaf.first
                                              : voxels_[leaf.first + static_cast<std::uint32_t>(place.offset)];
  }
  void prepare_leaps(const std::vector<Material>& materials, const std::vector<Vec3i>& leaf_corners);

  double expected_way(LightPath& path, Flight& flight, std::int32_t index) const;
  template <class Ahead, class Tally>
  bool fly_thin(LightPath& path, double clearance, const Ahead& ahead, Tally& tally) const;
  bool cross_uniform(LightPath& path, Flight& flight, std::uint32_t matter, double& t, double end) const;
  bool cross_voxels(LightPath& path, Flight& flight, const Leaf& leaf, const Vec3& corner, const Vec3& origin,
                    const Vec3& direction, double& t, double end, std::uint64_t& steps) const;
  bool cross_delta(LightPath& path, Flight& flight, const Leaf& leaf, const Vec3& corner, const Vec3& origin,
                   const Vec3& direction, double& t, double end, std::uint64_t& nulls) const;

  Vec3 origin_ = Vec3::Zero();  // of the lowest leaf's lowest corner, mm
  double voxel_ = 1, per_voxel_ = 1;
  Vec3i count_ = Vec3i::Zero();    // leaves
  std::vector<std::int32_t> top_;  // −1: core
  std::vector<Leaf> leaves_;
  std::vector<std::uint32_t> voxels_;  // matter of each
  std::vector<Matter> matter_;         // the core's first
  std::vector<Float4> anisotropy_;     // the last lane: 1 the same in all channels
  double majorant_ = 0;                // of all, mm⁻¹
  bool thin_ = false;                  // all by delta tracking below it
  ClearanceGrid core_clearance_;       // from leaves
  std::vector<ChannelLeaps> leaps_;
  std::vector<std::int32_t> leaps_of_matter_;  // −1: none
  // Of each leaf's voxels, where any matter is thick: how many voxels about each, in all directions, are like it.
  std::vector<std::uint8_t> alike_;
  LeafMethodCounts methods_;
};

// Inner loops --------------------------------------------------------------------------------------------------------

inline bool ShellMedium::cross_uniform(LightPath& path, Flight& flight, std::uint32_t matter, double& t,
                                       double end) const {
  if (!flight.drawn) flight.draw(path);
  const Double4 sigma = to_double(matter_[matter].extinction);
  const double hero = sigma[flight.channel], length = end - t;
  if (hero * length < flight.left || !(hero > 0)) {
    if (length < std::numeric_limits<double>::infinity()) {
      flight.left -= hero * length;
      flight.gone += sigma * length;
    }
    t = end;
    return false;
  }
  const double step = flight.left / hero;
  flight.gone += sigma * step;
  flight.collide(path, sigma);
  path.matter = matter;
  t += step;
  return true;
}

inline bool ShellMedium::cross_voxels(LightPath& path, Flight& flight, const Leaf& leaf, const Vec3& corner,
                                      const Vec3& origin, const Vec3& direction, double& t, double end,
                                      std::uint64_t& steps) const {
  if (!flight.drawn) flight.draw(path);
  constexpr int stride[3] = {64, 8, 1};
  double next[3], interval[3];
  int step[3], left[3], at = 0;
  for (int axis = 0; axis < 3; ++axis) {
    const double d = direction[axis] * per_voxel_, o = (origin[axis] - corner[axis]) * per_voxel_;
    const int cell = std::clamp(static_cast<int>(o + t * d), 0, 7);
    at += cell * stride[axis];
    if (d == 0) {
      next[axis] = interval[axis] = std::numeric_limits<double>::infinity();
      step[axis] = left[axis] = 0;
      continue;
    }
    const double inverse = 1 / d;
    next[axis] = (cell + (d > 0 ? 1 : 0) - o) * inverse;
    interval[axis] = std::abs(inverse);
    step[axis] = d > 0 ? stride[axis] : -stride[axis];
    left[axis] = d > 0 ? 7 - cell : cell;
  }
  const std::uint32_t* const voxels = voxels_.data() + leaf.first;
  const Matter* const matter = matter_.data();
  const int channel = flight.channel;
  double remaining = flight.left;
  Double4 gone = flight.gone;
  for (;;) {
    ++steps;
    const int axis = next[0] < next[1] ? (next[0] < next[2] ? 0 : 2) : (next[1] < next[2] ? 1 : 2);
    const bool last = left[axis] == 0 || next[axis] >= end;
    const double to = last ? end : std::max(next[axis], t), length = to - t;
    const Double4 sigma = to_double(matter[voxels[at]].extinction);
    const double hero = sigma[channel];
    if (hero * length >= remaining && hero > 0) {
      const double stop = remaining / hero;
      flight.gone = gone + sigma * stop;
      flight.collide(path, sigma);
      path.matter = voxels[at];
      t += stop;
      return true;
    }
    remaining -= hero * length;
    gone += sigma * length;
    t = to;
    if (last) break;
    next[axis] += interval[axis];
    --left[axis];
    at += step[axis];
  }
  flight.left = remaining;
  flight.gone = gone;
  return false;
}

inline bool ShellMedium::cross_delta(LightPath& path, Flight& flight, const Leaf& leaf, const Vec3& corner,
                                     const Vec3& origin, const Vec3& direction, double& t, double end,
                                     std::uint64_t& nulls) const {
  if (flight.drawn) {
    flight.settle(path);
    flight.drawn = false;
  }
  const double majorant = leaf.majorant;
  for (;;) {
    t += path.random.exponential() / majorant;
    if (!(t < end)) {
      t = end;
      return false;
    }
    int at = 0;
    for (int axis = 0; axis < 3; ++axis)
      at =
          8 * at + std::clamp(static_cast<int>((origin[axis] + t * direction[axis] - corner[axis]) * per_voxel_), 0, 7);
    const std::uint32_t matter = voxels_[leaf.first + static_cast<std::uint32_t>(at)];
    const Double4 sigma = to_double(matter_[matter].extinction), real = path.weight * sigma;
    if (path.random.next() * majorant * lane_sum(path.weight) < lane_sum(real)) {
      path.weight = reweighted(path.weight, real);
      path.matter = matter;
      return true;
    }
    path.weight = reweighted(path.weight, path.weight * (lane_broadcast(majorant) - sigma));
    ++nulls;
  }
}

// How far a flight may go, mm: to its collision if all was like here.
inline double ShellMedium::expected_way(LightPath& path, Flight& flight, std::int32_t index) const {
  std::uint32_t matter = 0;
  if (index >= 0) {
    const Leaf& leaf = leaves_[static_cast<std::size_t>(index)];
    if (leaf.method == LeafMethod::delta) return 1 / leaf.majorant;
    matter = leaf.method == LeafMethod::uniform ? leaf.first : voxels_[leaf.first];
  }
  if (!flight.drawn) flight.draw(path);
  return flight.left / std::max<double>(1e-30, matter_[matter].extinction[flight.channel]);
}

// Delta tracking below the majorant of all: where collisions are rare everywhere, leaves are not worth a step.
template <class Ahead, class Tally>
bool ShellMedium::fly_thin(LightPath& path, double clearance, const Ahead& ahead, Tally& tally) const {
  double t = 0, wall = clearance;
  bool found = false;
  const Vec3 local = (path.point - origin_) * per_voxel_, step = path.direction * per_voxel_;
  for (;;) {
    t += path.random.exponential() / majorant_;
    if (t >= wall && !found) {
      const double crossing = ahead(t);
      found = crossing <= t;
      wall = found ? crossing : t;
    }
    if (found && t >= wall) return false;
    int voxel[3];
    // A path that slipped out may be anywhere: it must not leave the range of whole numbers.
    for (int axis = 0; axis < 3; ++axis)
      voxel[axis] = static_cast<int>(std::clamp(std::floor(local[axis] + t * step[axis]), -1e9, 1e9));
    const int x = voxel[0] >> 3, y = voxel[1] >> 3, z = voxel[2] >> 3;
    const bool within = static_cast<unsigned>(x) < static_cast<unsigned>(count_.x()) &&
                        static_cast<unsigned>(y) < static_cast<unsigned>(count_.y()) &&
                        static_cast<unsigned>(z) < static_cast<unsigned>(count_.z());
    const std::int32_t index = within ? top_[(static_cast<std::size_t>(x) * count_.y() + y) * count_.z() + z] : -1;
    std::uint32_t matter = 0;
    if (index >= 0) {
      const Leaf& leaf = leaves_[static_cast<std::size_t>(index)];
      matter = leaf.method == LeafMethod::uniform
                   ? leaf.first
                   : voxels_[leaf.first +
                             static_cast<std::uint32_t>((voxel[0] & 7) << 6 | (voxel[1] & 7) << 3 | (voxel[2] & 7))];
    }
    const Double4 sigma = to_double(matter_[matter].extinction), real = path.weight * sigma;
    if (path.random.next() * majorant_ * lane_sum(path.weight) < lane_sum(real)) {
      path.weight = reweighted(path.weight, real);
      path.matter = matter;
      path.point += t * path.direction;
      return true;
    }
    path.weight = reweighted(path.weight, path.weight * (lane_broadcast(majorant_) - sigma));
    tally.note(PathEvent::null_collisions);
  }
}

template <class Ahead, class Tally>
bool ShellMedium::fly(LightPath& path, double clearance, const Ahead& ahead, Tally& tally) const {
  if (thin_) return fly_thin(path, clearance, ahead, tally);
  constexpr double infinite = std::numeric_limits<double>::infinity();
  Flight flight;
  const double core = core_clearance_.at(path.point);
  if (core > 0) {
    flight.draw(path);
    const Double4 sigma = to_double(matter_[0].extinction);
    const double free = flight.left / sigma[flight.channel];
    if (free < std::min(core, clearance)) {
      flight.gone = sigma * free;
      flight.collide(path, sigma);
      path.matter = 0;
      path.point += free * path.direction;
      return true;
    }
  }

  // From leaf to leaf. The surface is asked for when it may be near.
  const Vec3 origin = path.point, direction = path.direction, local = origin - origin_;
  const double leaf_edge = 8 * voxel_;
  int cell[3];
  double next[3], interval[3];
  for (int axis = 0; axis < 3; ++axis) {
    const double d = direction[axis];
    cell[axis] = static_cast<int>(std::floor(local[axis] / leaf_edge));
    next[axis] = d == 0 ? infinite : ((cell[axis] + (d > 0 ? 1 : 0)) * leaf_edge - local[axis]) / d;
    interval[axis] = d == 0 ? infinite : leaf_edge / std::abs(d);
  }
  // How far it is known that nothing is, or where the surface is; asked for little by little: short rays are cheap.
  double t = 0, wall = clearance, asking = voxel_;
  bool found = false;
  std::uint64_t steps = 0, nulls = 0;
  bool collides = false;
  for (;;) {
    const bool within = static_cast<unsigned>(cell[0]) < static_cast<unsigned>(count_.x()) &&
                        static_cast<unsigned>(cell[1]) < static_cast<unsigned>(count_.y()) &&
                        static_cast<unsigned>(cell[2]) < static_cast<unsigned>(count_.z());
    const std::int32_t index =
        within ? top_[(static_cast<std::size_t>(cell[0]) * count_.y() + cell[1]) * count_.z() + cell[2]] : -1;
    const int axis = next[0] < next[1] ? (next[0] < next[2] ? 0 : 2) : (next[1] < next[2] ? 1 : 2);
    // Beyond the grid there is no other leaf to step to.
    const double leaf_end = within ? next[axis] : infinite;
    while (!collides) {
      const double end = std::min(leaf_end, wall);
      if (end > t) {
        if (index < 0) {
          collides = cross_uniform(path, flight, 0, t, end);
        } else {
          const Leaf& leaf = leaves_[static_cast<std::size_t>(index)];
          const Vec3 corner = origin_ + leaf_edge * Vec3(cell[0], cell[1], cell[2]);
          if (leaf.method == LeafMethod::uniform)
            collides = cross_uniform(path, flight, leaf.first, t, end);
          else if (leaf.method == LeafMethod::voxels)
            collides = cross_voxels(path, flight, leaf, corner, origin, direction, t, end, steps);
          else
            collides = cross_delta(path, flight, leaf, corner, origin, direction, t, end, nulls);
        }
      }
      if (collides || found || wall >= leaf_end) break;
      if (!(t < infinite)) break;
      asking = std::max(asking, 2 * expected_way(path, flight, index));
      const double limit = asking < 64 * voxel_ ? t + asking : infinite, crossing = ahead(limit);
      found = crossing <= limit;
      wall = found ? crossing : limit;
      asking *= 4;
    }
    if (collides || (found && wall <= leaf_end) || !(t < infinite)) break;
    t = std::max(t, leaf_end);
    next[axis] += interval[axis];
    cell[axis] += direction[axis] > 0 ? 1 : -1;
  }
  tally.note(PathEvent::voxels, steps);
  tally.note(PathEvent::null_collisions, nulls);
  if (collides) {
    path.point = origin + t * direction;
    return true;
  }
  if (flight.drawn) flight.settle(path);
  return false;
}

}  // namespace shellgrid
