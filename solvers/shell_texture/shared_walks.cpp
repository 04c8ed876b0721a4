// SPDX-License-Identifier: AGPL-3.0-or-later
#include "solvers/shell_texture/shared_walks.h"

#include <array>
#include <cmath>
#include <limits>

#include "meshing/core/parallel.h"

namespace shellgrid {
namespace {

constexpr std::size_t walks_a_chunk = 64;
constexpr std::size_t ranges = 64;  // of receivers, each summed by one task
constexpr int most_beam_events = 20'000;
constexpr double dark_depth = 80;
constexpr double least_leaping = 0.98;  // share of a layer where leaps are possible, for paths to be split
constexpr float least_tilt = 0.05f;     // of a direction's light at a place over that of all

// A stretch of a walk, or its end.
struct Deposit {
  std::uint32_t receiver, walk;
  float value[3];
};

using DepositLists = std::array<std::vector<Deposit>, ranges>;

// Deposits of one walk: those in the same receivers, nearly all of which come soon after one another, become one.
class WalkDeposits {
 public:
  void add(std::uint32_t receiver, const Float4& value, std::uint32_t walk, int shift, DepositLists& lists) {
    Slot& slot = slots_[(receiver * 0x9e3779b1u) >> 25];
    if (slot.receiver == receiver) {
      slot.value += value;
      return;
    }
    if (slot.receiver != none) move(slot, walk, shift, lists);
    slot = {value, receiver};
  }
  void end(std::uint32_t walk, int shift, DepositLists& lists) {
    for (Slot& slot : slots_) {
      if (slot.receiver == none) continue;
      move(slot, walk, shift, lists);
      slot.receiver = none;
    }
  }

 private:
  static constexpr std::uint32_t none = ~0u;
  struct Slot {
    Float4 value = {};
    std::uint32_t receiver = none;
  };
  static void move(const Slot& slot, std::uint32_t walk, int shift, DepositLists& lists) {
    lists[slot.receiver >> shift].push_back({slot.receiver, walk, {slot.value[0], slot.value[1], slot.value[2]}});
  }
  std::array<Slot, 128> slots_;
};

// A stretch of a beam within a voxel.
struct BeamPiece {
  std::size_t voxel;
  double length;
  Vec3 point, direction;
  Double4 depth;  // before it
};

// Levels of weight with which about as many paths come to each of them. Of white matter one in about 1 + ¾ τ' paths
// comes to the reduced optical depth τ'; where light is absorbed none is worth following farther than its diffuse
// reach. In layers without leaps paths are whole: what splitting saves there in paths it costs in collisions.
class DepthLevels {
 public:
  DepthLevels(const PeriodicSlab& slab, bool upwards) : bottom_(upwards ? slab.depth() : 0), sign_(upwards ? -1 : 1) {
    const Vec3i& size = slab.size();
    const std::size_t texels = static_cast<std::size_t>(size.x()) * size.y();
    leaps_.assign(size.z(), 0);
    voxel_ = slab.voxel();
    double depth = 0;
    for (int k = 0; k < size.z(); ++k) {
      const std::size_t first = static_cast<std::size_t>(upwards ? size.z() - 1 - k : k) * texels;
      double reduced = 0, absorbed = 0, leaping = 0;
      for (std::size_t v = first; v < first + texels; ++v) {
        const PeriodicSlab::Matter& m = slab.matter(v);
        const double share = static_cast<double>(slab.share()[v]) / (3 * static_cast<double>(texels));
        if (slab.leaps().at(v)) leaping += 1 / static_cast<double>(texels);
        for (int c = 0; c < 3; ++c) {
          const auto extinction = static_cast<double>(m.extinction[c]), albedo = static_cast<double>(m.albedo[c]);
          reduced += share * extinction * (1 - albedo * static_cast<double>(m.anisotropy[c]));
          absorbed += share * extinction * (1 - albedo);
        }
      }
      leaps_[first / texels] = reduced > 0 && leaping >= least_leaping;
      if (!leaps_[first / texels]) continue;
      const double most = absorbed > 0 ? std::sqrt(reduced / (3 * absorbed)) : std::numeric_limits<double>::infinity();
      const double end = depth + reduced * slab.voxel();
      // Level n begins where 1 + ¾ τ' is 2^(n − ½).
      for (;;) {
        const double next = (std::exp2(static_cast<double>(begin_.size()) + 0.5) - 1) / 0.75;
        if (next > std::min(end, most)) break;
        begin_.push_back(k * slab.voxel() + std::max(0.0, next - depth) / reduced);
      }
      depth = end;
    }
  }

  int at(double z, int level) const {
    if (begin_.empty()) return 0;
    const auto layer = static_cast<std::ptrdiff_t>(std::max(0.0, z) / voxel_);
    if (!leaps_[std::min(layer, std::ssize(leaps_) - 1)]) return 0;
    const double depth = bottom_ + sign_ * z;
    const auto count = static_cast<int>(begin_.size());
    while (level < count && depth >= begin_[level]) ++level;
    while (level > 0 && depth < begin_[level - 1]) --level;
    return level;
  }

 private:
  double bottom_, sign_, voxel_;
  std::vector<char> leaps_;    // by layer
  std::vector<double> begin_;  // of each level above the first, mm below where paths begin
};

class SharedWalks : public IrradianceBatches {
 public:
  SharedWalks(const SlabWalk& walk, const BeamField& field, const LightDirections& directions,
              std::uint64_t walks_a_batch, std::uint64_t seed)
      : walk_(walk),
        slab_(walk.slab()),
        field_(field),
        directions_(directions),
        batch_(walks_a_batch),
        seed_(seed),
        count_(directions.count()),
        receivers_(field.voxels + field.texels + 1),
        lists_((batch_ + walks_a_chunk - 1) / walks_a_chunk),
        rows_(batch_ * 3 * count_),
        levels_down_(slab_, false),
        levels_up_(slab_, true) {
    while (receivers_ > ranges << range_shift_) ++range_shift_;
    for (int l = 0; l < count_; ++l) inverse_cosine_.push_back(static_cast<float>(1 / directions.direction(l).z()));
  }

  std::uint64_t paths_a_batch() const override { return batch_; }

  void add_upper(IrradianceSums& sums) override {
    const std::uint64_t batch = sums.upper_batches++;
    const std::uint64_t key = hash64(seed_, 0x7570, batch);
    const double shift_x = to_unit(hash64(key, 1)), shift_y = to_unit(hash64(key, 2));
    const std::uint64_t turn = hash64(key, 3) % static_cast<std::uint64_t>(count_);
    trace([&](std::uint64_t k, DepositLists& lists) {
      SlabPath path{PathRandom(key, k)};
      // Source: the plane's additive sequence of [Roberts2018].
      const auto fraction = [](double u) { return u - std::floor(u); };
      const double x = slab_.width(0) * fraction(shift_x + 0.7548776662466927 * static_cast<double>(k));
      const double y = slab_.width(1) * fraction(shift_y + 0.5698402909980532 * static_cast<double>(k));
      const int l = static_cast<int>((turn + k) % static_cast<std::uint64_t>(count_));
      walk_.start_above(path, directions_.direction(l), x, y);
      if (begin(path, rows_.data() + k * 3 * count_)) follow(path, static_cast<std::uint32_t>(k), lists, levels_down_);
    });
    const std::size_t width = 3 * static_cast<std::size_t>(count_), layers = sums.layer_square.size();
    std::vector<double> by_layer(ranges * layers, 0.0);
    sum_ranges([&](std::size_t first, std::size_t end, std::size_t range) {
      std::vector<float> sum((end - first) * width, 0.0f);
      for (const DepositLists& lists : lists_)
        for (const Deposit& d : lists[range]) {
          const float* row = rows_.data() + d.walk * width;
          float* to = sum.data() + (d.receiver - first) * width;
          for (int c = 0; c < 3; ++c) {
            const float value = d.value[c];
            for (int l = 0; l < count_; ++l) to[c * count_ + l] += value * row[c * count_ + l];
          }
        }
      for (std::size_t r = first; r < end; ++r) {
        const float* from = sum.data() + (r - first) * width;
        float* to = sums.upper.data() + r * width;
        for (std::size_t k = 0; k < width; ++k) to[k] += from[k];
        if (batch % 2 == 1 && !sums.upper_half.empty()) {
          float* half = sums.upper_half.data() + r * width;
          for (std::size_t k = 0; k < width; ++k) half[k] += from[k];
        }
        if (r >= field_.voxels) continue;
        if (layers > 0)
          by_layer[range * layers + r / field_.texels] +=
              static_cast<double>(Eigen::Map<const Eigen::ArrayXf>(from, static_cast<Eigen::Index>(width)).sum());
        float* square = sums.upper_square.data() + r * count_;
        for (int l = 0; l < count_; ++l) {
          const float mean = (from[l] + from[count_ + l] + from[2 * count_ + l]) / 3;
          square[l] += mean * mean;
        }
      }
    });
    for (std::size_t z = 0; z < layers; ++z) {
      double sum = 0;
      for (std::size_t range = 0; range < ranges; ++range) sum += by_layer[range * layers + z];
      sums.layer_square[z] += sum * sum;
    }
  }

  void add_back(IrradianceSums& sums) override {
    const std::uint64_t batch = sums.back_batches++;
    const std::uint64_t key = hash64(seed_, 0x6261636b, batch);
    trace([&](std::uint64_t k, DepositLists& lists) {
      SlabPath path{PathRandom(key, k)};
      walk_.start_below(path);
      follow(path, static_cast<std::uint32_t>(k), lists, levels_up_);
    });
    const auto area = static_cast<float>(slab_.width(0) * slab_.width(1) * 3 / static_cast<double>(batch_));
    sum_ranges([&](std::size_t first, std::size_t end, std::size_t range) {
      std::vector<Vec3f> sum(end - first, Vec3f::Zero());
      for (const DepositLists& lists : lists_)
        for (const Deposit& d : lists[range])
          sum[d.receiver - first] += area * Vec3f(d.value[0], d.value[1], d.value[2]);
      for (std::size_t r = first; r < end; ++r) {
        for (int c = 0; c < 3; ++c) sums.back[3 * r + c] += sum[r - first][c];
        if (batch % 2 == 1 && !sums.back_half.empty())
          for (int c = 0; c < 3; ++c) sums.back_half[3 * r + c] += sum[r - first][c];
        if (r < field_.voxels) sums.back_square[r] += sum[r - first].mean() * sum[r - first].mean();
      }
    });
  }

 private:
  struct Visitor {
    const SharedWalks& walks;
    std::uint32_t walk;
    DepositLists& lists;
    const DepthLevels& levels;
    WalkDeposits& deposits;

    int level(const SlabPath& path) const { return levels.at(path.point.z(), path.level); }
    void put(std::size_t receiver, const Double4& value) const {
      deposits.add(static_cast<std::uint32_t>(receiver), to_float(value), walk, walks.range_shift_, lists);
    }
    void way(std::size_t voxel, const Double4& value) const { put(voxel, value); }
    void collided(const SlabPath&) const {}
    void mirrored() const {}
    void leapt() const {}
    void left(const SlabPath& path) const {
      const BeamField& field = walks.field_;
      put(path.direction.z() > 0 ? field.voxels + walks.slab_.texel_at(path.point) : field.voxels + field.texels,
          path.weight);
    }
  };

  void follow(SlabPath& path, std::uint32_t walk, DepositLists& lists, const DepthLevels& levels) const {
    thread_local WalkDeposits deposits;
    Visitor visitor{*this, walk, lists, levels, deposits};
    walk_.follow(path, visitor);
    deposits.end(walk, range_shift_, lists);
  }

  template <class Trace>
  void trace(const Trace& one) {
    parallel_for(
        lists_.size(),
        [&](std::size_t chunk) {
          for (auto& list : lists_[chunk]) list.clear();
          const std::uint64_t end = std::min<std::uint64_t>(batch_, (chunk + 1) * walks_a_chunk);
          for (std::uint64_t k = chunk * walks_a_chunk; k < end; ++k) one(k, lists_[chunk]);
        },
        1);
  }

  template <class Sum>
  void sum_ranges(const Sum& sum) const {
    const std::size_t width = std::size_t{1} << range_shift_;
    parallel_for((receivers_ + width - 1) / width,
                 [&](std::size_t range) { sum(range * width, std::min(receivers_, (range + 1) * width), range); }, 1);
  }

  // Takes light to its first collision, scatters it there and finds what the walk is worth for each direction and
  // channel. False: no light goes on.
  bool begin(SlabPath& path, float* row) const {
    thread_local std::vector<BeamPiece> pieces;
    pieces.clear();
    Double4 depth = {};
    for (int events = 0; events < most_beam_events; ++events) {
      const SlabWalk::Exit exit = walk_.next_exit(path);
      if (!exit.is_known()) break;
      if (path.in_matter)
        walk_.walk_voxels(path, exit.distance, [&](std::size_t voxel, double start, double length) {
          pieces.push_back({voxel, length, path.point + start * path.direction, path.direction, depth});
          depth += to_double(slab_.matter(voxel).extinction) * length;
          return std::min({depth[0], depth[1], depth[2]}) < dark_depth;
        });
      if (std::min({depth[0], depth[1], depth[2]}) >= dark_depth) break;
      path.point += exit.distance * path.direction;
      if (exit.side == SlabWalk::Side::ends) break;
      if (exit.side == SlabWalk::Side::surface)
        walk_.meet(path, exit.normal);
      else
        walk_.wrap(path, exit.side);
    }
    // As much of each channel as collides at all; where, as one of them has it.
    Double4 collides;
    for (int c = 0; c < 3; ++c) collides[c] = path.weight[c] * -std::expm1(-depth[c]);
    collides[3] = 0;
    const double whole = lane_sum(collides);
    if (!(whole > 0)) return false;
    const int hero = choose_channel(collides, path.random.next());
    const double target = -std::log1p(path.random.next() * std::expm1(-depth[hero]));
    auto piece = std::upper_bound(pieces.begin(), pieces.end(), target,
                                  [&](double value, const BeamPiece& p) { return value < p.depth[hero]; });
    if (piece == pieces.begin()) return false;
    --piece;
    const Double4 extinction = to_double(slab_.matter(piece->voxel).extinction);
    if (!(extinction[hero] > 0)) return false;
    const double way = std::min(piece->length, (target - piece->depth[hero]) / extinction[hero]);
    const Double4 density = path.weight * extinction * lane_exponential(-(piece->depth + extinction * way));
    path.weight = reweighted(path.weight, density);
    path.weight *= whole / lane_sum(path.weight);
    path.point = piece->point + way * piece->direction;
    path.direction = piece->direction;
    path.voxel = piece->voxel;
    path.in_matter = true;
    path.weight *= to_double(slab_.matter(path.voxel).albedo);
    const double scattered_light = lane_sum(path.weight);
    if (!(scattered_light > 0)) return false;
    path.weight *= 1 / scattered_light;
    walk_.turn(path);
    weigh(path, scattered_light, row);
    return true;
  }

  void weigh(const SlabPath& path, double scattered_light, float* row) const {
    const BeamField::Mixture& mixture = field_.mixture[path.voxel];
    const Vec3i& size = slab_.size();
    const auto index = static_cast<int>(path.voxel);
    const Vec3f place(static_cast<float>(path.point.x() / slab_.voxel() - index % size.x()),
                      static_cast<float>(path.point.y() / slab_.voxel() - index / size.x() % size.y()),
                      static_cast<float>(path.point.z() / slab_.voxel() - index / (size.x() * size.y())));
    const auto n = static_cast<std::size_t>(count_);
    const Float4 g = slab_.matter(path.voxel).anisotropy;
    const bool uneven = std::abs(g[0]) >= 1e-6f || std::abs(g[1]) >= 1e-6f || std::abs(g[2]) >= 1e-6f;
    thread_local std::vector<float> phase;
    phase.resize(n);
    // 3: of the paths' weights one is shared by three channels.
    const double share = 3 * slab_.width(0) * slab_.width(1) / static_cast<double>(batch_) * scattered_light;
    for (int c = 0; c < 3; ++c) {
      float* to = row + c * n;
      const float* source = field_.source.data() + (3 * path.voxel + c) * n;
      float u[3];
      for (int axis = 0; axis < 3; ++axis)
        u[axis] = (place[axis] - mixture.middle[c][axis]) * mixture.inverse_spread[c][axis] * field_.shift_unit;
      const std::int16_t* shift = field_.shift.data() + (9 * path.voxel + 3 * c) * n;
      for (std::size_t l = 0; l < n; ++l)
        to[l] = source[l] *
                std::max(least_tilt, 1 + u[0] * static_cast<float>(shift[l]) + u[1] * static_cast<float>(shift[n + l]) +
                                         u[2] * static_cast<float>(shift[2 * n + l]));
      if (uneven) {
        if (c == 0 || g[c] != g[c - 1]) find_phase(path, g[c], phase.data());
        for (std::size_t l = 0; l < n; ++l) to[l] *= phase[l];
      }
      float all = 0;
      for (std::size_t l = 0; l < n; ++l) all += to[l] * inverse_cosine_[l];
      const float scale = all > 0 ? static_cast<float>(share) * static_cast<float>(n) / all : 0.0f;
      for (std::size_t l = 0; l < n; ++l) to[l] *= scale;
    }
  }

  // The phase function, but for a factor, of each direction's light. Deviates: where its courses spread their mean
  // stands for them, shorter than one.
  void find_phase(const SlabPath& path, float g, float* phase) const {
    const std::size_t n = static_cast<std::size_t>(count_);
    const std::int16_t* course = field_.course.data() + 3 * path.voxel * n;
    const float unit = g * field_.course_unit;
    const Vec3f out = path.direction.cast<float>();
    for (std::size_t l = 0; l < n; ++l) {
      const float x = unit * static_cast<float>(course[l]), y = unit * static_cast<float>(course[n + l]),
                  z = unit * static_cast<float>(course[2 * n + l]);
      const float square = std::min(0.999f, x * x + y * y + z * z);
      const float t = std::max(1e-6f, 1 + square - 2 * (x * out.x() + y * out.y() + z * out.z()));
      phase[l] = (1 - square) / (t * std::sqrt(t));
    }
  }

  const SlabWalk& walk_;
  const PeriodicSlab& slab_;
  const BeamField& field_;
  LightDirections directions_;
  std::uint64_t batch_, seed_;
  int count_;
  std::size_t receivers_;
  int range_shift_ = 0;              // of receivers to their ranges
  std::vector<DepositLists> lists_;  // by chunk of walks
  std::vector<float> rows_;          // of each walk: worth by channel and direction
  std::vector<float> inverse_cosine_;
  DepthLevels levels_down_, levels_up_;
};

}  // namespace

std::unique_ptr<IrradianceBatches> shared_walks(const SlabWalk& walk, const BeamField& field,
                                                const LightDirections& directions, std::uint64_t walks_a_batch,
                                                std::uint64_t seed) {
  return std::make_unique<SharedWalks>(walk, field, directions, walks_a_batch, seed);
}

}  // namespace shellgrid
