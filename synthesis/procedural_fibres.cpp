// SPDX-License-Identifier: AGPL-3.0-or-later
// Grass and weave: bodies above a ground that overhang, so that the surface is no height field.
#include <fmt/format.h>

#include <array>
#include <cmath>
#include <numbers>

#include "meshing/core/error.h"
#include "meshing/core/random.h"
#include "synthesis/procedural_patterns.h"
#include "synthesis/sample_builder.h"

namespace shellgrid {
namespace {

constexpr double top_gap = 0.25;  // voxels of free space above the highest point
constexpr double far_away = 1e300;

// Signed distances, voxels, negative inside, of as many bodies as there are materials; the first one that a voxel lies
// in wins where they overlap, and voxels on a border hold shares of both sides.
// distances(p, column) fills an array; column is the texel below which p's voxel lies.
template <std::size_t Count, class Distances>
void voxelize(MaterialSample& sample, const std::array<Material, Count>& materials, const Distances& distances) {
  std::vector<Vec3f> outward(sample.voxel_count(), Vec3f(0, 0, -1));
  const std::size_t texels = static_cast<std::size_t>(sample.size.x()) * sample.size.y();
  for_each_voxel(sample, [&](std::size_t index, const Vec3& p) {
    const std::size_t column = index % texels;
    const auto nearest = [&](const Vec3& at) {
      const std::array<double, Count> d = distances(at, column);
      return *std::min_element(d.begin(), d.end());
    };
    const std::array<double, Count> d = distances(p, column);
    const auto least = std::min_element(d.begin(), d.end());
    if (*least > 0) {
      sample.kind[index] = VoxelKind::free_space;
      return;
    }
    Composition composition;
    double left = 1;
    for (std::size_t body = 0; body < Count; ++body) {
      const double share = left * std::clamp(0.5 - d[body], 0.0, 1.0);
      if (share > 0) composition.add(materials[body], share);
      left -= share;
    }
    store_material(sample, index, composition.material());
    if (*least < -2) return;
    Vec3 gradient;
    for (int axis = 0; axis < 3; ++axis) {
      const Vec3 step = 0.5 * Vec3::Unit(axis);
      gradient[axis] = nearest(p + step) - nearest(p - step);
    }
    if (gradient.norm() > 1e-9) outward[index] = gradient.normalized().cast<float>();
  });
  mark_surface(sample, &outward);
}

// A cone between two balls. Voxels.
struct Cone {
  Vec3 from, to;
  double from_radius, to_radius;
};

double distance_to(const Cone& cone, const Vec3& p) {
  const Vec3 axis = cone.to - cone.from;
  const double t = std::clamp((p - cone.from).dot(axis) / std::max(1e-12, axis.squaredNorm()), 0.0, 1.0);
  return (p - cone.from - t * axis).norm() - ((1 - t) * cone.from_radius + t * cone.to_radius);
}

}  // namespace

double needed_depth(const GrassPattern& pattern, double voxel) { return pattern.height + top_gap * voxel; }

void fill(MaterialSample& sample, const GrassPattern& pattern, const SampleDefinition& definition) {
  const double nx = sample.size.x(), ny = sample.size.y();
  const double ground = needed_depth(pattern, sample.voxel) / sample.voxel;
  const std::vector<Vec2> roots = spread_points(pattern.count, nx, ny, definition.seed);
  RandomStream random(definition.seed, 51);
  std::vector<Cone> cones;
  for (const Vec2& root : roots) {
    const double length = pattern.height / sample.voxel * (0.65 + 0.35 * random.next());
    const double angle = 2 * std::numbers::pi * random.next(), lean = pattern.bend * (0.6 + 0.4 * random.next());
    const double radius = std::min(pattern.radius / sample.voxel * (0.8 + 0.4 * random.next()), 0.45 * length);
    const Vec3 aside(std::cos(angle), std::sin(angle), 0), up(0, 0, -1);
    // A quadratic curve: up first, then over to the side, its end drooping the more it bends.
    const Vec3 start(root.x(), root.y(), ground);
    const double rise = length - radius;
    const Vec3 middle = start + rise * (up + 0.2 * lean * aside);
    const Vec3 end = start + rise * ((1 - 0.45 * lean) * up + lean * aside);
    constexpr int pieces = 6;
    Vec3 last = start;
    for (int i = 1; i <= pieces; ++i) {
      const double t = static_cast<double>(i) / pieces, s = 1 - t;
      const Vec3 next = s * s * start + 2 * s * t * middle + t * t * end;
      const double before = static_cast<double>(i - 1) / pieces;
      cones.push_back({last, next, radius * (1 - 0.75 * before * before), radius * (1 - 0.75 * t * t)});
      last = next;
    }
  }
  // What can be near a texel's stack, moved there across the wrap-around.
  std::vector<std::vector<Cone>> columns(static_cast<std::size_t>(sample.size.x()) * sample.size.y());
  for (const Cone& cone : cones) {
    const double margin = std::max(cone.from_radius, cone.to_radius) + 2.5;
    const Vec3 lower = cone.from.cwiseMin(cone.to).array() - margin,
               upper = cone.from.cwiseMax(cone.to).array() + margin;
    for (int y = static_cast<int>(std::floor(lower.y())); y <= static_cast<int>(std::floor(upper.y())); ++y)
      for (int x = static_cast<int>(std::floor(lower.x())); x <= static_cast<int>(std::floor(upper.x())); ++x) {
        const Vec3 shift(-nx * std::floor(x / nx), -ny * std::floor(y / ny), 0);
        const int column_x = x + static_cast<int>(shift.x()), column_y = y + static_cast<int>(shift.y());
        columns[static_cast<std::size_t>(column_y) * sample.size.x() + column_x].push_back(
            {cone.from + shift, cone.to + shift, cone.from_radius, cone.to_radius});
      }
  }
  voxelize<2>(sample, {pattern.blade, pattern.body}, [&](const Vec3& p, std::size_t column) {
    double blade = far_away;
    for (const Cone& cone : columns[column]) blade = std::min(blade, distance_to(cone, p));
    return std::array<double, 2>{blade, ground - p.z()};
  });
}

double needed_depth(const WeavePattern& pattern, double voxel) {
  const int repeat = pattern.over + pattern.under;
  if (pattern.warp_count % repeat != 0 || pattern.weft_count % repeat != 0)
    throw InputError(fmt::format("{} yarns by {} make no whole repeats of {} over, {} under; expected multiples of {}",
                                 pattern.warp_count, pattern.weft_count, pattern.over, pattern.under, repeat));
  return 4 * pattern.height + 2 * top_gap * voxel;
}

void fill(MaterialSample& sample, const WeavePattern& pattern, const SampleDefinition&) {
  const double height = pattern.height / sample.voxel, middle = top_gap + 2 * height;
  const double ground = needed_depth(pattern, sample.voxel) / sample.voxel;
  const int repeat = pattern.over + pattern.under;
  const auto wrap = [](int i, int n) { return (i % n + n) % n; };
  // One family of yarns: distance of the nearest. across, along: of p; counts: of these yarns and of those they cross;
  // side(i, j): −1 where yarn i lies above yarn j.
  const auto family = [&](double across, double along, double z, double across_extent, double along_extent, int count,
                          int crossings, const auto& side) {
    const double pitch = across_extent / count, step = along_extent / crossings;
    const double half_width = 0.5 * pattern.fill * pitch;
    const int home = static_cast<int>(std::floor(across / pitch));
    const double position = along / step - 0.5;
    const int crossing = static_cast<int>(std::floor(position));
    const double t = position - crossing, s = smooth_step(t), slope_s = 6 * t * (1 - t) / step;
    double nearest = far_away;
    for (int i = home - 1; i <= home + 1; ++i) {
      const double from = side(i, crossing), to = side(i, crossing + 1);
      const double centre = middle + height * (from + s * (to - from)), slope = height * slope_s * (to - from);
      const double cosine = 1 / std::sqrt(1 + slope * slope);
      const double u = (across - (i + 0.5) * pitch) / half_width, v = (z - centre) * cosine / height;
      double radius = std::hypot(u, v);
      // Strands turn about the yarn, one lobe a crossing, so that the turns close across the wrap-around.
      if (pattern.strands > 0)
        radius +=
            0.22 * (1 - std::abs(std::cos(0.5 * pattern.strands * std::atan2(v, u) + std::numbers::pi * along / step)));
      nearest = std::min(nearest, (radius - 1) * std::min(half_width, height));
    }
    return nearest;
  };
  const auto warp_side = [&](int warp, int weft) {
    return wrap(wrap(warp, pattern.warp_count) + wrap(weft, pattern.weft_count), repeat) < pattern.over ? -1.0 : 1.0;
  };
  const double nx = sample.size.x(), ny = sample.size.y();
  voxelize<3>(sample, {pattern.warp, pattern.weft, pattern.body}, [&](const Vec3& p, std::size_t) {
    const double warp = family(p.x(), p.y(), p.z(), nx, ny, pattern.warp_count, pattern.weft_count, warp_side);
    const double weft = family(p.y(), p.x(), p.z(), ny, nx, pattern.weft_count, pattern.warp_count,
                               [&](int i, int j) { return -warp_side(j, i); });
    return std::array<double, 3>{warp, weft, ground - p.z()};
  });
}

}  // namespace shellgrid
