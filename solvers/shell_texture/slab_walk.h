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
  const Double4 depth = extinction * length;
  return depth > 1e-5 ? (1 - left) / extinction : length * (1 - 0.5 * depth);
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
    Exit exit = tile_exit(path);
    meet_before(path, exit);
    return exit;
  }

  void wrap(SlabPath& path, Side side) const {
    const int axis = static_cast<int>(side);
    path.point[axis] = path.direction[axis] > 0 ? 0 : slab_.width(axis);
  }

  // Calls visit(voxel, begin, length) for the voxels on the way until it says false.
  template <class Visit>
  void walk_voxels(const SlabPath& path, double end, const Visit& visit) const {
    walk_voxels(
        path, end, [](std::size_t, double, double) {}, visit);
  }
  // Before each voxel enter(voxel, begin, limit), which may bring the end nearer.
  template <class Enter, class Visit>
  void walk_voxels(const SlabPath& path, double& end, const Enter& enter, const Visit& visit) const {
    const Vec3i& size = slab_.size();
    const double edge = slab_.voxel(), inverse_edge = 1 / edge;
    const std::ptrdiff_t stride[3] = {1, size.x(), static_cast<std::ptrdiff_t>(size.x()) * size.y()};
    int cell[3], step[3];
    double next[3], interval[3];
    std::ptrdiff_t at = 0, stride_of[3];
    for (int axis = 0; axis < 3; ++axis) {
      const double d = path.direction[axis], o = path.point[axis];
      cell[axis] = std::clamp(static_cast<int>(o * inverse_edge), 0, size[axis] - 1);
      // On a side the voxel is the one ahead.
      if (d < 0 && cell[axis] > 0 && cell[axis] * edge >= o) --cell[axis];
      at += cell[axis] * stride[axis];
      const double inverse = std::abs(d) > 1e-300 ? 1 / d : 1e300;
      next[axis] = ((cell[axis] + (inverse > 0 ? 1 : 0)) * edge - o) * inverse;
      interval[axis] = edge * std::abs(inverse);
      step[axis] = d > 0 ? 1 : -1;
      stride_of[axis] = step[axis] * stride[axis];
    }
    double t = 0;
    for (;;) {
      const int axis = next[0] < next[1] ? (next[0] < next[2] ? 0 : 2) : (next[1] < next[2] ? 1 : 2);
      const int ahead = cell[axis] + step[axis];
      // Above and below the volume its outermost voxels go on.
      const bool outermost = ahead < 0 || ahead >= size[axis];
      enter(static_cast<std::size_t>(at), t, outermost ? end : std::min(next[axis], end));
      const bool last = outermost || next[axis] >= end;
      const double to = last ? end : std::max(next[axis], t);
      if (to > t && !visit(static_cast<std::size_t>(at), t, to - t)) return;
      if (last) return;
      t = to;
      next[axis] += interval[axis];
      cell[axis] = ahead;
      at += stride_of[axis];
    }
  }

  // To the collision, and true; or to `exit`, which it finds. Calls deposit(voxel, way) with the ways expected in each
  // voxel as if light went on without collisions: where it collides is another draw. Deposits end where so little
  // passes that it is left to chance, to the collision's draw: the farther, the more weight they have.
  template <class Deposit>
  bool fly(SlabPath& path, Exit& exit, const Deposit& deposit) const {
    const Double4 before = path.weight;
    const double whole = lane_sum(before);
    const int hero = choose_channel(before, path.random.next());
    double left = path.random.exponential();
    exit = tile_exit(path);
    if (!exit.is_known()) return false;
    Double4 passing = before;
    bool collides = false;
    double stop = exit.distance, end = stop;
    walk_voxels(
        path, end,
        [&](std::size_t voxel, double begin, double limit) {
          if (!slab_.has_surface(voxel)) return;
          double distance = 0;
          Vec3 normal;
          // Beyond its last deposit a flight need not know.
          const double last =
              begin + (left - log_chance_below) / static_cast<double>(slab_.matter(voxel).extinction[hero]);
          if (!slab_.leave_within(voxel, path.point, path.direction, begin, std::min(limit, last), distance, normal))
            return;
          exit = {distance, Side::surface, normal};
          end = distance;
          if (!collides) stop = distance;
        },
        [&](std::size_t voxel, double begin, double length) {
          const Float4& matter = slab_.matter(voxel).extinction;
          const Double4 extinction = to_double(matter), kept = lane_exponential(-extinction * length);
          const Double4 sure = passing * (1 / chance_below), drawn = sure < before ? sure : before;
          deposit(voxel, passing * mean_way(extinction, length, kept) * (whole / lane_sum(drawn)));
          const auto of_hero = static_cast<double>(matter[hero]), depth = of_hero * length;
          if (!collides && depth >= left && of_hero > 0) {
            const double way = left / of_hero;
            stop = begin + way;
            path.weight = reweighted(before, passing * lane_exponential(-extinction * way) * extinction);
            path.voxel = voxel;
            collides = true;
          }
          left -= depth;
          passing *= kept;
          return left > log_chance_below;
        });
    path.point += stop * path.direction;
    if (!collides) path.weight = reweighted(before, passing);
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
    const double unsplit = path.level == 0 ? 1 : std::ldexp(1.0, path.level);
    double weight = before * unsplit;
    if (!survives_faintness(weight, path.random)) return false;
    path.weight *= weight / (unsplit * before);
    return true;
  }

  // Another direction, by the phase function of the voxel of the collision.
  void turn(SlabPath& path) const {
    const Float4& g = slab_.matter(path.voxel).anisotropy;
    if (g[0] == g[1] && g[1] == g[2]) {
      path.direction = scattered(path.direction, static_cast<double>(g[0]), path.random);
      return;
    }
    const int hero = choose_channel(path.weight, path.random.next());
    const Vec3 old = path.direction;
    path.direction = scattered(old, static_cast<double>(g[hero]), path.random);
    const double cosine = std::clamp(old.dot(path.direction), -1.0, 1.0);
    Double4 drawn = path.weight;
    for (int c = 0; c < 3; ++c) drawn[c] *= henyey_greenstein(static_cast<double>(g[c]), cosine);
    path.weight = reweighted(path.weight, drawn);
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
  static constexpr double chance_below = 0.2;  // share of the light that passes
  static constexpr double log_chance_below = -1.6094379124341003;

  Exit tile_exit(const SlabPath& path) const {
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
    return exit;
  }

  // The surface, where it is nearer.
  void meet_before(const SlabPath& path, Exit& exit) const {
    double distance = 0;
    Vec3 normal;
    if (slab_.meet_surface(path.point, path.direction, exit.distance, path.in_matter, distance, normal))
      exit = {distance, Side::surface, normal};
  }

  template <class Visitor>
  void follow(SlabPath& path, Visitor& visitor, std::vector<SlabPath>* others) const {
    for (;;) {
      if (++path.events >= path.next_limit) {
        if (meet_event_limit(path.events, path.next_limit, path.random) != LimitOutcome::goes_on) return;
        path.weight *= limit_weight;
      }
      Exit exit;
      if (path.in_matter) {
        if (fly(path, exit, [&](std::size_t voxel, const Double4& way) { visitor.way(voxel, way); })) {
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
        exit = next_exit(path);
        if (exit.is_known()) path.point += exit.distance * path.direction;
      }
      if (!exit.is_known()) return;
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
