// SPDX-License-Identifier: AGPL-3.0-or-later
#include "solvers/shell_texture/beam_field.h"

#include <cmath>

#include "meshing/core/parallel.h"

namespace shellgrid {
namespace {

constexpr int directions_at_once = 8;
constexpr float place_unit = 1.0f / 8192;  // of positions within voxels, until the mixture is known
constexpr float least_spread = 2e-3f;      // of a voxel; below it directions do not differ in their places
constexpr double faint_branch = 0.02;      // weight below which mirrored branches are drawn by chance
constexpr double faint_beam = 3e-7;        // sum of the channels
constexpr int rays_of_places = 16;         // a texel, of which more is kept than how much
constexpr int most_events = 20'000;

// Sums over the beams of one direction in one voxel.
struct VoxelBeams {
  float single[3] = {}, mirrored[3] = {};
  float length[3] = {};                       // of those of which the following is known
  float place[3][3] = {}, square[3][3] = {};  // by channel, axis
  float course[3] = {};
};

struct BeamTally {
  std::vector<VoxelBeams> voxels;
  std::vector<Vec3f> below;
  Vec3f above = Vec3f::Zero();
  int rays = 0;

  void clear() {
    std::fill(voxels.begin(), voxels.end(), VoxelBeams());
    std::fill(below.begin(), below.end(), Vec3f::Zero());
    above.setZero();
    rays = 0;
  }
};

Vec3f to_vector(const Double4& v) {
  return {static_cast<float>(v[0]), static_cast<float>(v[1]), static_cast<float>(v[2])};
}

class BeamMarch {
 public:
  BeamMarch(const SlabWalk& walk, const BeamOptions& options) : walk_(walk), slab_(walk.slab()), options_(options) {}

  void direction(int l, BeamTally& tally) const {
    tally.clear();
    const int columns = slab_.size().x(), rows = slab_.size().y(), most = std::max(1, options_.rays);
    // From the coarsest of nested grids on.
    int stride = 1;
    while (most % (2 * stride) == 0 && most / (2 * stride) >= 2) stride *= 2;
    const double fine = slab_.voxel() / most;
    const auto march_grid = [&](int first_x, int first_y, int step) {
      for (int j = first_y; j < rows * most; j += step)
        for (int i = first_x; i < columns * most; i += step) {
          const auto number = static_cast<std::uint64_t>(j) * columns * most + static_cast<std::uint64_t>(i);
          ray(l, number, (i + 0.5) * fine, (j + 0.5) * fine, tally);
        }
      tally.rays += (most / step) * (most / step);
    };
    march_grid(0, 0, stride);
    std::vector<float> before;
    for (; stride > 1; stride /= 2) {
      const int half = stride / 2;
      for (const bool corners : {true, false}) {
        before.clear();
        for (const VoxelBeams& v : tally.voxels) before.push_back(v.single[0] + v.single[1] + v.single[2]);
        if (corners) {
          march_grid(half, half, stride);
        } else {
          march_grid(half, 0, stride);
          march_grid(0, half, stride);
        }
        // Each time as many rays as there were.
        double difference = 0, whole = 0;
        for (std::size_t v = 0; v < before.size(); ++v) {
          const VoxelBeams& beams = tally.voxels[v];
          const double now = static_cast<double>(beams.single[0] + beams.single[1] + beams.single[2]);
          difference += std::abs(now - 2 * static_cast<double>(before[v]));
          whole += now;
        }
        if (difference <= 2 * options_.error * whole) return;
      }
    }
  }

 private:
  struct Branch {
    Vec3 point, direction;
    Double4 weight;
    bool in_matter;
  };

  // Light from one place above: what passes surfaces is followed without chance, so are strong mirrored branches; once
  // mirrored, surfaces choose by chance.
  void ray(int l, std::uint64_t number, double x, double y, BeamTally& tally) const {
    SlabPath path{PathRandom(hash64(options_.seed, 0x6265616d, static_cast<std::uint64_t>(l)), number)};
    walk_.start_above(path, options_.directions.direction(l), x, y);
    path.weight = Double4{1, 1, 1, 0};
    std::vector<Branch> branches;
    follow(path, false, branches, tally);
    while (!branches.empty()) {
      const Branch branch = branches.back();
      branches.pop_back();
      path.point = branch.point;
      path.direction = branch.direction;
      path.weight = branch.weight;
      path.in_matter = branch.in_matter;
      follow(path, true, branches, tally);
    }
  }

  void follow(SlabPath& path, bool mirrored_before, std::vector<Branch>& branches, BeamTally& tally) const {
    for (int events = 0; events < most_events; ++events) {
      const SlabWalk::Exit exit = walk_.next_exit(path);
      if (!exit.is_known()) return;
      if (path.in_matter) deposit(path, exit.distance, mirrored_before, tally);
      if (lane_sum(path.weight) < faint_beam) return;
      path.point += exit.distance * path.direction;
      if (exit.side == SlabWalk::Side::ends) {
        if (path.direction.z() > 0)
          tally.below[slab_.texel_at(path.point)] += to_vector(path.weight);
        else
          tally.above += to_vector(path.weight);
        return;
      }
      if (exit.side != SlabWalk::Side::surface) {
        walk_.wrap(path, exit.side);
        continue;
      }
      if (mirrored_before) {
        walk_.meet(path, exit.normal);
        continue;
      }
      const SlabWalk::Meeting meeting = walk_.meeting(path, exit.normal);
      const double reflectance = meeting.boundary.reflectance;
      if (reflectance > 0) {
        Branch branch{path.point, mirrored(path.direction, meeting.against, meeting.cosine), path.weight * reflectance,
                      path.in_matter};
        const double strength = lane_sum(branch.weight) / (3 * faint_branch);
        if (strength >= 1 || path.random.next() < strength) {
          if (strength < 1) branch.weight *= 1 / strength;
          branches.push_back(branch);
        }
      }
      if (reflectance >= 1) return;
      path.weight *= 1 - reflectance;
      walk_.pass(path, meeting);
    }
  }

  void deposit(SlabPath& path, double end, bool mirrored_before, BeamTally& tally) const {
    const Vec3i& size = slab_.size();
    const double inverse = 1 / slab_.voxel();
    walk_.walk_voxels(path, end, [&](std::size_t voxel, double begin, double length) {
      const Double4 extinction = to_double(slab_.matter(voxel).extinction);
      const Double4 left = lane_exponential(-extinction * length);
      const Double4 mean = mean_way(extinction, length, left), way = path.weight * mean;
      VoxelBeams& to = tally.voxels[voxel];
      float* sum = mirrored_before ? to.mirrored : to.single;
      for (int c = 0; c < 3; ++c) sum[c] += static_cast<float>(way[c]);
      if (options_.sources && tally.rays < rays_of_places) {
        for (int c = 0; c < 3; ++c) to.length[c] += static_cast<float>(way[c]);
        const auto index = static_cast<int>(voxel);
        const int corner[3] = {index % size.x(), index / size.x() % size.y(), index / (size.x() * size.y())};
        // ∫ s e^(−σ s) ds and ∫ s² e^(−σ s) ds.
        double first[3], second[3];
        for (int c = 0; c < 3; ++c) {
          const double depth = extinction[c] * length;
          if (depth > 1e-3) {
            first[c] = (mean[c] - length * left[c]) / extinction[c];
            second[c] = (2 * first[c] - length * length * left[c]) / extinction[c];
          } else {
            first[c] = length * length * (0.5 - depth / 3);
            second[c] = length * length * length * (1.0 / 3 - depth / 4);
          }
        }
        for (int axis = 0; axis < 3; ++axis) {
          const double d = path.direction[axis] * inverse;
          const double from = (path.point[axis] + begin * path.direction[axis]) * inverse - corner[axis];
          for (int c = 0; c < 3; ++c) {
            to.place[c][axis] += static_cast<float>(path.weight[c] * (from * mean[c] + d * first[c]));
            to.square[c][axis] += static_cast<float>(
                path.weight[c] * (from * from * mean[c] + 2 * from * d * first[c] + d * d * second[c]));
          }
          to.course[axis] += static_cast<float>(path.direction[axis] * lane_sum(way));
        }
      }
      path.weight *= left;
      return lane_sum(path.weight) >= faint_beam;
    });
  }

  const SlabWalk& walk_;
  const PeriodicSlab& slab_;
  const BeamOptions& options_;
};

std::int16_t to_steps(float value, float unit) {
  return static_cast<std::int16_t>(std::lround(std::clamp(value / unit, -32767.0f, 32767.0f)));
}

// Takes the tallies of directions [first, first + count).
void gather(const PeriodicSlab& slab, const BeamOptions& options, const std::vector<BeamTally>& tallies, int first,
            int count, BeamField& field) {
  const int n = field.directions;
  const double area = slab.width(0) * slab.width(1), texels = static_cast<double>(field.texels);
  std::vector<float> power(static_cast<std::size_t>(count)), slant(power.size());
  for (int k = 0; k < count; ++k) {
    const double cosine = options.directions.direction(first + k).z();
    power[k] = static_cast<float>(area * cosine / (texels * tallies[k].rays));
    slant[k] = static_cast<float>(1 / cosine);
    const std::size_t l = static_cast<std::size_t>(first + k);
    for (std::size_t t = 0; t < field.texels; ++t) field.below[l * field.texels + t] = power[k] * tallies[k].below[t];
    field.above[l] = power[k] * tallies[k].above;
    field.rays_a_texel = std::max(field.rays_a_texel, tallies[k].rays);
  }
  parallel_for(field.voxels, [&](std::size_t v) {
    const PeriodicSlab::Matter& matter = slab.matter(v);
    for (int k = 0; k < count; ++k) {
      const VoxelBeams& beams = tallies[k].voxels[v];
      const int l = first + k;
      const std::size_t at = static_cast<std::size_t>(l) * field.voxels + v;
      for (int c = 0; c < 3; ++c) {
        field.single[at][c] = power[k] * beams.single[c];
        field.mirrored[at][c] = power[k] * beams.mirrored[c];
      }
      if (!options.sources) continue;
      BeamField::Mixture& mixture = field.mixture[v];
      float whole = 0;
      for (int c = 0; c < 3; ++c) {
        const float length = beams.length[c];
        whole += length;
        const float source = power[k] * (beams.single[c] + beams.mirrored[c]) * matter.extinction[c] * matter.albedo[c];
        field.source[(3 * v + c) * n + l] = source;
        mixture.source[c] += slant[k] * source;
        if (!(length > 0)) continue;
        for (int axis = 0; axis < 3; ++axis) {
          const float place = beams.place[c][axis] / length;
          field.shift[(9 * v + 3 * c + axis) * n + l] = to_steps(place, place_unit);
          mixture.middle[c][axis] += slant[k] * source * place;
          mixture.inverse_spread[c][axis] += slant[k] * source * (beams.square[c][axis] / length);
        }
      }
      for (int axis = 0; axis < 3; ++axis)
        field.course[(3 * v + axis) * n + l] = to_steps(whole > 0 ? beams.course[axis] / whole : 0, field.course_unit);
    }
  });
}

// Sums over directions become means, positions shifts.
void finish(BeamField& field) {
  const int n = field.directions;
  parallel_for(field.voxels, [&](std::size_t v) {
    BeamField::Mixture& mixture = field.mixture[v];
    for (int c = 0; c < 3; ++c) {
      for (int axis = 0; axis < 3; ++axis) {
        const float whole = mixture.source[c];
        const float middle = whole > 0 ? mixture.middle[c][axis] / whole : 0;
        const float variance = whole > 0 ? mixture.inverse_spread[c][axis] / whole - middle * middle : 0;
        const float spread = std::sqrt(std::max(variance, least_spread * least_spread));
        mixture.middle[c][axis] = middle;
        mixture.inverse_spread[c][axis] = 1 / spread;
        std::int16_t* shift = field.shift.data() + (9 * v + 3 * c + axis) * n;
        for (int l = 0; l < n; ++l)
          shift[l] = field.source[(3 * v + c) * n + l] > 0
                         ? to_steps((static_cast<float>(shift[l]) * place_unit - middle) / spread, field.shift_unit)
                         : std::int16_t{0};
      }
      mixture.source[c] /= static_cast<float>(n);
    }
  });
}

}  // namespace

BeamField march_beams(const SlabWalk& walk, const BeamOptions& options, Progress& progress) {
  const PeriodicSlab& slab = walk.slab();
  BeamField field;
  field.voxels = slab.share().size();
  field.texels = static_cast<std::size_t>(slab.size().x()) * slab.size().y();
  field.directions = options.directions.count();
  const auto n = static_cast<std::size_t>(field.directions);
  field.single.assign(n * field.voxels, Vec3f::Zero());
  field.mirrored.assign(n * field.voxels, Vec3f::Zero());
  field.below.assign(n * field.texels, Vec3f::Zero());
  field.above.assign(n, Vec3f::Zero());
  if (options.sources) {
    field.source.assign(3 * n * field.voxels, 0.0f);
    field.shift.assign(9 * n * field.voxels, 0);
    field.course.assign(3 * n * field.voxels, 0);
    field.mixture.resize(field.voxels);
  }
  std::vector<BeamTally> tallies(std::min<std::size_t>(n, directions_at_once));
  for (BeamTally& tally : tallies) {
    tally.voxels.resize(field.voxels);
    tally.below.resize(field.texels);
  }
  const BeamMarch march(walk, options);
  progress.begin("march light", field.directions);
  for (int first = 0; first < field.directions; first += directions_at_once) {
    const int count = std::min(directions_at_once, field.directions - first);
    parallel_for(
        static_cast<std::size_t>(count),
        [&](std::size_t k) {
          march.direction(first + static_cast<int>(k), tallies[k]);
          progress.advance();
        },
        1);
    gather(slab, options, tallies, first, count, field);
  }
  progress.end();
  if (options.sources) finish(field);
  return field;
}

}  // namespace shellgrid
