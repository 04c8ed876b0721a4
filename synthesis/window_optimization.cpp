// SPDX-License-Identifier: AGPL-3.0-or-later
#include "synthesis/window_optimization.h"

#include <array>
#include <atomic>
#include <cmath>
#include <limits>

#include "meshing/core/parallel.h"

namespace shellgrid {
namespace {

// What a window elsewhere, and a texel that another window says, must be better by, in variances: without these, texels
// that look the same would be shuffled.
constexpr float move_cost = 0.01f, change_cost = 0.03f;
constexpr int reach = 2, across = 2 * reach + 1, places = across * across, centre = places / 2;

using Features = Eigen::Array<float, TextonSet::dimension, 1>;

Vec2f window_place(int k) { return {static_cast<float>(k % across - reach), static_cast<float>(k / across - reach)}; }

class WindowOptimizer {
 public:
  WindowOptimizer(const TexturedSurface& surface, const VertexHierarchy::Level& finest, const TextonSet& textons,
                  const std::function<bool(std::int32_t, int)>& allowed, bool exhaustive,
                  std::vector<LayerPlace>& place)
      : textons_(textons),
        layers_(textons.layers),
        allowed_(allowed),
        exhaustive_(exhaustive),
        place_(place),
        windows_(place) {
    neighbours_.resize(place.size() * places);
    parallel_for(
        place.size(),
        [&](std::size_t v) {
          for (int k = 0; k < places; ++k)
            if (k != centre)
              neighbours_[v * places + k] =
                  find_tangent_neighbour(surface, finest, static_cast<int>(v), window_place(k).cast<double>(),
                                         textons.voxel, layers_.symmetry);
            else
              neighbours_[v * places + k].vertex = static_cast<std::int32_t>(v);
        },
        64);
    Features mean = Features::Zero(), squares = Features::Zero();
    for (int t = 0; t < layers_.base_texel_count(); ++t) mean += features(t), squares += features(t).square();
    variance_ = (squares / layers_.base_texel_count() - (mean / layers_.base_texel_count()).square()).sum();
    for (int k = 0; k < places; ++k)
      total_weight_ += weight_[k] = std::exp(-0.125f * window_place(k).squaredNorm());  // σ = 2 texels
  }

  long run(int passes) {
    std::vector<LayerPlace> next(place_.size());
    shown_.resize(place_.size());
    for (int pass = 0; pass < passes; ++pass) {
      parallel_for(place_.size(), [&](std::size_t v) { shown_[v] = layers_.texel(place_[v]); });
      parallel_for(
          place_.size(), [&](std::size_t v) { next[v] = nearest_window(v); }, 64);
      windows_.swap(next);
      parallel_for(
          place_.size(), [&](std::size_t v) { next[v] = nearest_to_mean(v); }, 64);
      place_.swap(next);
    }
    return comparisons_;
  }

 private:
  Eigen::Map<const Features> features(std::int32_t texel) const {
    return Eigen::Map<const Features>(&textons_.features[static_cast<std::size_t>(texel) * TextonSet::dimension]);
  }
  LayerPlace continued(const TangentNeighbour& neighbour, const LayerPlace& there) const {
    LayerPlace from = layers_.turned(there, -neighbour.turn);
    from.at = layers_.wrap(from.layer, from.at - neighbour.rotate(neighbour.offset));
    return from;
  }

  // The place whose window in the sample is most like that of the vertex.
  LayerPlace nearest_window(std::size_t v) {
    const TangentNeighbour* around = &neighbours_[v * places];
    std::array<Features, places> wanted;
    std::array<int, places> used;
    int count = 0;
    // The middle first: most unlike places are left at once.
    for (int i = 0; i < places; ++i) {
      const int k = (centre + i) % places;
      if (around[k].vertex < 0) continue;
      wanted[count] = features(shown_[around[k].vertex]);
      used[count++] = k;
    }
    float best_distance = std::numeric_limits<float>::max();
    LayerPlace best = windows_[v];
    long compared = 0;
    const std::int32_t own = layers_.texel(windows_[v]);
    std::array<std::int32_t, 64> seen;
    int seen_count = 0;
    const auto consider = [&](int layer_index, std::int32_t texel, const Vec2f& fraction) {
      for (int i = 0; i < seen_count; ++i)
        if (seen[i] == texel) return;
      if (seen_count < static_cast<int>(seen.size())) seen[seen_count++] = texel;
      const SampleLayer& layer = layers_[layer_index];
      if (!allowed_(static_cast<std::int32_t>(v), layer.sample)) return;
      ++compared;
      const int tx = (texel - layer.first) % layer.width, ty = (texel - layer.first) / layer.width;
      float distance = texel != own ? move_cost * variance_ * total_weight_ : 0.0f;
      for (int i = 0; i < count; ++i) {
        int x = tx + used[i] % across - reach, y = ty + used[i] / across - reach;
        x += x < 0 ? layer.width : x >= layer.width ? -layer.width : 0;
        y += y < 0 ? layer.height : y >= layer.height ? -layer.height : 0;
        distance += weight_[used[i]] * (wanted[i] - features(layer.first + y * layer.width + x)).square().sum();
        if (distance >= best_distance) return;
      }
      best_distance = distance;
      best = {layer_index, Vec2f(static_cast<float>(tx), static_cast<float>(ty)) + fraction};
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
    const std::int32_t* candidates = textons_.levels[0].candidates.data() +
                                     static_cast<std::size_t>(layers_.texel(from)) * textons_.candidates_each();
    for (int k = 0; k < textons_.candidates_each(); ++k)
      if (candidates[k] >= 0) consider(layers_.layer_of(candidates[k]), candidates[k], fraction);
    for (std::int32_t t = 0; exhaustive_ && t < layers_.texel_count(); ++t)
      consider(layers_.layer_of(t), t, Vec2f(0.5f, 0.5f));
    comparisons_.fetch_add(compared, std::memory_order_relaxed);
    return best;
  }

  // Of what the windows around say, the nearest to their mean.
  LayerPlace nearest_to_mean(std::size_t v) const {
    const TangentNeighbour* around = &neighbours_[v * places];
    std::array<LayerPlace, places> said;
    std::array<std::int32_t, places> texels;
    int count = 0;
    Features sum = Features::Zero();
    float total = 0;
    for (int i = 0; i < places; ++i) {
      const int k = (centre + i) % places;
      if (around[k].vertex < 0) continue;
      said[count] = k == centre ? windows_[v] : continued(around[k], windows_[around[k].vertex]);
      if (!allowed_(static_cast<std::int32_t>(v), layers_[said[count].layer].sample)) continue;
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
  const bool exhaustive_;
  std::vector<LayerPlace>& place_;
  std::vector<LayerPlace> windows_;           // n: where in the sample the vertex's window is
  std::vector<std::int32_t> shown_;           // n: texel of the vertex's place
  std::vector<TangentNeighbour> neighbours_;  // n·25
  std::array<float, places> weight_;
  std::atomic<long> comparisons_ = 0;
  float variance_ = 0, total_weight_ = 0;
};

}  // namespace

long optimize_windows(const TexturedSurface& surface, const VertexHierarchy::Level& finest, const TextonSet& textons,
                      int passes, bool exhaustive, const std::function<bool(std::int32_t, int)>& allowed,
                      std::vector<LayerPlace>& place) {
  return passes > 0 ? WindowOptimizer(surface, finest, textons, allowed, exhaustive, place).run(passes) : 0;
}

}  // namespace shellgrid
