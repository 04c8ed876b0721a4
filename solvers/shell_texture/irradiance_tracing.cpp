// SPDX-License-Identifier: AGPL-3.0-or-later
#include "solvers/shell_texture/irradiance_tracing.h"

#include <algorithm>
#include <cmath>
#include <limits>

#include "meshing/core/error.h"
#include "meshing/core/parallel.h"
#include "solvers/shell_texture/periodic_slab.h"
#include "solvers/transport/dielectric.h"
#include "solvers/transport/path_random.h"
#include "solvers/transport/phase.h"
#include "solvers/transport/roulette.h"
#include "solvers/transport/spectral_weight.h"

namespace shellgrid {
namespace {

constexpr int batches_a_round = 8;
constexpr double infinite = std::numeric_limits<double>::infinity();

struct Tally {
  std::vector<Vec3f> single, multiple, below;
  DirectionBalance balance;

  Tally(std::size_t voxels, std::size_t texels)
      : single(voxels, Vec3f::Zero()), multiple(voxels, Vec3f::Zero()), below(texels, Vec3f::Zero()) {}
  void clear() {
    for (auto* list : {&single, &multiple, &below}) std::fill(list->begin(), list->end(), Vec3f::Zero());
  }
};

Vec3f to_vector(const Double4& v) {
  return {static_cast<float>(v[0]), static_cast<float>(v[1]), static_cast<float>(v[2])};
}

// ∫₀^ℓ e^(−σ s) ds, with `left` = e^(−σ ℓ).
Double4 mean_way(const Double4& extinction, double length, const Double4& left) {
  Double4 way;
  for (int c = 0; c < 3; ++c) {
    const double depth = extinction[c] * length;
    way[c] = depth > 1e-5 ? (1 - left[c]) / extinction[c] : length * (1 - 0.5 * depth);
  }
  way[3] = 0;
  return way;
}

struct Path {
  PathRandom random;
  Vec3 point, direction;  // x and y within the tile
  Double4 weight = {1.0 / 3, 1.0 / 3, 1.0 / 3, 0};
  bool in_matter = false, scattered = false;
  std::size_t voxel = 0;  // of the last collision
  std::uint64_t events = 0, next_limit = event_limit;
};

class IrradianceTracer {
 public:
  IrradianceTracer(const BaseVolume& volume, const IrradianceOptions& options)
      : slab_(volume), volume_(volume), options_(options) {}

  const PeriodicSlab& slab() const { return slab_; }

  void follow(int direction, std::uint64_t index, Tally& tally) const {
    Path path{PathRandom(options_.seed + 0x9e37u * static_cast<std::uint64_t>(direction + 1), index), Vec3::Zero(),
              Vec3::Zero()};
    const double x = path.random.next() * slab_.width(0), y = path.random.next() * slab_.width(1);
    start(path, direction, x, y);
    if (direction == options_.directions.back()) {
      const double cosine = std::sqrt(1 - path.random.next()), sine = std::sqrt(std::max(0.0, 1 - cosine * cosine));
      const CosineSine azimuth = path.random.azimuth();
      path.direction = Vec3(sine * azimuth.cosine, sine * azimuth.sine, -cosine);
      path.scattered = true;
    }
    for (;;) {
      if (++path.events >= path.next_limit) {
        if (meet_event_limit(path.events, path.next_limit, path.random) != LimitOutcome::goes_on) return;
        path.weight *= limit_weight;
      }
      Vec3 normal;
      const Exit exit = next_event(path, normal);
      const double end = exit.distance;
      if (!(end < infinite)) return;
      if (path.in_matter && fly(path, end, tally)) {
        if (!collide(path, tally)) return;
        continue;
      }
      path.point += end * path.direction;
      if (exit.axis == surface) {
        meet(path, normal);
      } else if (exit.axis < 2) {
        wrap(path.point, path.direction, exit.axis);
      } else {
        const bool below = path.direction.z() > 0;
        (below ? tally.balance.left_below : tally.balance.left_above) += lane_sum(path.weight);
        if (below) tally.below[texel_at(path.point)] += to_vector(path.weight);
        return;
      }
    }
  }

  // Light from one place above, without chance: what passes the surface, never what it mirrors.
  void march(int direction, double x, double y, Tally& tally) const {
    Path path{PathRandom(0, 0), Vec3::Zero(), Vec3::Zero()};
    start(path, direction, x, y);
    path.weight = Double4{1, 1, 1, 0};
    for (std::uint64_t events = 0; events < 100'000; ++events) {
      Vec3 normal;
      const Exit exit = next_event(path, normal);
      const double end = exit.distance;
      if (!(end < infinite)) return;
      if (path.in_matter)
        walk_voxels(path, end, [&](std::size_t voxel, double, double length) {
          const Double4 extinction = to_double(slab_.matter(voxel).extinction);
          const Double4 left = lane_exponential(-extinction * length);
          tally.single[voxel] += to_vector(path.weight * mean_way(extinction, length, left));
          path.weight *= left;
          return true;
        });
      if (lane_sum(path.weight) < 1e-7) return;
      path.point += end * path.direction;
      if (exit.axis == surface) {
        const double cosine = std::min(1.0, std::abs(normal.dot(path.direction)));
        const double relative = path.in_matter ? 1 / slab_.ior(path.point, normal) : slab_.ior(path.point, normal);
        const BoundaryMeeting meeting = meet_boundary(cosine, relative);
        if (meeting.reflectance >= 1) return;
        path.weight *= 1 - meeting.reflectance;
        path.direction =
            refracted(path.direction, path.in_matter ? Vec3(-normal) : normal, cosine, meeting.cosine_beyond, relative);
        path.in_matter = !path.in_matter;
      } else if (exit.axis < 2) {
        wrap(path.point, path.direction, exit.axis);
      } else {
        return;
      }
    }
  }

 private:
  static constexpr int surface = 3;
  struct Exit {
    double distance = infinite;
    int axis = 2;  // of the side; or the mesostructure surface
  };

  std::size_t texel_at(const Vec3& point) const {
    const int i = std::clamp(static_cast<int>(point.x() / volume_.voxel), 0, volume_.size.x() - 1);
    const int j = std::clamp(static_cast<int>(point.y() / volume_.voxel), 0, volume_.size.y() - 1);
    return static_cast<std::size_t>(j) * volume_.size.x() + i;
  }

  void start(Path& path, int direction, double x, double y) const {
    path.point = Vec3(x, y, slab_.top());
    if (direction == options_.directions.back()) {
      path.point.z() = slab_.depth();
      const int i = std::min(volume_.size.x() - 1, static_cast<int>(x / volume_.voxel));
      const int j = std::min(volume_.size.y() - 1, static_cast<int>(y / volume_.voxel));
      path.in_matter = volume_.free[volume_.index(i, j, volume_.size.z() - 1)] == 0;
      return;
    }
    const Vec3 to_light = options_.directions.direction(direction);
    path.direction = Vec3(-to_light.x(), -to_light.y(), to_light.z());
  }

  // Where a path gets to without a collision: the mesostructure surface with its normal, or an exit.
  Exit next_event(const Path& path, Vec3& normal) const {
    Exit exit = way_to_exit(path.point, path.direction, path.in_matter);
    double distance = 0;
    if (slab_.meet_surface(path.point, path.direction, exit.distance, path.in_matter, distance, normal))
      exit = {distance, surface};
    return exit;
  }

  // The tile's side, its bottom, or in free space its top.
  Exit way_to_exit(const Vec3& point, const Vec3& direction, bool in_matter) const {
    Exit exit;
    const auto consider = [&](double distance, int axis) {
      if (distance < exit.distance) exit = {std::max(0.0, distance), axis};
    };
    const double width[2] = {slab_.width(0), slab_.width(1)};
    for (int axis = 0; axis < 2; ++axis)
      if (direction[axis] != 0)
        consider(((direction[axis] > 0 ? width[axis] : 0) - point[axis]) / direction[axis], axis);
    if (direction.z() > 0)
      consider((slab_.depth() - point.z()) / direction.z(), 2);
    else if (direction.z() < 0)
      // In matter the surface is met first; one voxel above it a path has slipped out.
      consider((slab_.top() - (in_matter ? slab_.voxel() : 0) - point.z()) / direction.z(), 2);
    return exit;
  }

  void wrap(Vec3& point, const Vec3& direction, int axis) const {
    point[axis] = direction[axis] > 0 ? 0 : axis == 0 ? slab_.width(0) : slab_.width(1);
  }

  // Calls visit(voxel, begin, length) for the voxels on the way until it says false.
  template <class Visit>
  void walk_voxels(const Path& path, double end, const Visit& visit) const {
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

  // To the collision, and true; or to the end.
  bool fly(Path& path, double end, Tally& tally) const {
    const Double4 before = path.weight;
    const int hero = choose_channel(before, path.random.next());
    double left = path.random.exponential();
    Double4 passed = {1, 1, 1, 0};
    bool collides = false;
    double stop = end;
    const bool lengths = options_.estimator == IrradianceEstimator::track_length && path.scattered;
    walk_voxels(path, end, [&](std::size_t voxel, double begin, double length) {
      const Double4 extinction = to_double(slab_.matter(voxel).extinction);
      const Double4 kept = lane_exponential(-extinction * length);
      // As if it went through: the collision's place is another draw.
      if (lengths)
        tally.multiple[voxel] += to_vector(reweighted(before, before * passed) * mean_way(extinction, length, kept));
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
    if (collides)
      path.point += stop * path.direction;
    else
      path.weight = reweighted(before, before * passed);
    return collides;
  }

  bool collide(Path& path, Tally& tally) const {
    const PeriodicSlab::Matter& matter = slab_.matter(path.voxel);
    const Double4 albedo = to_double(matter.albedo), g = to_double(matter.anisotropy);
    const Double4 scatters = path.weight * albedo;
    tally.balance.absorbed += lane_sum(path.weight - scatters);
    if (options_.estimator == IrradianceEstimator::sphere) add_sphere(path, scatters, tally);
    const double after = lane_sum(scatters);
    if (!(after > 0)) return false;
    path.weight = scatters;
    double whole = after;
    if (!survives_faintness(whole, path.random)) return false;
    path.weight *= whole / after;
    const int hero = choose_channel(path.weight, path.random.next());
    const Vec3 old = path.direction;
    path.direction = scattered(old, g[hero], path.random);
    if (g[0] != g[1] || g[1] != g[2]) {
      const double cosine = std::clamp(old.dot(path.direction), -1.0, 1.0);
      Double4 drawn = path.weight;
      for (int c = 0; c < 3; ++c) drawn[c] *= henyey_greenstein(g[c], cosine);
      path.weight = reweighted(path.weight, drawn);
    }
    path.scattered = true;
    return true;
  }

  void meet(Path& path, const Vec3& normal) const {
    const double cosine = std::min(1.0, std::abs(normal.dot(path.direction)));
    const double relative = path.in_matter ? 1 / slab_.ior(path.point, normal) : slab_.ior(path.point, normal);
    const Vec3 against = path.in_matter ? Vec3(-normal) : normal;
    const BoundaryMeeting meeting = meet_boundary(cosine, relative);
    if (path.random.next() < meeting.reflectance) {
      path.direction = mirrored(path.direction, against, cosine);
      path.scattered = true;
    } else {
      path.direction = refracted(path.direction, against, cosine, meeting.cosine_beyond, relative);
      path.in_matter = !path.in_matter;
    }
  }

  // Eq. 2 with ΔV a sphere of one voxel's radius about each voxel's centre.
  void add_sphere(const Path& path, const Double4& scatters, Tally& tally) const {
    const Vec3i& size = slab_.size();
    const Vec3 at = path.point / slab_.voxel();
    const int x = static_cast<int>(std::floor(at.x())), y = static_cast<int>(std::floor(at.y())),
              z = static_cast<int>(std::floor(at.z()));
    for (int dz = -1; dz <= 1; ++dz)
      for (int dy = -1; dy <= 1; ++dy)
        for (int dx = -1; dx <= 1; ++dx) {
          if (z + dz < 0 || z + dz >= size.z()) continue;
          if ((Vec3(x + dx + 0.5, y + dy + 0.5, z + dz + 0.5) - at).squaredNorm() > 1) continue;
          const int i = (x + dx + size.x()) % size.x(), j = (y + dy + size.y()) % size.y();
          const std::size_t voxel = volume_.index(i, j, z + dz);
          if (volume_.free[voxel]) continue;
          const PeriodicSlab::Matter& matter = slab_.matter(voxel);
          Vec3f value = Vec3f::Zero();
          for (int c = 0; c < 3; ++c) {
            const double scattering = static_cast<double>(matter.albedo[c]) * static_cast<double>(matter.extinction[c]);
            if (scattering > 0) value[c] = static_cast<float>(scatters[c] / scattering);
          }
          (path.scattered ? tally.multiple : tally.single)[voxel] += value;
        }
  }

  PeriodicSlab slab_;
  const BaseVolume& volume_;
  const IrradianceOptions& options_;
};

}  // namespace

ShellTexture trace_irradiance(const BaseVolume& volume, const IrradianceOptions& options, IrradianceReport* report,
                              Progress& progress) {
  if (options.directions.rings < 1 || options.directions.turns < 1 || options.directions.count() > 10000)
    throw InputError("irradiance: 1 … 10000 directions");
  if (!(options.paths > 0) || !(options.most_paths >= options.paths))
    throw InputError("irradiance: the number of paths must be above 0 and no more than the most");
  if (options.march_rays < 1) throw InputError("irradiance: at least one ray a texel");
  const IrradianceTracer tracer(volume, options);
  const PeriodicSlab& slab = tracer.slab();
  const std::size_t voxels = volume.voxel_count();
  const int directions = options.directions.count();
  ShellTexture texture;
  texture.size = volume.size;
  texture.voxel = volume.voxel;
  texture.directions = options.directions;
  texture.single.assign(directions * voxels, Vec3f::Zero());
  texture.multiple.assign((directions + 1) * voxels, Vec3f::Zero());
  texture.error.assign((directions + 1) * voxels, -1.0f);
  texture.below.assign((directions + 1) * texture.texel_count(), Vec3f::Zero());
  texture.matter = slab.share();
  IrradianceReport own;
  own.balance.resize(directions + 1);

  const std::size_t texels = texture.texel_count();
  const double area = slab.width(0) * slab.width(1), cell = std::pow(volume.voxel, 3);
  const bool sphere = options.estimator == IrradianceEstimator::sphere;
  // Of the fluence that a sum of ways is, for light of unit irradiance across its direction.
  const auto scale_of = [&](int direction, std::size_t voxel) {
    const double through = direction == directions ? 0.5 * area : area * options.directions.direction(direction).z();
    const double volume_of = sphere ? 4.0 / 3 * std::numbers::pi * cell : cell * slab.share()[voxel];
    return volume_of > 1e-3 * cell ? through / volume_of : 0.0;
  };

  if (!sphere) {
    progress.begin("march light", directions);
    parallel_for(
        static_cast<std::size_t>(directions),
        [&](std::size_t l) {
          Tally tally(voxels, texels);
          const double step = volume.voxel / options.march_rays;
          for (int j = 0; j < volume.size.y() * options.march_rays; ++j)
            for (int i = 0; i < volume.size.x() * options.march_rays; ++i)
              tracer.march(static_cast<int>(l), (i + 0.5) * step, (j + 0.5) * step, tally);
          const double rays = static_cast<double>(texels) * options.march_rays * options.march_rays;
          for (std::size_t v = 0; v < voxels; ++v)
            texture.single[texture.at(static_cast<int>(l), v)] =
                static_cast<float>(scale_of(static_cast<int>(l), v) / rays) * tally.single[v];
          progress.advance();
        },
        1);
    progress.end();
  }

  // Sums over batches of what each path brought on average, and of the squares of the channels' mean.
  std::vector<float> squares((directions + 1) * voxels, 0.0f);
  double batches = 0;
  const auto most_rounds = static_cast<int>(std::ceil(std::log2(options.most_paths / options.paths))) + 1;
  const auto batch_paths = static_cast<std::uint64_t>(
      std::max(1.0, std::ceil(options.paths * static_cast<double>(texels) / batches_a_round)));
  for (int round = 0; round < most_rounds; ++round) {
    // Each round doubles what has been done.
    const int first = static_cast<int>(batches);
    const int count = round == 0 ? batches_a_round : first;
    progress.begin("follow light", directions + 1);
    parallel_for(
        static_cast<std::size_t>(directions) + 1,
        [&](std::size_t l) {
          const int direction = static_cast<int>(l);
          Tally tally(voxels, texels);
          for (int batch = first; batch < first + count; ++batch) {
            tally.clear();
            for (std::uint64_t k = 0; k < batch_paths; ++k)
              tracer.follow(direction, static_cast<std::uint64_t>(batch) * batch_paths + k, tally);
            for (std::size_t v = 0; v < voxels; ++v) {
              // Three times: the weights' sum of one is shared by three channels.
              const auto scale = static_cast<float>(3 * scale_of(direction, v) / static_cast<double>(batch_paths));
              const Vec3f value = scale * tally.multiple[v];
              texture.multiple[texture.at(direction, v)] += value;
              const float mean = value.sum() / 3;
              squares[texture.at(direction, v)] += mean * mean;
              if (sphere && direction < directions) texture.single[texture.at(direction, v)] += scale * tally.single[v];
            }
            const double through = direction == directions ? 1 : options.directions.direction(direction).z();
            const auto scale =
                static_cast<float>(3 * through * static_cast<double>(texels) / static_cast<double>(batch_paths));
            for (std::size_t k = 0; k < texels; ++k) texture.below[l * texels + k] += scale * tally.below[k];
          }
          DirectionBalance& balance = own.balance[l];
          balance.absorbed += tally.balance.absorbed;
          balance.left_above += tally.balance.left_above;
          balance.left_below += tally.balance.left_below;
          progress.advance();
        },
        1);
    progress.end();
    batches += count;
    std::vector<float> known;
    for (std::size_t k = 0; k < squares.size(); ++k) {
      const double mean = static_cast<double>(texture.multiple[k].sum()) / (3 * batches);
      const double variance = std::max(0.0, static_cast<double>(squares[k]) / batches - mean * mean) / (batches - 1);
      texture.error[k] = mean > 0 ? static_cast<float>(std::sqrt(variance) / mean) : -1.0f;
      if (texture.matter[k % voxels] > 0.5f) known.push_back(mean > 0 ? texture.error[k] : 1.0f);
    }
    if (!known.empty()) {
      std::nth_element(known.begin(), known.begin() + static_cast<std::ptrdiff_t>(known.size() / 2), known.end());
      own.median_error = static_cast<double>(known[known.size() / 2]);
    }
    if (options.interrupted && options.interrupted()) {
      own.interrupted = true;
      break;
    }
    if (!(options.target_error > 0) || own.median_error <= options.target_error) break;
  }
  for (Vec3f& value : texture.multiple) value /= static_cast<float>(batches);
  for (Vec3f& value : texture.below) value /= static_cast<float>(batches);
  if (sphere)
    for (Vec3f& value : texture.single) value /= static_cast<float>(batches);
  own.paths = batches * static_cast<double>(batch_paths);
  for (DirectionBalance& balance : own.balance) {
    balance.absorbed /= own.paths;
    balance.left_above /= own.paths;
    balance.left_below /= own.paths;
  }
  if (report) *report = own;
  return texture;
}

}  // namespace shellgrid
