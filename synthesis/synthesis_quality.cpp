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

int wrapped_texel(double u, double v, const TextonSet& textons) {
  const int x = static_cast<int>(std::floor(u)) % textons.width, y = static_cast<int>(std::floor(v)) % textons.height;
  return (y < 0 ? y + textons.height : y) * textons.width + (x < 0 ? x + textons.width : x);
}

struct Window {
  int places, step;  // places × places points `step` texels apart

  int size() const { return places * places; }
  Vec2 place(int k) const { return step * Vec2(k % places - places / 2, k / places - places / 2); }
};

const float* features_of(const TextonSet& textons, int texel) {
  return &textons.features[static_cast<std::size_t>(texel) * dimension];
}

// All windows of the sample, one a row, and what comparing with them needs.
struct SampleWindows {
  RowMatrixf rows;
  Eigen::VectorXf squared_norms;
  double variance = 0;
};

SampleWindows sample_windows(const TextonSet& textons, const Window& window) {
  SampleWindows sample;
  sample.rows.resize(textons.texel_count(), window.size() * dimension);
  parallel_for(textons.texel_count(), [&](std::size_t t) {
    for (int k = 0; k < window.size(); ++k) {
      const Vec2 place = window.place(k) + Vec2(static_cast<double>(t % textons.width) + 0.5,
                                                static_cast<double>(t / textons.width) + 0.5);
      std::copy_n(features_of(textons, wrapped_texel(place.x(), place.y(), textons)), dimension,
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

// Mean squared distance of each row of `windows` to the nearest row of `sample`.
// Over the sample's variance; 0 where it has none.
double mean_nearest_distance(const RowMatrixf& windows, const SampleWindows& sample) {
  if (!(sample.variance > 0) || windows.rows() == 0) return 0;
  const std::size_t chunk = 32;
  std::vector<double> sums((windows.rows() + chunk - 1) / chunk, 0.0);
  parallel_chunks(windows.rows(), chunk, [&](std::size_t begin, std::size_t end) {
    const Eigen::MatrixXf products = sample.rows * windows.middleRows(begin, end - begin).transpose();
    for (std::size_t i = begin; i < end; ++i) {
      Eigen::Index best = 0;
      (sample.squared_norms - 2 * products.col(i - begin)).minCoeff(&best);
      sums[begin / chunk] += (sample.rows.row(best) - windows.row(i)).squaredNorm();
    }
  });
  return std::accumulate(sums.begin(), sums.end(), 0.0) / static_cast<double>(windows.rows()) / sample.variance;
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
      Vec2f difference = texture.coordinate[a] - texture.coordinate[b];
      difference.x() -= textons.width * std::round(difference.x() / textons.width);
      difference.y() -= textons.height * std::round(difference.y() / textons.height);
      const float length = static_cast<float>((mesh.vertex(a) - mesh.vertex(b)).norm() / textons.voxel);
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
        const Vec2 start(random.next() * textons.width, random.next() * textons.height);
        for (int k = 0; k < window.size(); ++k) {
          const TangentNeighbour neighbour = find_tangent_neighbour(texture.surface, texture.hierarchy.levels[0],
                                                                    vertices[i], window.place(k), textons.voxel);
          int texels[3];
          texels[1] = std::min(textons.texel_count() - 1, static_cast<int>(random.next() * textons.texel_count()));
          if (neighbour.vertex < 0) {
            texels[0] = texels[1], texels[2] = texels[1];
          } else {
            const Vec2f& own = texture.coordinate[neighbour.vertex];
            texels[0] = wrapped_texel(own.x(), own.y(), textons);
            texels[2] = wrapped_texel(start.x() + neighbour.offset.x(), start.y() + neighbour.offset.y(), textons);
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
  for (const Vec2f& c : texture.coordinate) surface[textons.textons[wrapped_texel(c.x(), c.y(), textons)]] += 1;
  for (std::int32_t label : textons.textons) sample[label] += 1;
  double sum = 0;
  for (int k = 0; k < textons.texton_count; ++k) {
    const double p = surface[k] / static_cast<double>(texture.coordinate.size());
    const double q = sample[k] / static_cast<double>(textons.texel_count());
    if (p + q > 0) sum += (p - q) * (p - q) / (p + q);
  }
  return sum;
}

double autocorrelation_error(const SurfaceTexture& texture, const TextonSet& textons,
                             const std::vector<int>& vertices) {
  using Features = Eigen::Array<float, dimension, 1>;
  const auto at = [&](int texel) { return Eigen::Map<const Features>(features_of(textons, texel)); };
  Eigen::Array<double, dimension, 1> sum = Eigen::Array<double, dimension, 1>::Zero();
  for (int t = 0; t < textons.texel_count(); ++t) sum += at(t).cast<double>();
  const Features mean = (sum / textons.texel_count()).cast<float>();
  double variance = 0;
  for (int t = 0; t < textons.texel_count(); ++t) variance += (at(t) - mean).square().sum();
  if (!(variance > 0) || vertices.empty()) return 0;
  variance /= textons.texel_count();
  double error = 0;
  int lags = 0;
  for (int length = 1; length <= 8 && 2 * length < std::min(textons.width, textons.height); length *= 2)
    for (const Vec2& lag : {Vec2(length, 0), Vec2(0, length), Vec2(length, length), Vec2(-length, length)}) {
      double of_sample = 0;
      for (int t = 0; t < textons.texel_count(); ++t) {
        const int there = wrapped_texel(t % textons.width + lag.x() + 0.5, t / textons.width + lag.y() + 0.5, textons);
        of_sample += ((at(t) - mean) * (at(there) - mean)).sum();
      }
      struct Pairs {
        double product = 0, count = 0;
        Pairs operator+(const Pairs& other) const { return {product + other.product, count + other.count}; }
      };
      const Pairs pairs = parallel_sum(vertices.size(), Pairs{}, [&](std::size_t i) {
        const TangentNeighbour neighbour =
            find_tangent_neighbour(texture.surface, texture.hierarchy.levels[0], vertices[i], lag, textons.voxel);
        if (neighbour.vertex < 0) return Pairs{};
        const Vec2f &own = texture.coordinate[vertices[i]], &other = texture.coordinate[neighbour.vertex];
        const Features a = at(wrapped_texel(own.x(), own.y(), textons)) - mean;
        const Features b = at(wrapped_texel(other.x(), other.y(), textons)) - mean;
        return Pairs{(a * b).sum(), 1};
      });
      if (pairs.count == 0) continue;
      const double step = (pairs.product / pairs.count - of_sample / textons.texel_count()) / variance;
      error += step * step;
      ++lags;
    }
  return lags > 0 ? std::sqrt(error / lags) : 0;
}

}  // namespace

SynthesisQuality measure_synthesis(const SurfaceTexture& texture, const TextonSet& textons,
                                   const QualityOptions& options) {
  SynthesisQuality quality;
  const int n = texture.surface.mesh.vertex_count();
  std::vector<int> all(n);
  std::iota(all.begin(), all.end(), 0);
  const std::vector<int> vertices = draw(all, options.windows, hash64(options.seed, 61));
  const int side = std::min(textons.width, textons.height);
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
  std::vector<int> use(textons.texel_count(), 0);
  for (const Vec2f& c : texture.coordinate) ++use[wrapped_texel(c.x(), c.y(), textons)];
  double entropy = 0;
  for (int u : use)
    if (u > 0) entropy -= static_cast<double>(u) / n * std::log(static_cast<double>(u) / n);
  quality.texel_entropy = entropy / std::log(static_cast<double>(std::max(2, std::min(n, textons.texel_count()))));

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
