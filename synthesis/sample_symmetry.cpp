// SPDX-License-Identifier: AGPL-3.0-or-later
#include "synthesis/sample_symmetry.h"

#include <algorithm>
#include <cmath>
#include <numeric>
#include <vector>

#include "meshing/core/parallel.h"
#include "meshing/core/random.h"

namespace shellgrid {
namespace {

constexpr int query_count = 256, apart = 6;

// The window of a row of weighted_windows, turned by so many quarter turns counter-clockwise.
Eigen::RowVectorXf turn_window(const Eigen::RowVectorXf& window, int turns) {
  const Eigen::Index d = window.size() / 25;
  Eigen::RowVectorXf turned(window.size());
  for (int k = 0; k < 25; ++k) {
    int x = k % 5 - 2, y = k / 5 - 2;
    for (int t = 0; t < turns; ++t) std::swap(x, y), x = -x;
    turned.segment(((y + 2) * 5 + x + 2) * d, d) = window.segment(k * d, d);
  }
  return turned;
}

}  // namespace

RowMatrixf blur_maps(const RowMatrixf& maps, int width, int height, int step) {
  const float weights[5] = {1 / 16.f, 4 / 16.f, 6 / 16.f, 4 / 16.f, 1 / 16.f};
  RowMatrixf across(maps.rows(), maps.cols()), result(maps.rows(), maps.cols());
  for (int pass = 0; pass < 2; ++pass) {
    const RowMatrixf& from = pass == 0 ? maps : across;
    RowMatrixf& to = pass == 0 ? across : result;
    parallel_for(static_cast<std::size_t>(width) * height, [&](std::size_t texel) {
      const int x = static_cast<int>(texel) % width, y = static_cast<int>(texel) / width;
      to.row(texel).setZero();
      for (int k = -2; k <= 2; ++k) {
        const int sx = pass == 0 ? ((x + k * step) % width + width) % width : x;
        const int sy = pass == 1 ? ((y + k * step) % height + height) % height : y;
        to.row(texel) += weights[k + 2] * from.row(sy * width + sx);
      }
    });
  }
  return result;
}

RowMatrixf weighted_windows(const RowMatrixf& maps, int width, int height, int step) {
  RowMatrixf rows(maps.rows(), 25 * maps.cols());
  parallel_for(static_cast<std::size_t>(width) * height, [&](std::size_t texel) {
    const int x = static_cast<int>(texel) % width, y = static_cast<int>(texel) / width;
    for (int k = 0; k < 25; ++k) {
      const int dx = k % 5 - 2, dy = k / 5 - 2;
      const int sx = ((x + dx * step) % width + width) % width, sy = ((y + dy * step) % height + height) % height;
      const float weight = std::exp(-0.125f * static_cast<float>(dx * dx + dy * dy));  // σ = 2 texels, squared weight
      rows.block(texel, k * maps.cols(), 1, maps.cols()) = weight * maps.row(sy * width + sx);
    }
  });
  return rows;
}

SampleSymmetry find_symmetry(const RowMatrixf& maps, int width, int height, std::uint64_t seed, double tolerance) {
  SampleSymmetry result;
  RowMatrixf blurred = maps;
  for (int step = 1; step <= 4 && 5 * step < std::min(width, height); step *= 2) {
    if (step > 1) blurred = blur_maps(blurred, width, height, step / 2);
    const RowMatrixf windows = weighted_windows(blurred, width, height, step);
    const Eigen::VectorXf norms = windows.rowwise().squaredNorm();
    const Eigen::RowVectorXf mean = windows.colwise().mean();
    const double variance = norms.mean() - mean.squaredNorm();
    const int separation = std::min(apart * step, std::min(width, height) / 3);
    // Sums over queries of the distance to the nearest window after 0, 1, 2, 3 quarter turns.
    const std::size_t chunk = 32;
    std::vector<Eigen::Array4d> sums(query_count / chunk, Eigen::Array4d::Zero());
    parallel_chunks(query_count, chunk, [&](std::size_t begin, std::size_t end) {
      const Eigen::Index count = static_cast<Eigen::Index>(end - begin);
      for (int turns = 0; turns < 4; ++turns) {
        RowMatrixf queries(count, windows.cols());
        std::vector<int> texels(count);
        for (Eigen::Index i = 0; i < count; ++i) {
          texels[i] = static_cast<int>(hash64(seed, begin + i, 71) % static_cast<std::uint64_t>(windows.rows()));
          queries.row(i) = turn_window(windows.row(texels[i]), turns);
        }
        const Eigen::MatrixXf products = windows * queries.transpose();
        for (Eigen::Index i = 0; i < count; ++i) {
          float best = 1e30f;
          for (int t = 0; t < width * height; ++t) {
            const float distance = norms[t] - 2 * products(t, i);
            if (distance >= best) continue;
            const int ax = std::abs(t % width - texels[i] % width), ay = std::abs(t / width - texels[i] / width);
            const int dx = std::min(ax, width - ax), dy = std::min(ay, height - ay);
            if (dx * dx + dy * dy >= separation * separation) best = distance;
          }
          sums[begin / chunk][turns] += std::max(0.0f, best + queries.row(i).squaredNorm());
        }
      }
    });
    const Eigen::Array4d mean_distance =
        std::accumulate(sums.begin(), sums.end(), Eigen::Array4d(Eigen::Array4d::Zero())) / query_count;
    // Windows that agree to a hundredth of the variance are alike, however well the sample repeats itself.
    const double own = std::max(mean_distance[0], 0.01 * variance);
    if (!(own > 0)) continue;
    result.half_turn = std::max(result.half_turn, mean_distance[2] / own);
    result.quarter_turn = std::max({result.quarter_turn, mean_distance[1] / own, mean_distance[3] / own});
  }
  result.symmetry = result.half_turn > tolerance ? 1 : result.quarter_turn > tolerance ? 2 : 4;
  return result;
}

}  // namespace shellgrid
