// SPDX-License-Identifier: AGPL-3.0-or-later
#include "synthesis/window_optimization.h"

#include <array>
#include <atomic>
#include <cmath>
#include <limits>
#include <numeric>
#include <optional>

#include "meshing/core/parallel.h"
#include "synthesis/appearance_tree.h"

namespace shellgrid {
namespace {

// What a window elsewhere, and a texel that another window says, must be better by, in variances: without these, texels
// that look the same would be shuffled.
constexpr float move_cost = 0.01f, change_cost = 0.03f;
constexpr float search_bound = 0.05f;  // windows that differ by less, in variances, are near enough
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
    index_windows();
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

  // A row of the features around a texel, each times the root of its weight.
  template <class Row>
  void gather_window(const SampleLayer& layer, int at, Row&& row) const {
    const int x = at % layer.width, y = at / layer.width;
    for (int k = 0; k < places; ++k) {
      const int sx = ((x + k % across - reach) % layer.width + layer.width) % layer.width;
      const int sy = ((y + k / across - reach) % layer.height + layer.height) % layer.height;
      row.segment(k * TextonSet::dimension, TextonSet::dimension) =
          std::sqrt(weight_[k]) * features(layer.first + sy * layer.width + sx).matrix().transpose();
    }
  }

  // The principal components of the samples' windows, and a tree of all layers'.
  void index_windows() {
    RowMatrixf rows(layers_.base_texel_count(), places * TextonSet::dimension);
    RowMatrixf reduced(layers_.texel_count(), AppearanceTree::dimension);
    for (int l = 0; l < layers_.size(); ++l) {
      const SampleLayer& layer = layers_[l];
      const int first = l < layers_.sample_count ? layer.first : 0;
      parallel_for(layer.texel_count(), [&](std::size_t at) {
        gather_window(layer, static_cast<int>(at), rows.row(first + static_cast<Eigen::Index>(at)));
      });
      if (l + 1 == layers_.sample_count) {
        components_ = find_principal_components(rows, AppearanceTree::dimension);
        reduced.topRows(rows.rows()) = project(rows, components_);
      } else if (l >= layers_.sample_count) {
        reduced.middleRows(layer.first, layer.texel_count()) = project(rows.topRows(layer.texel_count()), components_);
      }
    }
    reduced_ = std::move(reduced);
    std::vector<std::int32_t> all(layers_.texel_count());
    std::iota(all.begin(), all.end(), 0);
    tree_.emplace(reduced_, std::move(all));
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
    // Where no candidate fits, the window of all that is nearest in its principal components is one more.
    if (best_distance > search_bound * variance_ * total_weight_ && count == places) {
      AppearanceTree::Point query = -(components_.mean * components_.basis).transpose().array();
      for (int i = 0; i < places; ++i)
        query += std::sqrt(weight_[used[i]]) *
                 (components_.basis.middleRows(used[i] * TextonSet::dimension, TextonSet::dimension).transpose() *
                  wanted[i].matrix())
                     .array();
      float distance = std::numeric_limits<float>::max();
      std::int32_t nearest = std::numeric_limits<std::int32_t>::max();
      const auto may_be = [&](std::int32_t t) {
        return layers_.sample_count == 1 || allowed_(static_cast<std::int32_t>(v), layers_[layers_.layer_of(t)].sample);
      };
      tree_->nearest(query, may_be, distance, nearest);
      if (nearest < layers_.texel_count()) consider(layers_.layer_of(nearest), nearest, fraction);
    }
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
  PrincipalComponents components_;
  RowMatrixf reduced_;
  std::optional<AppearanceTree> tree_;
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
