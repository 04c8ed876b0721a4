// SPDX-License-Identifier: AGPL-3.0-or-later
#include "synthesis/synthesis_quality.h"

#include <algorithm>
#include <array>
#include <cmath>
#include <numeric>

#include "meshing/core/parallel.h"
#include "meshing/core/random.h"
#include "synthesis/principal_components.h"

namespace shellgrid {
namespace {

constexpr int dimension = TextonSet::dimension;
constexpr double singular_reach = 3;  // texels around a singularity

int wrapped_texel(const SampleLayer& layer, double u, double v) {
  const int x = static_cast<int>(std::floor(u)) % layer.width, y = static_cast<int>(std::floor(v)) % layer.height;
  return layer.first + (y < 0 ? y + layer.height : y) * layer.width + (x < 0 ? x + layer.width : x);
}

int texel_of(const SurfaceTexture& texture, const TextonSet& textons, int vertex) {
  const Vec2f& c = texture.coordinate[vertex];
  return wrapped_texel(textons.layers[texture.sample[vertex]], c.x(), c.y());
}

int least_side(const TextonSet& textons) {
  int side = 1 << 30;
  for (const SampleLayer& layer : textons.layers.list) side = std::min({side, layer.width, layer.height});
  return side;
}

// Each sample's share of the vertices.
std::vector<double> sample_shares(const SurfaceTexture& texture, const TextonSet& textons) {
  std::vector<double> shares(textons.layers.sample_count, 0.0);
  for (std::int32_t s : texture.sample) shares[s] += 1.0 / static_cast<double>(texture.sample.size());
  return shares;
}

struct Window {
  int places, step;  // places × places points `step` texels apart

  int size() const { return places * places; }
  Vec2 place(int k) const { return step * Vec2(k % places - places / 2, k / places - places / 2); }
};

const float* features_of(const TextonSet& textons, int texel) {
  return &textons.features[static_cast<std::size_t>(texel) * dimension];
}

// All windows of the samples, one a row, and what comparing with them needs.
struct SampleWindows {
  RowMatrixf rows;
  Eigen::VectorXf squared_norms;
  double variance = 0;
};

SampleWindows sample_windows(const TextonSet& textons, const Window& window) {
  SampleWindows sample;
  const int texels = textons.layers.base_texel_count();
  sample.rows.resize(texels, window.size() * dimension);
  parallel_for(texels, [&](std::size_t t) {
    const SampleLayer& layer = textons.layers[textons.layers.layer_of(static_cast<std::int32_t>(t))];
    const int at = static_cast<int>(t) - layer.first;
    for (int k = 0; k < window.size(); ++k) {
      const Vec2 place = window.place(k) + Vec2(at % layer.width + 0.5, at / layer.width + 0.5);
      std::copy_n(features_of(textons, wrapped_texel(layer, place.x(), place.y())), dimension,
                  &sample.rows(static_cast<Eigen::Index>(t), k * dimension));
    }
  });
  sample.squared_norms = sample.rows.rowwise().squaredNorm();
  const Eigen::RowVectorXd mean = sample.rows.cast<double>().colwise().mean();
  sample.variance =
      parallel_sum(static_cast<std::size_t>(sample.rows.rows()), 0.0,
                   [&](std::size_t i) { return (sample.rows.row(i).cast<double>() - mean).squaredNorm(); }) /
      static_cast<double>(sample.rows.rows());
  return sample;
}

// Squared distance of each row of `windows` to the nearest row of `sample`, over the sample's variance; 0 where it has
// none.
std::vector<double> nearest_distances(const RowMatrixf& windows, const SampleWindows& sample) {
  std::vector<double> distances(windows.rows(), 0.0);
  if (!(sample.variance > 0)) return distances;
  parallel_chunks(windows.rows(), 32, [&](std::size_t begin, std::size_t end) {
    const Eigen::MatrixXf products = sample.rows * windows.middleRows(begin, end - begin).transpose();
    for (std::size_t i = begin; i < end; ++i) {
      Eigen::Index best = 0;
      (sample.squared_norms - 2 * products.col(i - begin)).minCoeff(&best);
      distances[i] = (sample.rows.row(best) - windows.row(i)).squaredNorm() / sample.variance;
    }
  });
  return distances;
}

double mean_nearest_distance(const RowMatrixf& windows, const SampleWindows& sample) {
  if (windows.rows() == 0) return 0;
  const std::vector<double> distances = nearest_distances(windows, sample);
  return std::accumulate(distances.begin(), distances.end(), 0.0) / static_cast<double>(windows.rows());
}

// Labels vertices so that mesh neighbours which continue each other share a label; returns each label's size.
std::vector<int> patch_sizes(const SurfaceTexture& texture, const TextonSet& textons, std::vector<int>& label) {
  const TriangleMesh& mesh = texture.surface.mesh;
  label.resize(mesh.vertex_count());
  std::iota(label.begin(), label.end(), 0);
  const auto root = [&](int v) {
    while (label[v] != v) v = label[v] = label[label[v]];
    return v;
  };
  for (int f = 0; f < mesh.face_count(); ++f)
    for (int k = 0; k < 3; ++k) {
      const int a = mesh.faces(f, k), b = mesh.faces(f, (k + 1) % 3);
      if (a > b) continue;
      if (texture.sample[a] != texture.sample[b]) continue;
      const Vec2f difference =
          textons.layers.difference(texture.sample[a], texture.coordinate[a], texture.coordinate[b]);
      const float length =
          static_cast<float>((mesh.vertex(a) - mesh.vertex(b)).norm() / texture.surface.texel_length(a, textons.voxel));
      if (std::abs(difference.norm() - length) < 0.75f) {
        const int ra = root(a), rb = root(b);
        label[std::max(ra, rb)] = std::min(ra, rb);
      }
    }
  std::vector<int> sizes(mesh.vertex_count(), 0);
  for (int v = 0; v < mesh.vertex_count(); ++v) ++sizes[label[v] = root(v)];
  return sizes;
}

// Windows around vertices, one a row: as synthesised, of random texels, of a copy of the sample.
std::array<RowMatrixf, 3> surface_windows(const SurfaceTexture& texture, const TextonSet& textons, const Window& window,
                                          const std::vector<int>& vertices, std::uint64_t seed) {
  std::array<RowMatrixf, 3> sets;
  for (RowMatrixf& set : sets) set.setZero(static_cast<Eigen::Index>(vertices.size()), window.size() * dimension);
  parallel_for(
      vertices.size(),
      [&](std::size_t i) {
        RandomStream random(hash64(seed, 62), i);
        const SampleLayer& layer = textons.layers[texture.sample[vertices[i]]];
        const Vec2 start(random.next() * layer.width, random.next() * layer.height);
        for (int k = 0; k < window.size(); ++k) {
          const TangentNeighbour neighbour = find_tangent_neighbour(texture.surface, texture.hierarchy.levels[0],
                                                                    vertices[i], window.place(k), textons.voxel);
          int texels[3];
          texels[1] =
              layer.first + std::min(layer.texel_count() - 1, static_cast<int>(random.next() * layer.texel_count()));
          if (neighbour.vertex < 0) {
            texels[0] = texels[1], texels[2] = texels[1];
          } else {
            texels[0] = texel_of(texture, textons, neighbour.vertex);
            texels[2] = wrapped_texel(layer, start.x() + neighbour.offset.x(), start.y() + neighbour.offset.y());
          }
          for (int set = 0; set < 3; ++set)
            std::copy_n(features_of(textons, texels[set]), dimension,
                        &sets[set](static_cast<Eigen::Index>(i), k * dimension));
        }
      },
      16);
  return sets;
}

// `count` of the vertices, drawn by hash.
std::vector<int> draw(const std::vector<int>& from, int count, std::uint64_t seed) {
  if (static_cast<int>(from.size()) <= count) return from;
  std::vector<int> drawn(count);
  for (int i = 0; i < count; ++i) {
    const double share = to_unit(hash64(seed, static_cast<std::uint64_t>(i)));
    drawn[i] = from[std::min(from.size() - 1, static_cast<std::size_t>(share * static_cast<double>(from.size())))];
  }
  return drawn;
}

double texton_chi_squared(const SurfaceTexture& texture, const TextonSet& textons) {
  std::vector<double> surface(textons.texton_count, 0.0), sample(textons.texton_count, 0.0);
  const double each = 1 / static_cast<double>(texture.coordinate.size());
  for (std::size_t v = 0; v < texture.coordinate.size(); ++v)
    surface[textons.textons[texel_of(texture, textons, static_cast<int>(v))]] += each;
  const std::vector<double> shares = sample_shares(texture, textons);
  for (int s = 0; s < textons.layers.sample_count; ++s) {
    const SampleLayer& layer = textons.layers[s];
    for (int t = 0; t < layer.texel_count(); ++t)
      sample[textons.textons[layer.first + t]] += shares[s] / layer.texel_count();
  }
  double sum = 0;
  for (int k = 0; k < textons.texton_count; ++k) {
    const double p = surface[k], q = sample[k];
    if (p + q > 0) sum += (p - q) * (p - q) / (p + q);
  }
  return sum;
}

double autocorrelation_error(const SurfaceTexture& texture, const TextonSet& textons,
                             const std::vector<int>& vertices) {
  using Features = Eigen::Array<float, dimension, 1>;
  const auto at = [&](int texel) { return Eigen::Map<const Features>(features_of(textons, texel)); };
  const std::vector<double> shares = sample_shares(texture, textons);
  // Mean over the samples' texels t in layer l of term(t, l).
  const auto mean_of = [&](auto zero, const auto& term) {
    for (int s = 0; s < textons.layers.sample_count; ++s) {
      const SampleLayer& layer = textons.layers[s];
      for (int t = 0; t < layer.texel_count(); ++t)
        zero += shares[s] / layer.texel_count() * term(layer.first + t, layer);
    }
    return zero;
  };
  using Sum = Eigen::Array<double, dimension, 1>;
  const Features mean =
      mean_of(Sum(Sum::Zero()), [&](int t, const SampleLayer&) { return Sum(at(t).cast<double>()); }).cast<float>();
  const double variance =
      mean_of(0.0, [&](int t, const SampleLayer&) { return static_cast<double>((at(t) - mean).square().sum()); });
  if (!(variance > 0) || vertices.empty()) return 0;
  double error = 0;
  int lags = 0;
  for (int length = 1; length <= 8 && 2 * length < least_side(textons); length *= 2)
    for (const Vec2& lag : {Vec2(length, 0), Vec2(0, length), Vec2(length, length), Vec2(-length, length)}) {
      const double of_sample = mean_of(0.0, [&](int t, const SampleLayer& layer) {
        const int x = (t - layer.first) % layer.width, y = (t - layer.first) / layer.width;
        const int there = wrapped_texel(layer, x + lag.x() + 0.5, y + lag.y() + 0.5);
        return static_cast<double>(((at(t) - mean) * (at(there) - mean)).sum());
      });
      struct Pairs {
        double product = 0, count = 0;
        Pairs operator+(const Pairs& other) const { return {product + other.product, count + other.count}; }
      };
      const Pairs pairs = parallel_sum(vertices.size(), Pairs{}, [&](std::size_t i) {
        const TangentNeighbour neighbour =
            find_tangent_neighbour(texture.surface, texture.hierarchy.levels[0], vertices[i], lag, textons.voxel);
        if (neighbour.vertex < 0) return Pairs{};
        const Features a = at(texel_of(texture, textons, vertices[i])) - mean;
        const Features b = at(texel_of(texture, textons, neighbour.vertex)) - mean;
        return Pairs{(a * b).sum(), 1};
      });
      if (pairs.count == 0) continue;
      const double step = (pairs.product / pairs.count - of_sample) / variance;
      error += step * step;
      ++lags;
    }
  return lags > 0 ? std::sqrt(error / lags) : 0;
}

}  // namespace

std::vector<double> window_distances(const SurfaceTexture& texture, const TextonSet& textons,
                                     const std::vector<int>& vertices) {
  const Window window{5, 1};
  return nearest_distances(surface_windows(texture, textons, window, vertices, 0)[0], sample_windows(textons, window));
}

SynthesisQuality measure_synthesis(const SurfaceTexture& texture, const TextonSet& textons,
                                   const QualityOptions& options) {
  SynthesisQuality quality;
  const int n = texture.surface.mesh.vertex_count();
  std::vector<int> all(n);
  std::iota(all.begin(), all.end(), 0);
  const std::vector<int> vertices = draw(all, options.windows, hash64(options.seed, 61));
  const int side = least_side(textons);
  const int wide = options.wide > 0 ? options.wide : side / 2;
  for (const Window& window : {Window{5, 1}, Window{7, 1}, Window{7, std::max(1, (wide - 1) / 6)}}) {
    if (window.step * (window.places - 1) >= side && window.places > 5) continue;  // the sample has no such windows
    const SampleWindows sample = sample_windows(textons, window);
    const auto sets = surface_windows(texture, textons, window, vertices, options.seed);
    WindowDistance distance{window.places, window.step};
    distance.synthesized = mean_nearest_distance(sets[0], sample);
    distance.random = mean_nearest_distance(sets[1], sample);
    distance.tiling = mean_nearest_distance(sets[2], sample);
    if (window.places > 5) {
      quality.wider.push_back(distance);
      continue;
    }
    quality.window_distance = distance.synthesized;
    quality.random = distance.random;
    quality.tiling = distance.tiling;
    if (texture.singularities.empty()) continue;
    std::vector<int> near, far;
    for (int v = 0; v < n; ++v) {
      bool close = false;
      for (const Singularity& s : texture.singularities)
        close = close || (s.point - texture.surface.mesh.vertex(v)).norm() < singular_reach * textons.voxel;
      (close ? near : far).push_back(v);
    }
    const auto distance_at = [&](const std::vector<int>& of) {
      const std::vector<int> drawn = draw(of, options.windows, hash64(options.seed, 63));
      return mean_nearest_distance(surface_windows(texture, textons, window, drawn, options.seed)[0], sample);
    };
    quality.at_singularities = distance_at(near);
    quality.elsewhere = distance_at(far);
  }
  quality.texton_chi_squared = texton_chi_squared(texture, textons);
  quality.autocorrelation_error =
      autocorrelation_error(texture, textons, draw(all, 16 * options.windows, hash64(options.seed, 64)));

  for (float c : texture.coherence) quality.coherence += c;
  quality.coherence /= std::max(1, n);
  const int texels = textons.layers.base_texel_count();
  std::vector<int> use(texels, 0);
  for (int v = 0; v < n; ++v) ++use[texel_of(texture, textons, v)];
  double entropy = 0;
  for (int u : use)
    if (u > 0) entropy -= static_cast<double>(u) / n * std::log(static_cast<double>(u) / n);
  quality.texel_entropy = entropy / std::log(static_cast<double>(std::max(2, std::min(n, texels))));

  std::vector<int> label;
  const std::vector<int> sizes = patch_sizes(texture, textons, label);
  quality.patches = static_cast<int>(std::count_if(sizes.begin(), sizes.end(), [](int s) { return s > 0; }));
  double spread = 0;
  for (int size : sizes)
    if (size > 0) spread -= static_cast<double>(size) / n * std::log(static_cast<double>(size) / n);
  quality.patch_entropy = n > 1 ? spread / std::log(static_cast<double>(n)) : 0;
  std::vector<int> own(n);
  for (int v = 0; v < n; ++v) own[v] = sizes[label[v]];
  if (n > 0) {
    std::nth_element(own.begin(), own.begin() + n / 2, own.end());
    quality.median_patch = own[n / 2];
  }
  return quality;
}

}  // namespace shellgrid
