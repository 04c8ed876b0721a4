// SPDX-License-Identifier: AGPL-3.0-or-later
#include "synthesis/solid_synthesis.h"

#include <fmt/format.h>

#include <algorithm>
#include <cmath>
#include <memory>

#include "meshing/core/error.h"
#include "meshing/core/parallel.h"
#include "meshing/core/random.h"
#include "synthesis/clustering.h"
#include "synthesis/slice_windows.h"

namespace shellgrid {
namespace {

constexpr int least_side = 24;  // of the coarsest exemplar, texels
constexpr std::size_t most_searched_whole = 5000;

// The exemplar at one resolution. Axes with the same slices share their windows.
struct ExemplarLevel {
  std::array<SliceStack, 3> stacks;
  std::array<std::shared_ptr<SliceWindows>, 3> windows;
  // Kinds of texels and of windows, and the share of each: what a solid must not have too much of.
  std::array<std::vector<std::uint8_t>, 3> texel_class, window_class;
  std::vector<double> texel_share;
  std::array<std::vector<double>, 3> window_share;
  float texel_variance = 0;
  std::array<float, 3> window_variance{};
};

constexpr int texel_classes = 24, window_classes = 64;

// Mean squared distance from the mean.
float variance_of(const RowMatrixf& rows) {
  const Eigen::RowVectorXf mean = rows.colwise().mean();
  return (rows.rowwise() - mean).rowwise().squaredNorm().mean();
}

// K-means of a few thousand rows, evenly spread; all rows' labels.
Clusters cluster_all(const RowMatrixf& rows, int count, std::uint64_t seed) {
  constexpr Eigen::Index most = 3000;
  if (rows.rows() <= most) return cluster(rows, count, 8, seed);
  RowMatrixf some(most, rows.cols());
  for (Eigen::Index i = 0; i < most; ++i) some.row(i) = rows.row(i * rows.rows() / most);
  Clusters clusters = cluster(some, count, 8, seed);
  clusters.labels.assign(static_cast<std::size_t>(rows.rows()), 0);
  const Eigen::MatrixXf columns = clusters.centers;
  parallel_chunks(static_cast<std::size_t>(rows.rows()), 256, [&](std::size_t begin, std::size_t end) {
    Eigen::ArrayXf squared(columns.rows());
    for (std::size_t i = begin; i < end; ++i) {
      squared.setZero();
      for (Eigen::Index d = 0; d < rows.cols(); ++d)
        squared += (columns.col(d).array() - rows(static_cast<Eigen::Index>(i), d)).square();
      Eigen::Index nearest;
      squared.minCoeff(&nearest);
      clusters.labels[i] = static_cast<std::int32_t>(nearest);
    }
  });
  return clusters;
}

void classify(ExemplarLevel& level, int channels, std::uint64_t seed) {
  std::vector<float> all;
  for (const SliceStack& stack : level.stacks) all.insert(all.end(), stack.values.begin(), stack.values.end());
  const RowMatrixf texels =
      Eigen::Map<const RowMatrixf>(all.data(), static_cast<Eigen::Index>(all.size()) / channels, channels);
  level.texel_variance = variance_of(texels);
  const Clusters kinds = cluster_all(texels, texel_classes, seed);
  level.texel_share.assign(static_cast<std::size_t>(kinds.centers.rows()), 0.0);
  std::size_t at = 0;
  for (int d = 0; d < 3; ++d)
    for (std::size_t t = 0; t < level.stacks[d].texel_count(); ++t, ++at) {
      level.texel_class[d].push_back(static_cast<std::uint8_t>(kinds.labels[at]));
      // Each view counts as much as the others.
      level.texel_share[kinds.labels[at]] += 1.0 / (3.0 * static_cast<double>(level.stacks[d].texel_count()));
    }
  for (int d = 0; d < 3; ++d) {
    for (int other = 0; other < d && level.window_class[d].empty(); ++other)
      if (level.windows[d] == level.windows[other]) {
        level.window_class[d] = level.window_class[other];
        level.window_share[d] = level.window_share[other];
        level.window_variance[d] = level.window_variance[other];
      }
    if (!level.window_class[d].empty()) continue;
    const SliceWindows& windows = *level.windows[d];
    const RowMatrixf features =
        Eigen::Map<const RowMatrixf>(windows.features(0), windows.count(), SliceWindows::dimension);
    level.window_variance[d] = variance_of(features);
    const Clusters looks = cluster_all(features, window_classes, seed);
    level.window_share[d].assign(static_cast<std::size_t>(looks.centers.rows()), 0.0);
    for (std::int32_t label : looks.labels) {
      level.window_class[d].push_back(static_cast<std::uint8_t>(label));
      level.window_share[d][label] += 1.0 / windows.count();
    }
  }
}

bool same_stack(const SliceStack& a, const SliceStack& b) {
  return a.width == b.width && a.height == b.height && a.slices == b.slices && a.values == b.values;
}

// The solid at one resolution while it is worked on.
class SolidLevel {
 public:
  SolidLevel(const ExemplarLevel& exemplar, int channels, const Vec3i& size, const SolidOptions& options, int window,
             std::uint64_t seed)
      : exemplar_(exemplar),
        channels_(channels),
        size_(size),
        options_(options),
        window_(window),
        half_(window / 2),
        seed_(seed) {
    const std::size_t count = voxel_count();
    values_.resize(count * channels);
    axis_.resize(count);
    texel_.resize(count);
    for (int d = 0; d < 3; ++d) {
      match_[d].assign(count, -1);
      distance_[d].assign(count, 0.0f);
      window_use_[d].assign(exemplar.windows[d]->count(), 0);
      texel_use_[d].assign(exemplar.stacks[d].texel_count(), 0);
    }
    for (int parity = 0; parity < 8; ++parity)
      for (int z = parity >> 2; z < size.z(); z += 2)
        for (int y = parity >> 1 & 1; y < size.y(); y += 2)
          for (int x = parity & 1; x < size.x(); x += 2)
            subsets_[parity].push_back(static_cast<std::int32_t>(index(x, y, z)));
  }

  void start_at_random() {
    parallel_for(voxel_count(), [&](std::size_t i) {
      const int d = static_cast<int>(hash64(seed_, 1, i) % 3);
      set_texel(i, d, static_cast<std::int32_t>(hash64(seed_, 2, i) % exemplar_.stacks[d].texel_count()));
      for (int axis = 0; axis < 3; ++axis)
        if (has_window(axis, place_of(i)))
          match_[axis][i] = static_cast<std::int32_t>(hash64(seed_, 3 + axis, i) % exemplar_.windows[axis]->count());
    });
    count_uses();
  }

  // Each voxel takes over where its parent lies in the exemplar, at twice the resolution.
  void start_from(const SolidLevel& coarse) {
    parallel_for(voxel_count(), [&](std::size_t i) {
      const Vec3i p = place_of(i);
      const std::size_t parent = coarse.index(p.x() / 2, p.y() / 2, p.z() / 2);
      const auto child = [&](int d, std::int32_t texel, const SliceStack& from) {
        const SliceStack& stack = exemplar_.stacks[d];
        Vec3i place(2 * (texel % from.width) + p[column_axis(d)] % 2,
                    2 * (texel / from.width % from.height) + p[row_axis(d)] % 2,
                    stack.slices == 1 ? 0 : 2 * (texel / from.width / from.height) + p[d] % 2);
        return place.cwiseMin(Vec3i(stack.width - 1, stack.height - 1, stack.slices - 1)).eval();
      };
      const int d = coarse.axis_[parent];
      const Vec3i place = child(d, coarse.texel_[parent], coarse.exemplar_.stacks[d]);
      const SliceStack& stack = exemplar_.stacks[d];
      set_texel(i, d, (place.z() * stack.height + place.y()) * stack.width + place.x());
      for (int axis = 0; axis < 3; ++axis) {
        if (!has_window(axis, p)) continue;
        // Parents at the top and the bottom have no windows of their own there.
        Vec3i from(p.x() / 2, p.y() / 2, p.z() / 2);
        if (axis != 2) from.z() = std::clamp(from.z(), coarse.half_, coarse.size_.z() - 1 - coarse.half_);
        const int window = coarse.match_[axis][coarse.index(from.x(), from.y(), from.z())];
        const Vec3i middle = child(axis, coarse.exemplar_.windows[axis]->centre(window), coarse.exemplar_.stacks[axis]);
        match_[axis][i] = exemplar_.windows[axis]->at(middle.x(), middle.y(), middle.z());
      }
    });
    count_uses();
  }

  // Matches every window of every slice to the exemplar's.
  void match_windows(bool exhaustive, std::uint64_t pass) {
    for (int d = 0; d < 3; ++d) {
      const double share =
          static_cast<double>(options_.evenness) * exemplar_.windows[d]->count() / static_cast<double>(voxel_count());
      for (const std::vector<std::int32_t>& subset : subsets_) {
        std::vector<std::int32_t> next(subset.size(), -1);
        std::vector<float> distances(subset.size(), 0.0f);
        parallel_chunks(subset.size(), 256, [&](std::size_t begin, std::size_t end) {
          std::vector<float> entries(exemplar_.windows[d]->entry_count());
          for (std::size_t s = begin; s < end; ++s)
            if (has_window(d, place_of(subset[s])))
              next[s] = best_window(d, subset[s], exhaustive, share, pass, entries.data(), distances[s]);
        });
        for (std::size_t s = 0; s < subset.size(); ++s) {
          if (next[s] < 0) continue;
          std::int32_t& match = match_[d][subset[s]];
          --window_use_[d][match];
          ++window_use_[d][next[s]];
          --class_windows_[d][exemplar_.window_class[d][match]];
          ++class_windows_[d][exemplar_.window_class[d][next[s]]];
          match = next[s];
          distance_[d][subset[s]] = distances[s];
        }
      }
    }
  }

  // Gives every voxel the proposed texel nearest to the mean of what the windows over it propose.
  void choose_texels() {
    for (const std::vector<std::int32_t>& subset : subsets_) {
      std::vector<std::uint8_t> axis(subset.size());
      std::vector<std::int32_t> texel(subset.size());
      parallel_chunks(subset.size(), 256, [&](std::size_t begin, std::size_t end) {
        Proposals proposals;
        for (std::size_t s = begin; s < end; ++s) best_texel(subset[s], proposals, axis[s], texel[s]);
      });
      for (std::size_t s = 0; s < subset.size(); ++s) {
        const std::size_t i = subset[s];
        --texel_use_[axis_[i]][texel_[i]];
        ++texel_use_[axis[s]][texel[s]];
        --class_texels_[exemplar_.texel_class[axis_[i]][texel_[i]]];
        ++class_texels_[exemplar_.texel_class[axis[s]][texel[s]]];
        set_texel(i, axis[s], texel[s]);
      }
    }
  }

  SolidTexture cut(int layers) const {
    SolidTexture solid;
    solid.size = Vec3i(size_.x(), size_.y(), layers);
    const std::size_t count = static_cast<std::size_t>(size_.x()) * size_.y() * layers;
    solid.axis.assign(axis_.begin(), axis_.begin() + static_cast<std::ptrdiff_t>(count));
    solid.texel.assign(texel_.begin(), texel_.begin() + static_cast<std::ptrdiff_t>(count));
    return solid;
  }

 private:
  struct Proposal {
    const float* value;
    float weight;
    std::int32_t texel;
    std::uint8_t axis;
  };
  using Proposals = std::vector<Proposal>;

  std::size_t voxel_count() const { return static_cast<std::size_t>(size_.x()) * size_.y() * size_.z(); }
  std::size_t index(int x, int y, int z) const { return (static_cast<std::size_t>(z) * size_.y() + y) * size_.x() + x; }
  Vec3i place_of(std::size_t i) const {
    return {static_cast<int>(i % size_.x()), static_cast<int>(i / size_.x() % size_.y()),
            static_cast<int>(i / size_.x() / size_.y())};
  }
  std::size_t wrapped(const Vec3i& p) const {
    const auto wrap = [](int i, int n) { return i < 0 ? (i % n + n) % n : i % n; };
    return index(wrap(p.x(), size_.x()), wrap(p.y(), size_.y()), p.z());
  }
  // Windows that would reach beyond the top or the bottom are not asked.
  bool has_window(int axis, const Vec3i& p) const {
    return axis == 2 ? p.z() >= 0 && p.z() < size_.z() : p.z() >= half_ && p.z() < size_.z() - half_;
  }
  void set_texel(std::size_t i, int axis, std::int32_t texel) {
    axis_[i] = static_cast<std::uint8_t>(axis);
    texel_[i] = texel;
    const float* from = exemplar_.stacks[axis].values.data() + static_cast<std::size_t>(texel) * channels_;
    std::copy(from, from + channels_, values_.data() + i * channels_);
  }
  void count_uses() {
    for (int d = 0; d < 3; ++d) {
      std::fill(window_use_[d].begin(), window_use_[d].end(), 0);
      std::fill(texel_use_[d].begin(), texel_use_[d].end(), 0);
      for (std::int32_t window : match_[d])
        if (window >= 0) ++window_use_[d][window];
    }
    class_texels_.assign(exemplar_.texel_share.size(), 0);
    for (std::size_t i = 0; i < voxel_count(); ++i) {
      ++texel_use_[axis_[i]][texel_[i]];
      ++class_texels_[exemplar_.texel_class[axis_[i]][texel_[i]]];
    }
    for (int d = 0; d < 3; ++d) {
      class_windows_[d].assign(exemplar_.window_share[d].size(), 0);
      matches_[d] = 0;
      for (std::int32_t window : match_[d])
        if (window >= 0) ++class_windows_[d][exemplar_.window_class[d][window]], ++matches_[d];
    }
  }

  // How far beyond their share of the voxels texels of this kind, or windows, are; 0 where they are not.
  double class_excess(int d, std::int32_t texel) const {
    const int kind = exemplar_.texel_class[d][texel];
    const double wanted = exemplar_.texel_share[kind] * static_cast<double>(voxel_count());
    return std::max(0.0, class_texels_[kind] / std::max(1.0, wanted) - 1);
  }
  double window_class_excess(int d, std::int32_t window) const {
    const int kind = exemplar_.window_class[d][window];
    const double wanted = exemplar_.window_share[d][kind] * static_cast<double>(matches_[d]);
    return std::max(0.0, class_windows_[d][kind] / std::max(1.0, wanted) - 1);
  }

  std::int32_t best_window(int d, std::size_t i, bool exhaustive, double share, std::uint64_t pass, float* entries,
                           float& least) const {
    const SliceWindows& windows = *exemplar_.windows[d];
    const Vec3i p = place_of(i);
    const Vec3i along_u = Vec3i::Unit(column_axis(d)), along_v = Vec3i::Unit(row_axis(d)), across = Vec3i::Unit(d);
    float* entry = entries;
    for (int v = -half_; v <= half_; ++v)
      for (int u = -half_; u <= half_; ++u) {
        const float* value = values_.data() + wrapped(p + u * along_u + v * along_v) * channels_;
        for (int c = 0; c < channels_; ++c) *entry++ = value[c];
      }
    alignas(64) float features[SliceWindows::dimension];
    windows.project(entries, features);

    const float slack = 0.02f * exemplar_.window_variance[d];
    float lowest_cost = std::numeric_limits<float>::infinity();
    std::int32_t best = match_[d][i];
    least = windows.distance(features, best);
    const auto consider = [&](std::int32_t window) {
      const float distance = windows.distance(features, window);
      if (distance >= lowest_cost) return;
      // What is used beyond its share counts as farther; the voxel's own use does not count.
      const double uses = share * (window_use_[d][window] - (window == match_[d][i] ? 1 : 0));
      const float cost =
          (distance + slack) * static_cast<float>(1 + 0.5 * options_.evenness * std::max(0.0, uses - 1) +
                                                  4 * options_.evenness * window_class_excess(d, window));
      if (cost < lowest_cost) lowest_cost = cost, best = window, least = distance;
    };
    if (exhaustive) {
      for (int window = 0; window < windows.count(); ++window) consider(window);
      return best;
    }
    const auto consider_similar = [&](std::int32_t window) {
      if (window < 0) return;
      consider(window);
      const std::int32_t* similar = windows.similar(window);
      for (int k = 0; k < windows.neighbours() && similar[k] >= 0; ++k) consider(similar[k]);
    };
    consider_similar(match_[d][i]);
    for (int side = -1; side <= 1; side += 2) {
      if (const Vec3i q = p + side * along_u; has_window(d, q))
        consider_similar(windows.moved(match_[d][wrapped(q)], -side, 0, 0));
      if (const Vec3i q = p + side * along_v; has_window(d, q))
        consider_similar(windows.moved(match_[d][wrapped(q)], 0, -side, 0));
      // In a photograph the next slice is the same picture, and so may well be the place.
      if (const Vec3i q = p + side * across; has_window(d, q))
        consider_similar(windows.moved(match_[d][wrapped(q)], 0, 0, windows.slices() > 1 ? -side : 0));
    }
    for (std::uint64_t trial = 0; trial < 2; ++trial)
      consider(static_cast<std::int32_t>(hash64(hash64(seed_, pass, trial), i, d) % windows.count()));
    return best;
  }

  void best_texel(std::size_t i, Proposals& proposals, std::uint8_t& chosen_axis, std::int32_t& chosen) const {
    const Vec3i p = place_of(i);
    proposals.clear();
    std::array<float, 8> mean{};
    float total = 0;
    const int reach = std::min(half_, 2);
    for (int d = 0; d < 3; ++d) {
      const SliceStack& stack = exemplar_.stacks[d];
      const Vec3i along_u = Vec3i::Unit(column_axis(d)), along_v = Vec3i::Unit(row_axis(d));
      // A share of the texels' uses each.
      const double share = 3.0 * static_cast<double>(stack.texel_count()) / static_cast<double>(voxel_count());
      for (int v = -reach; v <= reach; ++v)
        for (int u = -reach; u <= reach; ++u) {
          const Vec3i q = p + u * along_u + v * along_v;
          if (!has_window(d, q)) continue;
          const std::size_t at = wrapped(q);
          const std::int32_t texel = exemplar_.windows[d]->centre(match_[d][at]) - v * stack.width - u;
          const float* value = stack.values.data() + static_cast<std::size_t>(texel) * channels_;
          const double uses = share * (texel_use_[d][texel] - (texel_[i] == texel && axis_[i] == d ? 1 : 0));
          // Source: [Kopf2007 eq. 3, 6]: robust, with less for what is in use too often.
          const float weight = static_cast<float>(
              falloff(u, v) / std::pow(distance_[d][at] + 0.002f * exemplar_.window_variance[d] + 1e-12f, 0.6f) /
              ((1 + options_.evenness * std::max(0.0, uses - 1)) *
               (1 + 15 * options_.evenness * class_excess(d, texel))));
          for (int c = 0; c < channels_; ++c) mean[c] += weight * value[c];
          total += weight;
          proposals.push_back({value,
                               static_cast<float>(1 + 0.5 * options_.evenness * std::max(0.0, uses - 1) +
                                                  5 * options_.evenness * class_excess(d, texel)),
                               texel, static_cast<std::uint8_t>(d)});
        }
    }
    for (int c = 0; c < channels_; ++c) mean[c] /= total;
    float lowest = std::numeric_limits<float>::infinity();
    const float slack = 0.01f * exemplar_.texel_variance + 1e-12f;
    for (const Proposal& proposal : proposals) {
      float distance = slack;
      for (int c = 0; c < channels_; ++c) distance += (proposal.value[c] - mean[c]) * (proposal.value[c] - mean[c]);
      distance *= proposal.weight;
      if (distance < lowest) lowest = distance, chosen = proposal.texel, chosen_axis = proposal.axis;
    }
  }

  static float falloff(int u, int v) {
    static const float by_square[9] = {1.0f, 0.8f, 0.64f, 0, 0.41f, 0.33f, 0, 0, 0.17f};
    return by_square[u * u + v * v];
  }

  const ExemplarLevel& exemplar_;
  int channels_;
  Vec3i size_;
  const SolidOptions& options_;
  int window_, half_;
  std::uint64_t seed_;
  std::vector<float> values_;
  std::vector<std::uint8_t> axis_;
  std::vector<std::int32_t> texel_;
  std::array<std::vector<std::int32_t>, 3> match_;  // windows; −1 where a slice has none
  std::array<std::vector<float>, 3> distance_;
  std::array<std::vector<std::int32_t>, 3> window_use_, texel_use_;
  std::vector<std::int64_t> class_texels_;  // voxels of each kind
  std::array<std::vector<std::int64_t>, 3> class_windows_;
  std::array<std::int64_t, 3> matches_{};
  std::array<std::vector<std::int32_t>, 8> subsets_;  // voxels by parity: what is updated together
};

void check(const SolidExemplar& exemplar, const SolidOptions& options) {
  if (exemplar.channels < 1 || exemplar.channels > 8) throw InputError("a texel has 1 to 8 channels");
  for (int d = 0; d < 3; ++d) {
    const SliceStack& stack = exemplar.axes[d];
    if (stack.width < 8 || stack.height < 8 || stack.slices < 1)
      throw InputError(fmt::format("the view along {} has {} by {} texels; expected at least 8 by 8", "xyz"[d],
                                   stack.width, stack.height));
    if (stack.texel_count() > (1u << 24))
      throw InputError(fmt::format("the view along {} has more than 2^24 texels", "xyz"[d]));
    if (stack.values.size() != stack.texel_count() * exemplar.channels)
      throw InternalError("a view's values do not fit its size");
    for (float value : stack.values)
      if (!std::isfinite(value))
        throw InputError(fmt::format("the view along {} holds a value that is not finite", "xyz"[d]));
  }
  if ((options.size.array() < 1).any() || options.size.x() < 4 || options.size.y() < 4 ||
      options.size.cast<double>().prod() > 5e7)
    throw InputError(
        fmt::format("a solid of {} x {} x {} voxels is out of range; expected 4 at least in x and y, 5e7 in all",
                    options.size.x(), options.size.y(), options.size.z()));
  if (options.window < 3 || options.window > 15 || options.window % 2 == 0)
    throw InputError("a window has 3 to 15 texels a side, an odd number");
  if (options.candidates < 0 || options.candidates > 16 || options.coarse_passes < 1 || options.fine_passes < 1 ||
      !(options.evenness >= 0))
    throw InputError("passes, candidates or evenness are out of range");
}

}  // namespace

SolidTexture synthesize_solid(const SolidExemplar& exemplar, const SolidOptions& options, Progress& progress) {
  check(exemplar, options);
  int side = exemplar.axes[0].width;
  for (const SliceStack& stack : exemplar.axes) side = std::min({side, stack.width, stack.height});
  int level_count = 1;
  while (level_count < 6 && (side >> level_count) >= least_side &&
         (std::min(options.size.x(), options.size.y()) >> level_count) >= least_side / 2)
    ++level_count;
  const int window =
      std::min(options.window, (side >> (level_count - 1)) / 2 * 2 - 1 >= options.window ? options.window : 5);

  std::vector<ExemplarLevel> levels(level_count);
  levels[0].stacks = exemplar.axes;
  for (int l = 0; l < level_count; ++l) {
    if (l > 0)
      for (int d = 0; d < 3; ++d) levels[l].stacks[d] = halved(levels[l - 1].stacks[d], exemplar.channels);
    for (int d = 0; d < 3; ++d) {
      for (int other = 0; other < d && !levels[l].windows[d]; ++other)
        if (same_stack(levels[l].stacks[d], levels[l].stacks[other])) levels[l].windows[d] = levels[l].windows[other];
      // The coarsest level is searched whole where it is small.
      const bool whole = l + 1 == level_count && levels[l].stacks[d].texel_count() <= most_searched_whole;
      if (!levels[l].windows[d])
        levels[l].windows[d] = std::make_shared<SliceWindows>(levels[l].stacks[d], exemplar.channels, window,
                                                              whole ? 0 : options.candidates);
    }
  }
  for (int l = 0; l < level_count; ++l)
    classify(levels[l], exemplar.channels, hash64(options.seed, 77, static_cast<std::uint64_t>(l)));
  std::vector<Vec3i> sizes(level_count);
  sizes[0] = Vec3i(options.size.x(), options.size.y(), std::max(options.size.z(), window));
  for (int l = 1; l < level_count; ++l)
    sizes[l] =
        Vec3i((sizes[l - 1].x() + 1) / 2, (sizes[l - 1].y() + 1) / 2, std::max((sizes[l - 1].z() + 1) / 2, window));

  std::unique_ptr<SolidLevel> solid;
  progress.begin("solid", options.coarse_passes + (level_count - 1) * options.fine_passes);
  for (int l = level_count - 1; l >= 0; --l) {
    auto next = std::make_unique<SolidLevel>(levels[l], exemplar.channels, sizes[l], options, window,
                                             hash64(options.seed, static_cast<std::uint64_t>(l)));
    const bool coarsest = !solid;
    if (coarsest)
      next->start_at_random();
    else
      next->start_from(*solid);
    solid = std::move(next);
    const bool exhaustive =
        coarsest && std::all_of(levels[l].stacks.begin(), levels[l].stacks.end(),
                                [](const SliceStack& s) { return s.texel_count() <= most_searched_whole; });
    const int passes = coarsest ? options.coarse_passes : options.fine_passes;
    for (int pass = 0; pass < passes; ++pass) {
      solid->match_windows(exhaustive, static_cast<std::uint64_t>(pass));
      solid->choose_texels();
      progress.advance();
    }
  }
  progress.end();
  return solid->cut(options.size.z());
}

}  // namespace shellgrid
