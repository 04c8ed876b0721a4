// SPDX-License-Identifier: AGPL-3.0-or-later
// How light goes through a periodic slab: from event to event, and from voxel to voxel between.
#pragma once
#include <algorithm>
#include <cmath>
#include <limits>
#include <vector>

#include "solvers/shell_texture/periodic_slab.h"
#include "solvers/transport/dielectric.h"
#include "solvers/transport/path_random.h"
#include "solvers/transport/phase.h"
#include "solvers/transport/roulette.h"
#include "solvers/transport/spectral_weight.h"

namespace shellgrid {

// ∫₀^ℓ e^(−σ s) ds, with `left` = e^(−σ ℓ).
inline Double4 mean_way(const Double4& extinction, double length, const Double4& left) {
  Double4 way;
  for (int c = 0; c < 3; ++c) {
    const double depth = extinction[c] * length;
    way[c] = depth > 1e-5 ? (1 - left[c]) / extinction[c] : length * (1 - 0.5 * depth);
  }
  way[3] = 0;
  return way;
}

struct SlabPath {
  PathRandom random;
  Vec3 point = Vec3::Zero(), direction = Vec3::Zero();  // x and y within the tile
  Double4 weight = {1.0 / 3, 1.0 / 3, 1.0 / 3, 0};
  bool in_matter = false;
  std::size_t voxel = 0;  // of the last collision
  std::uint64_t events = 0, next_limit = event_limit;
  int level = 0;  // of its weight: 2^-level of that of a path which was never split
};

constexpr std::uint64_t slab_leaps_begin = 50;  // events of a path, before its first leap

class SlabWalk {
 public:
  enum class Side { x = 0, y = 1, ends = 2, surface = 3 };
  struct Exit {
    double distance = std::numeric_limits<double>::infinity();
    Side side = Side::ends;
    Vec3 normal = Vec3::Zero();  // of the surface
    bool is_known() const { return distance < std::numeric_limits<double>::infinity(); }
  };

  explicit SlabWalk(const PeriodicSlab& slab) : slab_(slab) {}
  const PeriodicSlab& slab() const { return slab_; }

  // Light from above that comes to (x, y) of the plane over the slab; `to_light` with z up.
  void start_above(SlabPath& path, const Vec3& to_light, double x, double y) const {
    path.point = Vec3(x, y, slab_.top());
    path.direction = Vec3(-to_light.x(), -to_light.y(), to_light.z());
    path.in_matter = false;
  }

  // Light from below, as much from each direction.
  void start_below(SlabPath& path) const {
    const double x = path.random.next() * slab_.width(0), y = path.random.next() * slab_.width(1);
    path.point = Vec3(x, y, slab_.depth());
    path.in_matter = slab_.is_matter_at_bottom(x, y);
    const double cosine = std::sqrt(1 - path.random.next()), sine = std::sqrt(std::max(0.0, 1 - cosine * cosine));
    const CosineSine azimuth = path.random.azimuth();
    path.direction = Vec3(sine * azimuth.cosine, sine * azimuth.sine, -cosine);
  }

  // Where a path gets to without a collision: the mesostructure surface, the tile's side, its bottom, or in free space
  // its top.
  Exit next_exit(const SlabPath& path) const {
    Exit exit;
    const auto consider = [&](double distance, Side side) {
      if (distance < exit.distance) exit.distance = std::max(0.0, distance), exit.side = side;
    };
    const Vec3 &point = path.point, &direction = path.direction;
    for (int axis = 0; axis < 2; ++axis)
      if (direction[axis] != 0)
        consider(((direction[axis] > 0 ? slab_.width(axis) : 0) - point[axis]) / direction[axis],
                 static_cast<Side>(axis));
    if (direction.z() > 0)
      consider((slab_.depth() - point.z()) / direction.z(), Side::ends);
    else if (direction.z() < 0)
      // In matter the surface is met first; one voxel above it a path has slipped out.
      consider((slab_.top() - (path.in_matter ? slab_.voxel() : 0) - point.z()) / direction.z(), Side::ends);
    double distance = 0;
    Vec3 normal;
    if (slab_.meet_surface(point, direction, exit.distance, path.in_matter, distance, normal))
      exit = {distance, Side::surface, normal};
    return exit;
  }

  void wrap(SlabPath& path, Side side) const {
    const int axis = static_cast<int>(side);
    path.point[axis] = path.direction[axis] > 0 ? 0 : slab_.width(axis);
  }

  // Calls visit(voxel, begin, length) for the voxels on the way until it says false.
  template <class Visit>
  void walk_voxels(const SlabPath& path, double end, const Visit& visit) const {
    constexpr double infinite = std::numeric_limits<double>::infinity();
    const Vec3i& size = slab_.size();
    const std::ptrdiff_t stride[3] = {1, size.x(), static_cast<std::ptrdiff_t>(size.x()) * size.y()};
    int cell[3];
    double next[3], interval[3];
    std::ptrdiff_t at = 0;
    for (int axis = 0; axis < 3; ++axis) {
      const double d = path.direction[axis], o = path.point[axis];
      cell[axis] = std::clamp(static_cast<int>(std::floor(o / slab_.voxel())), 0, size[axis] - 1);
      // On a side the voxel is the one ahead.
      if (d < 0 && cell[axis] > 0 && cell[axis] * slab_.voxel() >= o) --cell[axis];
      at += cell[axis] * stride[axis];
      next[axis] = d == 0 ? infinite : ((cell[axis] + (d > 0 ? 1 : 0)) * slab_.voxel() - o) / d;
      interval[axis] = d == 0 ? infinite : slab_.voxel() / std::abs(d);
    }
    double t = 0;
    for (;;) {
      const int axis = next[0] < next[1] ? (next[0] < next[2] ? 0 : 2) : (next[1] < next[2] ? 1 : 2);
      const int step = path.direction[axis] > 0 ? 1 : -1;
      // Above and below the volume its outermost voxels go on.
      const bool last = next[axis] >= end || cell[axis] + step < 0 || cell[axis] + step >= size[axis];
      const double to = last ? end : std::max(next[axis], t);
      if (to > t && !visit(static_cast<std::size_t>(at), t, to - t)) return;
      if (last) return;
      t = to;
      next[axis] += interval[axis];
      cell[axis] += step;
      at += step * stride[axis];
    }
  }

  // To the collision, and true; or to the end. Calls deposit(voxel, way) with the ways expected in each voxel as if it
  // went through it: the collision's place is another draw.
  template <class Deposit>
  bool fly(SlabPath& path, double end, const Deposit& deposit) const {
    const Double4 before = path.weight;
    const int hero = choose_channel(before, path.random.next());
    double left = path.random.exponential();
    Double4 passed = {1, 1, 1, 0};
    bool collides = false;
    double stop = end;
    walk_voxels(path, end, [&](std::size_t voxel, double begin, double length) {
      const Double4 extinction = to_double(slab_.matter(voxel).extinction);
      const Double4 kept = lane_exponential(-extinction * length);
      deposit(voxel, reweighted(before, before * passed) * mean_way(extinction, length, kept));
      if (extinction[hero] * length >= left && extinction[hero] > 0) {
        const double way = left / extinction[hero];
        stop = begin + way;
        path.weight = reweighted(before, before * passed * lane_exponential(-extinction * way) * extinction);
        path.voxel = voxel;
        collides = true;
        return false;
      }
      left -= extinction[hero] * length;
      passed *= kept;
      return true;
    });
    path.point += stop * path.direction;
    if (!collides) path.weight = reweighted(before, before * passed);
    return collides;
  }

  // What a collision leaves of the light goes on in another direction. False: the path ends.
  bool scatter(SlabPath& path) const {
    path.weight *= to_double(slab_.matter(path.voxel).albedo);
    if (!outlives_faintness(path)) return false;
    turn(path);
    return true;
  }

  // By its weight against that of others of its level.
  static bool outlives_faintness(SlabPath& path) {
    const double before = lane_sum(path.weight);
    if (!(before > 0)) return false;
    const double unsplit = std::ldexp(1.0, path.level);
    double weight = before * unsplit;
    if (!survives_faintness(weight, path.random)) return false;
    path.weight *= weight / (unsplit * before);
    return true;
  }

  // Another direction, by the phase function of the voxel of the collision.
  void turn(SlabPath& path) const {
    const Double4 g = to_double(slab_.matter(path.voxel).anisotropy);
    const int hero = choose_channel(path.weight, path.random.next());
    const Vec3 old = path.direction;
    path.direction = scattered(old, g[hero], path.random);
    if (g[0] != g[1] || g[1] != g[2]) {
      const double cosine = std::clamp(old.dot(path.direction), -1.0, 1.0);
      Double4 drawn = path.weight;
      for (int c = 0; c < 3; ++c) drawn[c] *= henyey_greenstein(g[c], cosine);
      path.weight = reweighted(path.weight, drawn);
    }
  }

  // At the surface. True: mirrored.
  bool meet(SlabPath& path, const Vec3& normal) const {
    const Meeting m = meeting(path, normal);
    if (path.random.next() < m.boundary.reflectance) {
      path.direction = mirrored(path.direction, m.against, m.cosine);
      return true;
    }
    pass(path, m);
    return false;
  }

  struct Meeting {
    BoundaryMeeting boundary;
    Vec3 against;
    double cosine, relative;
  };
  Meeting meeting(const SlabPath& path, const Vec3& normal) const {
    Meeting m;
    m.cosine = std::min(1.0, std::abs(normal.dot(path.direction)));
    const double ior = slab_.ior(path.point, normal);
    m.relative = path.in_matter ? 1 / ior : ior;
    m.against = path.in_matter ? Vec3(-normal) : normal;
    m.boundary = meet_boundary(m.cosine, m.relative);
    return m;
  }
  void pass(SlabPath& path, const Meeting& m) const {
    path.direction = refracted(path.direction, m.against, m.cosine, m.boundary.cosine_beyond, m.relative);
    path.in_matter = !path.in_matter;
  }

  // Follows light to its end. `visitor` has
  //   void way(std::size_t voxel, Double4 way)   a stretch in matter, weights times lengths
  //   void collided(const SlabPath&)             with the weights before the albedo takes its share
  //   void mirrored()
  //   void wrapped(int axis, double by)          may be missing: the tile's other side, so far off
  //   void leapt()                               may be missing: then collisions are taken one by one, wherever they
  //   are void left(const SlabPath&)                 through the top, or where the direction's z is positive the bottom
  template <class Visitor>
  void follow(SlabPath& path, Visitor& visitor) const {
    if constexpr (requires { visitor.level(path); }) {
      thread_local std::vector<SlabPath> others;
      others.clear();
      follow(path, visitor, &others);
      while (!others.empty()) {
        SlabPath other = others.back();
        others.pop_back();
        follow(other, visitor, &others);
      }
    } else {
      follow(path, visitor, nullptr);
    }
  }

 private:
  template <class Visitor>
  void follow(SlabPath& path, Visitor& visitor, std::vector<SlabPath>* others) const {
    for (;;) {
      if (++path.events >= path.next_limit) {
        if (meet_event_limit(path.events, path.next_limit, path.random) != LimitOutcome::goes_on) return;
        path.weight *= limit_weight;
      }
      const Exit exit = next_exit(path);
      if (!exit.is_known()) return;
      if (path.in_matter) {
        if (fly(path, exit.distance, [&](std::size_t voxel, const Double4& way) { visitor.way(voxel, way); })) {
          visitor.collided(path);
          const Vec3 before = path.direction;
          if (!scatter(path)) return;
          if constexpr (requires { visitor.level(path); })
            if (!keep_level(path, visitor.level(path), *others)) return;
          if constexpr (requires { visitor.leapt(); })
            if (path.events >= slab_leaps_begin && !leap(path, before, visitor)) return;
          continue;
        }
      } else {
        path.point += exit.distance * path.direction;
      }
      if (exit.side == Side::surface) {
        if (meet(path, exit.normal)) visitor.mirrored();
      } else if (exit.side == Side::ends) {
        visitor.left(path);
        return;
      } else {
        wrap(path, exit.side);
        if constexpr (requires { visitor.wrapped(0, 0.0); }) {
          const int axis = static_cast<int>(exit.side);
          visitor.wrapped(axis, path.direction[axis] > 0 ? slab_.width(axis) : -slab_.width(axis));
        }
      }
    }
  }

  // Splits a path that has come to a higher level, and lets one that has come down two levels or more go on by chance.
  // False: it ends.
  static bool keep_level(SlabPath& path, int level, std::vector<SlabPath>& others) {
    if (level > path.level) {
      const int copies = 1 << std::min(level - path.level, most_split);
      path.level += std::min(level - path.level, most_split);
      path.weight *= 1.0 / copies;
      for (int k = 1; k < copies; ++k) {
        others.push_back(path);
        others.back().random = PathRandom(path.random.next_bits(), static_cast<std::uint64_t>(k));
      }
    } else if (level + 1 < path.level) {
      const double fewer = std::ldexp(1.0, path.level - level - 1);
      if (path.random.next() * fewer >= 1) return false;
      path.weight *= fewer;
      path.level = level + 1;
    }
    return true;
  }
  static constexpr int most_split = 4;  // levels at once

  // After a collision in homogeneous matter many at once, where nothing else is near. False: the path ends.
  template <class Visitor>
  bool leap(SlabPath& path, const Vec3& before, Visitor& visitor) const {
    const SlabLeaps& all = slab_.leaps();
    const ChannelLeaps* leaps = all.at(path.voxel);
    if (!leaps) return true;
    constexpr bool tells_tiles = requires { visitor.wrapped(0, 0.0); };
    double clearance = all.clearance(path.voxel, path.point);
    for (int axis = 0; axis < 2; ++axis) {
      const double width = slab_.width(axis);
      // Over one side, and not round.
      clearance = std::min(clearance, tells_tiles ? std::min(path.point[axis], width - path.point[axis]) : width);
    }
    const double radius = leaps->radius(clearance, path.weight);
    if (!(radius > 0) || !scattered_evenly(leaps->anisotropy, before.dot(path.direction), path.random)) return true;
    const Double4 weight = path.weight;
    for (int c = 0; c < 3; ++c) {
      if (!(weight[c] > 0)) continue;
      Double4 way = {};
      const DiffuseLeap& one = leaps->channel[c];
      way[c] = weight[c] * one.length(radius);
      const Vec3 place = path.point + one.place(radius, path.random) * even_direction(path.random);
      visitor.way(voxel_at(place), way);
    }
    path.weight -= weight * leaps->loss(radius);
    if (!outlives_faintness(path)) return false;
    path.point += radius * even_direction(path.random);
    for (int axis = 0; axis < 2; ++axis) {
      const double width = slab_.width(axis);
      if (path.point[axis] < 0)
        path.point[axis] += width;
      else if (path.point[axis] >= width)
        path.point[axis] -= width;
    }
    path.direction = even_direction(path.random);
    visitor.leapt();
    return true;
  }

  std::size_t voxel_at(const Vec3& point) const {
    const Vec3i& size = slab_.size();
    int at[3];
    for (int axis = 0; axis < 3; ++axis) at[axis] = static_cast<int>(std::floor(point[axis] / slab_.voxel()));
    for (int axis = 0; axis < 2; ++axis) at[axis] = ((at[axis] % size[axis]) + size[axis]) % size[axis];
    return (static_cast<std::size_t>(std::clamp(at[2], 0, size.z() - 1)) * size.y() + at[1]) * size.x() + at[0];
  }

  const PeriodicSlab& slab_;
};

}  // namespace shellgrid
