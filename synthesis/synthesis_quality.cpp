// SPDX-License-Identifier: AGPL-3.0-or-later
#include "synthesis/synthesis_quality.h"

#include <algorithm>
#include <cmath>
#include <numeric>

#include "meshing/core/parallel.h"
#include "meshing/core/random.h"
#include "synthesis/principal_components.h"

namespace shellgrid {
namespace {

constexpr int window_texels = 25;
constexpr int dimension = TextonSet::dimension;

int wrapped_texel(double u, double v, const TextonSet& textons) {
  const int x = static_cast<int>(std::floor(u)) % textons.width, y = static_cast<int>(std::floor(v)) % textons.height;
  return (y < 0 ? y + textons.height : y) * textons.width + (x < 0 ? x + textons.width : x);
}

Vec2 window_place(int k) { return Vec2(k % 5 - 2, k / 5 - 2); }

// All windows of the sample, one a row.
RowMatrixf sample_windows(const TextonSet& textons) {
  RowMatrixf rows(textons.texel_count(), window_texels * dimension);
  parallel_for(textons.texel_count(), [&](std::size_t t) {
    for (int k = 0; k < window_texels; ++k) {
      const Vec2 place = window_place(k) + Vec2(static_cast<double>(t % textons.width) + 0.5,
                                                static_cast<double>(t / textons.width) + 0.5);
      std::copy_n(&textons.features[static_cast<std::size_t>(wrapped_texel(place.x(), place.y(), textons)) * dimension],
                  dimension, &rows(static_cast<Eigen::Index>(t), k * dimension));
    }
  });
  return rows;
}

// Mean squared distance of each row of `windows` to the nearest row of `sample`.
double mean_nearest_distance(const RowMatrixf& windows, const RowMatrixf& sample,
                             const Eigen::VectorXf& squared_norms) {
  const std::size_t chunk = 32;
  std::vector<double> sums((windows.rows() + chunk - 1) / chunk, 0.0);
  parallel_chunks(windows.rows(), chunk, [&](std::size_t begin, std::size_t end) {
    const Eigen::MatrixXf products = sample * windows.middleRows(begin, end - begin).transpose();
    for (std::size_t i = begin; i < end; ++i) {
      Eigen::Index best = 0;
      (squared_norms - 2 * products.col(i - begin)).minCoeff(&best);
      sums[begin / chunk] += (sample.row(best) - windows.row(i)).squaredNorm();
    }
  });
  return std::accumulate(sums.begin(), sums.end(), 0.0) / static_cast<double>(windows.rows());
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

}  // namespace

SynthesisQuality measure_synthesis(const SurfaceTexture& texture, const TextonSet& textons, int vertex_count,
                                   std::uint64_t seed) {
  SynthesisQuality quality;
  const int n = texture.surface.mesh.vertex_count();
  const RowMatrixf sample = sample_windows(textons);
  const Eigen::VectorXf squared_norms = sample.rowwise().squaredNorm();
  const Eigen::RowVectorXd mean = sample.cast<double>().colwise().mean();
  const double variance =
      parallel_sum(static_cast<std::size_t>(sample.rows()), 0.0,
                   [&](std::size_t i) { return (sample.row(i).cast<double>() - mean).squaredNorm(); }) /
      static_cast<double>(sample.rows());
  const int count = std::min(vertex_count, n);
  // Three sets of windows: as synthesised, random, copied.
  RowMatrixf sets[3];
  for (RowMatrixf& set : sets) set.setZero(count, window_texels * dimension);
  parallel_for(
      count,
      [&](std::size_t i) {
        RandomStream random(hash64(seed, 61), i);
        const int vertex = std::min(n - 1, static_cast<int>(random.next() * n));
        const Vec2 start(random.next() * textons.width, random.next() * textons.height);
        for (int k = 0; k < window_texels; ++k) {
          const TangentNeighbour neighbour = find_tangent_neighbour(texture.surface, texture.hierarchy.levels[0],
                                                                    vertex, window_place(k), textons.voxel);
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
            std::copy_n(&textons.features[static_cast<std::size_t>(texels[set]) * dimension], dimension,
                        &sets[set](static_cast<Eigen::Index>(i), k * dimension));
        }
      },
      16);
  double* figures[3] = {&quality.window_distance, &quality.random, &quality.tiling};
  if (variance > 0)
    for (int set = 0; set < 3; ++set)
      *figures[set] = mean_nearest_distance(sets[set], sample, squared_norms) / variance;

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
  std::vector<int> own(n);
  for (int v = 0; v < n; ++v) own[v] = sizes[label[v]];
  if (n > 0) {
    std::nth_element(own.begin(), own.begin() + n / 2, own.end());
    quality.median_patch = own[n / 2];
  }
  return quality;
}

}  // namespace shellgrid
