// SPDX-License-Identifier: AGPL-3.0-or-later
#include "synthesis/window_optimization.h"

#include <algorithm>
#include <array>
#include <atomic>
#include <cmath>
#include <limits>
#include <numeric>

#include "meshing/core/parallel.h"
#include "meshing/core/random.h"
#include "synthesis/sample_symmetry.h"
#include "synthesis/window_index.h"

namespace shellgrid {
namespace {

// What a window elsewhere, and a texel that another window says, must be better by, in variances: without these, texels
// that look the same would be shuffled.
constexpr float move_cost = 0.01f, change_cost = 0.03f;
constexpr float search_bound = 0.02f;  // windows that differ by less, in variances, are near enough
constexpr int nearest_count = 8;
constexpr float nearest_share = 0.25f;  // these are within twice the distance of the nearest
// Vertices find their windows in as many turns, and the texels' use is counted anew before each, so that not all leave
// at once what is used too often.
constexpr int use_groups = 4;
constexpr float few_uses = 8;
constexpr int reach = 2, across = 2 * reach + 1, places = across * across, centre = places / 2;

using Features = Eigen::Array<float, TextonSet::dimension, 1>;

// The middle first, then places far from one another: most unlike windows are left at once.
constexpr std::array<int, places> visits = {12, 10, 14, 2,  22, 0, 4, 20, 24, 6,  8,  16, 18,
                                            11, 13, 7,  17, 1,  3, 5, 9,  15, 19, 21, 23};
constexpr int together = 4;  // places that are summed before a window may be left

Vec2f window_place(int k) { return {static_cast<float>(k % across - reach), static_cast<float>(k / across - reach)}; }

class WindowOptimizer {
 public:
  WindowOptimizer(const TexturedSurface& surface, const VertexHierarchy::Level& level, const SynthesisLevel& near,
                  int l, const TextonSet& textons, const WindowOptions& options,
                  const std::function<bool(std::int32_t, int)>& allowed, std::vector<LayerPlace>& place)
      : textons_(textons),
        layers_(textons.layers),
        allowed_(allowed),
        options_(options),
        vertices_(level.vertices),
        l_(l),
        step_(1 << l),
        place_(place),
        windows_(place) {
    neighbours_.resize(vertices_.size() * places);
    std::array<int, SynthesisLevel::slots> slot_place;
    std::array<bool, places> known{};
    for (int s = 0; s < SynthesisLevel::slots; ++s) {
      const Vec2f& offset = SynthesisLevel::offsets[s];
      slot_place[s] = centre + across * static_cast<int>(offset.y()) + static_cast<int>(offset.x());
      known[slot_place[s]] = true;
    }
    parallel_for(
        vertices_.size(),
        [&](std::size_t i) {
          TangentNeighbour* around = &neighbours_[i * places];
          around[centre].vertex = vertices_[i];
          for (int s = 0; s < SynthesisLevel::slots; ++s) around[slot_place[s]] = near.neighbour(i, s);
          for (int k = 0; k < places; ++k)
            if (k != centre && !known[k])
              around[k] = find_tangent_neighbour(surface, level, vertices_[i], step_ * window_place(k).cast<double>(),
                                                 textons.voxel, layers_.symmetry);
        },
        64);
    find_features();
    find_surroundings();
    Features mean = Features::Zero(), squares = Features::Zero();
    for (int t = 0; t < layers_.base_texel_count(); ++t) mean += features(t), squares += features(t).square();
    variance_ = (squares / layers_.base_texel_count() - (mean / layers_.base_texel_count()).square()).sum();
    for (int k = 0; k < places; ++k)
      total_weight_ += weight_[k] = std::exp(-0.125f * window_place(k).squaredNorm());  // σ = 2 texels
  }

  long run(int passes) {
    index_.emplace(layers_, places, [&](const SampleLayer& layer, int at, auto row) { gather_window(layer, at, row); });
    std::vector<LayerPlace> next_window(windows_), next(place_);
    shown_.resize(place_.size());
    window_changed_.assign(place_.size(), 1);
    std::vector<char> window_now_changed;
    const int groups = options_.evenness > 0 ? use_groups : 1;
    if (options_.evenness > 0) find_bases();
    const auto group_of = [&](std::int32_t v, int pass) {
      return groups == 1 ? 0 : static_cast<int>(hash64(81, static_cast<std::uint64_t>(v), pass) % groups);
    };
    shown_changed_.assign(place_.size(), 1);
    for (int pass = 0; pass < passes; ++pass) {
      parallel_for(vertices_.size(), [&](std::size_t i) {
        const std::int32_t v = vertices_[i], texel = layers_.texel(place_[v]);
        shown_changed_[v] = pass == 0 || shown_[v] != texel;
        shown_[v] = texel;
      });
      window_now_changed.assign(place_.size(), 0);
      for (int group = 0; group < groups; ++group) {
        if (options_.evenness > 0) weigh_use();
        parallel_for(
            vertices_.size(),
            [&](std::size_t i) {
              const std::int32_t v = vertices_[i];
              if (group_of(v, pass) != group) return;
              bool dirty = pass == 0 || penalty(layers_.texel(windows_[v])) > move_cost;
              const TangentNeighbour* around = &neighbours_[i * places];
              for (int k = 0; k < places && !dirty; ++k)
                dirty =
                    around[k].vertex >= 0 && (shown_changed_[around[k].vertex] || window_changed_[around[k].vertex]);
              next_window[v] = dirty ? nearest_window(i) : windows_[v];
            },
            64);
        parallel_for(vertices_.size(), [&](std::size_t i) {
          const std::int32_t v = vertices_[i];
          if (group_of(v, pass) != group) return;
          window_now_changed[v] = next_window[v].layer != windows_[v].layer || next_window[v].at != windows_[v].at;
          windows_[v] = next_window[v];
        });
      }
      window_changed_.swap(window_now_changed);
      parallel_for(
          vertices_.size(), [&](std::size_t i) { next[vertices_[i]] = nearest_to_mean(i); }, 64);
      parallel_for(vertices_.size(), [&](std::size_t i) { place_[vertices_[i]] = next[vertices_[i]]; });
    }
    return comparisons_;
  }

 private:
  Eigen::Map<const Features> features(std::int32_t texel) const {
    return Eigen::Map<const Features>(&features_[static_cast<std::size_t>(texel) * TextonSet::dimension]);
  }
  bool may_take(std::int32_t v, int sample) const { return layers_.sample_count == 1 || allowed_(v, sample); }
  LayerPlace continued(const TangentNeighbour& neighbour, const LayerPlace& there) const {
    LayerPlace from = layers_.turned(there, -neighbour.turn);
    from.at = layers_.wrap(from.layer, from.at - neighbour.rotate(neighbour.offset));
    return from;
  }

  void find_features() {
    features_ = textons_.features;
    if (l_ == 0) return;
    for (const SampleLayer& layer : layers_.list) {
      Eigen::Map<RowMatrixf> rows(&features_[static_cast<std::size_t>(layer.first) * TextonSet::dimension],
                                  layer.texel_count(), TextonSet::dimension);
      for (int step = 1; step < step_; step *= 2) rows = blur_maps(RowMatrixf(rows), layer.width, layer.height, step);
    }
  }

  // Copies the layers with what surrounds them, so that no window needs to wrap around.
  void find_surroundings() {
    const int border = reach * step_;
    std::size_t size = 0;
    for (const SampleLayer& layer : layers_.list)
      size += static_cast<std::size_t>(layer.width + 2 * border) * (layer.height + 2 * border);
    surrounded_.resize(size * TextonSet::dimension);
    surrounded_texel_.resize(layers_.texel_count());
    std::int32_t first = 0;
    for (const SampleLayer& layer : layers_.list) {
      const int stride = layer.width + 2 * border;
      std::array<std::int32_t, places>& steps = window_steps_.emplace_back();
      for (int k = 0; k < places; ++k)
        steps[k] = ((k / across - reach) * stride + k % across - reach) * step_ * TextonSet::dimension;
      for (int y = -border; y < layer.height + border; ++y)
        for (int x = -border; x < layer.width + border; ++x) {
          const int sx = (x % layer.width + layer.width) % layer.width;
          const int sy = (y % layer.height + layer.height) % layer.height;
          const std::int32_t texel = layer.first + sy * layer.width + sx;
          const std::int32_t at = first + ((y + border) * stride + x + border) * TextonSet::dimension;
          Eigen::Map<Features> copy(&surrounded_[at]);
          copy = features(texel);
          if (x == sx && y == sy) surrounded_texel_[texel] = at;
        }
      first += stride * (layer.height + 2 * border) * TextonSet::dimension;
    }
  }

  void find_bases() {
    base_.resize(layers_.texel_count());
    for (int l = 0; l < layers_.size(); ++l)
      for (int t = 0; t < layers_[l].texel_count(); ++t)
        base_[layers_[l].first + t] = layers_.turned_texel(layers_[l].first + t, -layers_.turn_of(l));
    penalty_.assign(layers_.base_texel_count(), 0.0f);
  }
  float penalty(std::int32_t texel) const { return base_.empty() ? 0.0f : penalty_[base_[texel]]; }

  // What each texel costs for being used more often than its share, counted over about the level's step around it.
  void weigh_use() {
    std::vector<float> use(layers_.base_texel_count(), 0.0f);
    for (std::int32_t v : vertices_) use[base_[layers_.texel(windows_[v])]] += 1;
    for (int s = 0; s < layers_.sample_count; ++s) {
      const SampleLayer& layer = layers_[s];
      float* const own = &use[layer.first];
      const float expected =
          std::accumulate(own, own + layer.texel_count(), 0.0f) / static_cast<float>(layer.texel_count());
      float spread = 0;  // variance of where a use counts, texels²
      for (int step = 1; step <= step_; step *= 2) {
        blur(layer, step, own);
        spread += static_cast<float>(step * step);
      }
      const float area = 4 * static_cast<float>(M_PI) * spread;
      for (int t = 0; t < layer.texel_count(); ++t) {
        // Where few are expected, as many again say little.
        const float ratio = (own[t] * area + few_uses) / (expected * area + few_uses);
        penalty_[layer.first + t] = static_cast<float>(options_.evenness) * std::clamp(ratio - 1, 0.0f, 2.0f);
      }
    }
  }

  // With [1 4 6 4 1]/16 along both axes, wrapping around.
  static void blur(const SampleLayer& layer, int step, float* values) {
    std::vector<float> line;
    const auto blur_line = [&](int count, int stride, float* first) {
      line.resize(count);
      for (int i = 0; i < count; ++i) line[i] = first[static_cast<std::ptrdiff_t>(i) * stride];
      const int one = step % count, two = 2 * step % count;
      for (int i = 0; i < count; ++i)
        first[static_cast<std::ptrdiff_t>(i) * stride] =
            (6 * line[i] + 4 * (line[(i + one) % count] + line[(i + count - one) % count]) + line[(i + two) % count] +
             line[(i + count - two) % count]) /
            16;
    };
    for (int y = 0; y < layer.height; ++y)
      blur_line(layer.width, 1, values + static_cast<std::ptrdiff_t>(y) * layer.width);
    for (int x = 0; x < layer.width; ++x) blur_line(layer.height, layer.width, values + x);
  }

  // A row of the features around a texel, each times the root of its weight.
  template <class Row>
  void gather_window(const SampleLayer& layer, int at, Row&& row) const {
    const int x = at % layer.width, y = at / layer.width;
    for (int k = 0; k < places; ++k) {
      const int sx = ((x + (k % across - reach) * step_) % layer.width + layer.width) % layer.width;
      const int sy = ((y + (k / across - reach) * step_) % layer.height + layer.height) % layer.height;
      row.segment(k * TextonSet::dimension, TextonSet::dimension) =
          std::sqrt(weight_[k]) * features(layer.first + sy * layer.width + sx).matrix().transpose();
    }
  }

  // The place whose window in the sample is most like that of the vertex.
  LayerPlace nearest_window(std::size_t position) {
    const std::int32_t v = vertices_[position];
    const TangentNeighbour* around = &neighbours_[position * places];
    std::array<Features, places> wanted;
    std::array<int, places> used;
    std::array<float, places> weights;
    int count = 0;
    for (const int k : visits) {
      if (around[k].vertex < 0) continue;
      wanted[count] = features(shown_[around[k].vertex]);
      weights[count] = weight_[k];
      used[count++] = k;
    }
    float best_distance = std::numeric_limits<float>::max();
    LayerPlace best = windows_[v];
    long compared = 0;
    const std::int32_t own = layers_.texel(windows_[v]);
    std::array<std::int32_t, 64> seen;
    std::uint64_t seen_bits = 0;  // of the texels' last six bits
    int seen_count = 0;
    const float unit = variance_ * total_weight_;
    const auto consider = [&](int layer_index, std::int32_t texel, const Vec2f& fraction) {
      const std::uint64_t bit = std::uint64_t{1} << (texel & 63);
      if ((seen_bits & bit) != 0)
        for (int i = 0; i < seen_count; ++i)
          if (seen[i] == texel) return;
      seen_bits |= bit;
      if (seen_count < static_cast<int>(seen.size())) seen[seen_count++] = texel;
      const SampleLayer& layer = layers_[layer_index];
      if (!may_take(v, layer.sample)) return;
      ++compared;
      float distance = ((texel != own ? move_cost : 0.0f) + penalty(texel)) * unit;
      const float* const middle = &surrounded_[surrounded_texel_[texel]];
      const std::array<std::int32_t, places>& steps = window_steps_[layer_index];
      for (int first = 0; first < count; first += together) {
        Features sum = Features::Zero();
        for (int i = first; i < std::min(count, first + together); ++i)
          sum += weights[i] * (wanted[i] - Eigen::Map<const Features>(middle + steps[used[i]])).square();
        distance += sum.sum();
        if (distance >= best_distance) return;
      }
      best_distance = distance;
      const int at = texel - layer.first;
      best = {layer_index,
              Vec2f(static_cast<float>(at % layer.width), static_cast<float>(at / layer.width)) + fraction};
    };
    const auto consider_place = [&](const LayerPlace& place) {
      consider(place.layer, layers_.texel(place), place.at - place.at.array().floor().matrix());
    };
    consider_place(windows_[v]);
    consider_place(place_[v]);
    for (int k = 0; k < places; ++k)
      if (k != centre && around[k].vertex >= 0) consider_place(continued(around[k], windows_[around[k].vertex]));
    const LayerPlace from = best;
    const Vec2f fraction = from.at - from.at.array().floor().matrix();
    const std::int32_t* candidates = textons_.levels[l_].candidates.data() +
                                     static_cast<std::size_t>(layers_.texel(from)) * textons_.candidates_each();
    for (int k = 0; k < textons_.candidates_each(); ++k)
      if (candidates[k] >= 0) consider(layers_.layer_of(candidates[k]), candidates[k], fraction);
    // Where no candidate fits, the windows of all that are nearest in their principal components are some more.
    if (best_distance > search_bound * unit && count == places) {
      WindowIndex::Point query = index_->origin();
      for (int i = 0; i < places; ++i)
        index_->contribute(used[i], Features(std::sqrt(weight_[used[i]]) * wanted[i]), query);
      std::array<std::int32_t, AppearanceTree::few> nearest;
      const float own_penalty = penalty(layers_.texel(best));
      const auto may_be = [&](std::int32_t t) {
        return penalty(t) <= own_penalty && may_take(v, layers_[layers_.layer_of(t)].sample);
      };
      const int found = index_->tree().nearest_few(query, may_be, best_distance - move_cost * unit, nearest_count,
                                                   nearest_share, nearest.data());
      for (int i = 0; i < found; ++i) consider(layers_.layer_of(nearest[i]), nearest[i], Vec2f(0.5f, 0.5f));
    }
    for (std::int32_t t = 0; options_.exhaustive && t < layers_.texel_count(); ++t)
      consider(layers_.layer_of(t), t, Vec2f(0.5f, 0.5f));
    comparisons_.fetch_add(compared, std::memory_order_relaxed);
    return best;
  }

  // Of what the windows around say, the nearest to their mean.
  LayerPlace nearest_to_mean(std::size_t position) const {
    const std::int32_t v = vertices_[position];
    const TangentNeighbour* around = &neighbours_[position * places];
    std::array<LayerPlace, places> said;
    std::array<std::int32_t, places> texels;
    int count = 0;
    Features sum = Features::Zero();
    float total = 0;
    for (int i = 0; i < places; ++i) {
      const int k = (centre + i) % places;
      if (around[k].vertex < 0) continue;
      said[count] = k == centre ? windows_[v] : continued(around[k], windows_[around[k].vertex]);
      if (!may_take(v, layers_[said[count].layer].sample)) continue;
      texels[count] = layers_.texel(said[count]);
      sum += weight_[k] * features(texels[count++]);
      total += weight_[k];
    }
    if (count == 0) return place_[v];
    const Features mean = sum / total;
    int best = 0;
    float best_distance = std::numeric_limits<float>::max();
    for (int i = 0; i < count; ++i) {
      const float distance = (features(texels[i]) - mean).square().sum() + (i > 0 ? change_cost * variance_ : 0.0f);
      if (distance < best_distance) best_distance = distance, best = i;
    }
    return said[best];
  }

  const TextonSet& textons_;
  const SampleLayers& layers_;
  const std::function<bool(std::int32_t, int)>& allowed_;
  const WindowOptions options_;
  const std::vector<std::int32_t>& vertices_;
  const int l_, step_;
  std::vector<LayerPlace>& place_;
  std::vector<LayerPlace> windows_;  // n: where in the sample the vertex's window is
  std::vector<std::int32_t> shown_;  // n: texel of the vertex's place
  std::vector<char> shown_changed_, window_changed_;
  std::vector<TangentNeighbour> neighbours_;  // 25 for each vertex of the level
  std::vector<float> features_;
  std::vector<float> surrounded_;                               // features of the layers and of what surrounds them
  std::vector<std::int32_t> surrounded_texel_;                  // where in it each texel stands
  std::vector<std::array<std::int32_t, places>> window_steps_;  // of each layer: from the middle to a window's places
  std::vector<std::int32_t> base_;
  std::vector<float> penalty_;
  std::array<float, places> weight_;
  std::optional<WindowIndex> index_;
  std::atomic<long> comparisons_ = 0;
  float variance_ = 0, total_weight_ = 0;
};

}  // namespace

long optimize_windows(const TexturedSurface& surface, const VertexHierarchy::Level& level,
                      const SynthesisLevel& neighbours, int l, const TextonSet& textons, const WindowOptions& options,
                      const std::function<bool(std::int32_t, int)>& allowed, std::vector<LayerPlace>& place) {
  if (options.passes <= 0) return 0;
  return WindowOptimizer(surface, level, neighbours, l, textons, options, allowed, place).run(options.passes);
}

}  // namespace shellgrid
