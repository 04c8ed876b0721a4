// SPDX-License-Identifier: AGPL-3.0-or-later
#include "synthesis/slice_windows.h"

#include <Eigen/Eigenvalues>
#include <algorithm>
#include <limits>
#include <numeric>

#include "meshing/core/parallel.h"
#include "meshing/core/random.h"

namespace shellgrid {
namespace {

using Features = Eigen::Map<const Eigen::Array<float, SliceWindows::dimension, 1>>;

constexpr int most_for_all_pairs = 6000, reach_by_component = 1500;

}  // namespace

SliceStack halved(const SliceStack& stack, int channels) {
  SliceStack half;
  half.width = std::max(1, stack.width / 2);
  half.height = std::max(1, stack.height / 2);
  half.slices = stack.slices == 1 ? 1 : std::max(1, stack.slices / 2);
  half.values.assign(half.texel_count() * channels, 0.0f);
  const int depth = stack.slices == 1 ? 1 : 2;
  const auto texel = [&](int u, int v, int s) {
    return (static_cast<std::size_t>(std::min(s, stack.slices - 1)) * stack.height + std::min(v, stack.height - 1)) *
               stack.width +
           std::min(u, stack.width - 1);
  };
  for (int s = 0; s < half.slices; ++s)
    for (int v = 0; v < half.height; ++v)
      for (int u = 0; u < half.width; ++u) {
        float* own = half.values.data() + ((static_cast<std::size_t>(s) * half.height + v) * half.width + u) * channels;
        for (int part = 0; part < 4 * depth; ++part) {
          const std::size_t from = texel(2 * u + (part & 1), 2 * v + (part >> 1 & 1), depth * s + (part >> 2));
          for (int c = 0; c < channels; ++c)
            own[c] += stack.values[from * channels + c] / static_cast<float>(4 * depth);
        }
      }
  return half;
}

SliceWindows::SliceWindows(const SliceStack& stack, int channels, int window, int neighbours)
    : stack_(stack),
      channels_(channels),
      window_(window),
      neighbours_(neighbours),
      columns_(stack.width - window + 1),
      rows_(stack.height - window + 1),
      slices_(stack.slices) {
  find_basis();
  features_.resize(static_cast<std::size_t>(count()) * dimension);
  parallel_chunks(static_cast<std::size_t>(count()), 256, [&](std::size_t begin, std::size_t end) {
    std::vector<float> entries(entry_count());
    for (std::size_t i = begin; i < end; ++i) {
      gather(static_cast<int>(i), entries.data());
      project(entries.data(), features_.data() + i * dimension);
    }
  });
  find_similar();
}

std::int32_t SliceWindows::centre(int window) const {
  const int u = window % columns_ + window_ / 2, v = window / columns_ % rows_ + window_ / 2;
  return (window / columns_ / rows_ * stack_.height + v) * stack_.width + u;
}

int SliceWindows::at(int column, int row, int slice) const {
  const int u = std::clamp(column - window_ / 2, 0, columns_ - 1), v = std::clamp(row - window_ / 2, 0, rows_ - 1);
  return (std::clamp(slice, 0, slices_ - 1) * rows_ + v) * columns_ + u;
}

void SliceWindows::gather(int window, float* entries) const {
  const int u = window % columns_, v = window / columns_ % rows_, s = window / columns_ / rows_;
  for (int row = 0; row < window_; ++row) {
    const float* from =
        stack_.values.data() + ((static_cast<std::size_t>(s) * stack_.height + v + row) * stack_.width + u) * channels_;
    entries = std::copy(from, from + window_ * channels_, entries);
  }
}

void SliceWindows::project(const float* entries, float* features) const {
  Eigen::Array<float, dimension, 1> sum = Eigen::Array<float, dimension, 1>::Zero();
  for (int e = 0; e < entry_count(); ++e)
    sum += (entries[e] - mean_[e]) * Features(basis_.data() + static_cast<std::size_t>(e) * dimension);
  Eigen::Map<Eigen::Array<float, dimension, 1>>(features, dimension) = sum;
}

float SliceWindows::distance(const float* features, int window) const {
  return (Features(features) - Features(this->features(window))).square().sum();
}

int SliceWindows::nearest(const float* features, float& distance) const {
  int best = 0;
  distance = std::numeric_limits<float>::infinity();
  for (int i = 0; i < count(); ++i) {
    const float d = this->distance(features, i);
    if (d < distance) distance = d, best = i;
  }
  return best;
}

void SliceWindows::find_basis() {
  // Of a few thousand windows, evenly spread.
  const int entries = entry_count(), used = std::min(count(), 6000);
  Eigen::MatrixXd rows(used, entries);
  std::vector<float> window(entries);
  for (int i = 0; i < used; ++i) {
    gather(static_cast<int>(static_cast<std::int64_t>(i) * count() / used), window.data());
    for (int e = 0; e < entries; ++e) rows(i, e) = window[e];
  }
  const Eigen::RowVectorXd mean = rows.colwise().mean();
  rows.rowwise() -= mean;
  const Eigen::MatrixXd covariance = rows.transpose() * rows;
  const Eigen::SelfAdjointEigenSolver<Eigen::MatrixXd> solver(covariance);
  mean_.assign(entries, 0.0f);
  basis_.assign(static_cast<std::size_t>(entries) * dimension, 0.0f);
  for (int e = 0; e < entries; ++e) mean_[e] = static_cast<float>(mean[e]);
  for (int d = 0; d < std::min(dimension, entries); ++d) {
    Eigen::VectorXd direction = solver.eigenvectors().col(entries - 1 - d);
    Eigen::Index largest;
    direction.cwiseAbs().maxCoeff(&largest);
    if (direction[largest] < 0) direction = -direction;
    for (int e = 0; e < entries; ++e)
      basis_[static_cast<std::size_t>(e) * dimension + d] = static_cast<float>(direction[e]);
  }
}

void SliceWindows::find_similar() {
  const int n = count();
  similar_.assign(static_cast<std::size_t>(n) * neighbours_, -1);
  // Of many windows only those with a similar first component are compared.
  std::vector<std::int32_t> order(n), rank(n);
  std::iota(order.begin(), order.end(), 0);
  std::sort(order.begin(), order.end(), [&](int a, int b) {
    const float fa = features_[static_cast<std::size_t>(a) * dimension],
                fb = features_[static_cast<std::size_t>(b) * dimension];
    return fa != fb ? fa < fb : a < b;
  });
  for (int i = 0; i < n; ++i) rank[order[i]] = i;
  const int reach = n <= most_for_all_pairs ? n : reach_by_component;
  parallel_for(
      static_cast<std::size_t>(n),
      [&](std::size_t i) {
        const int self = static_cast<int>(i), first = std::max(0, rank[i] - reach),
                  last = std::min(n, rank[i] + reach + 1);
        const float* own = features(self);
        const int u = self % columns_, v = self / columns_ % rows_, s = self / columns_ / rows_;
        std::vector<float> best(neighbours_, std::numeric_limits<float>::infinity());
        std::int32_t* found = similar_.data() + i * neighbours_;
        for (int r = first; r < last && neighbours_ > 0; ++r) {
          const int other = order[r];
          const float d = distance(own, other);
          if (d >= best[neighbours_ - 1]) continue;
          // Windows next to each other are similar anyway, and coherence proposes them.
          const int ou = other % columns_, ov = other / columns_ % rows_, os = other / columns_ / rows_;
          if (std::abs(ou - u) <= 2 && std::abs(ov - v) <= 2 && std::abs(os - s) <= 2) continue;
          int place = neighbours_ - 1;
          for (; place > 0 && best[place - 1] > d; --place)
            best[place] = best[place - 1], found[place] = found[place - 1];
          best[place] = d, found[place] = other;
        }
      },
      16);
}

}  // namespace shellgrid
