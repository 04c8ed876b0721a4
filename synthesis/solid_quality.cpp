// SPDX-License-Identifier: AGPL-3.0-or-later
#include <algorithm>
#include <cmath>
#include <limits>
#include <map>

#include "meshing/core/error.h"
#include "meshing/core/parallel.h"
#include "meshing/core/random.h"
#include "synthesis/slice_windows.h"
#include "synthesis/solid_synthesis.h"

namespace shellgrid {
namespace {

constexpr int side = 5;
constexpr int most_windows = 20000;

// A window of the exemplar that begins at (u, v) of slice s.
void gather(const SliceStack& stack, int channels, int u, int v, int s, float* entries) {
  for (int row = 0; row < side; ++row) {
    const float* from =
        stack.values.data() + ((static_cast<std::size_t>(s) * stack.height + v + row) * stack.width + u) * channels;
    entries = std::copy(from, from + side * channels, entries);
  }
}

// Twice the variance of the exemplar's windows: the mean squared distance of two drawn at random.
double random_distance(const SliceStack& stack, int channels) {
  double distance = 0;
  for (int c = 0; c < channels; ++c) {
    double sum = 0, squares = 0;
    for (std::size_t i = 0; i < stack.texel_count(); ++i) {
      const double value = stack.values[i * channels + c];
      sum += value, squares += value * value;
    }
    const double n = static_cast<double>(stack.texel_count());
    distance += 2 * side * side * std::max(0.0, squares / n - sum / n * sum / n);
  }
  return distance;
}

// Mean distance between the two sets' quantiles, over the exemplar's deviation.
double quantile_distance(std::vector<float> a, std::vector<float> b) {
  std::sort(a.begin(), a.end());
  std::sort(b.begin(), b.end());
  double sum = 0, mean = 0, square = 0;
  constexpr int steps = 1000;
  for (int i = 0; i < steps; ++i) {
    const auto quantile = [&](const std::vector<float>& values) {
      return values[static_cast<std::size_t>((i + 0.5) / steps * static_cast<double>(values.size()))];
    };
    sum += std::abs(quantile(a) - quantile(b));
    mean += quantile(a) / steps, square += quantile(a) * quantile(a) / steps;
  }
  const double deviation = std::sqrt(std::max(0.0, square - mean * mean));
  return deviation > 0 ? sum / steps / deviation : sum / steps;
}

}  // namespace

std::vector<float> solid_values(const SolidExemplar& exemplar, const SolidTexture& solid) {
  std::vector<float> values(solid.axis.size() * exemplar.channels);
  for (std::size_t i = 0; i < solid.axis.size(); ++i) {
    const float* from =
        exemplar.axes[solid.axis[i]].values.data() + static_cast<std::size_t>(solid.texel[i]) * exemplar.channels;
    std::copy(from, from + exemplar.channels, values.data() + i * exemplar.channels);
  }
  return values;
}

SolidQuality measure_solid(const SolidExemplar& exemplar, const Vec3i& size, const std::vector<float>& values,
                           int count, std::uint64_t seed) {
  const int channels = exemplar.channels;
  if (values.size() != static_cast<std::size_t>(size.prod()) * channels)
    throw InternalError("a solid's values do not fit its size");
  SolidQuality quality;
  for (int d = 0; d < 3; ++d) {
    const SliceStack& stack = exemplar.axes[d];
    const int first_z = d == 2 ? 0 : side / 2, last_z = d == 2 ? size.z() - 1 : size.z() - 1 - side / 2;
    if (last_z < first_z) continue;
    const Vec3i along_u = Vec3i::Unit(column_axis(d)), along_v = Vec3i::Unit(row_axis(d));
    const double scale = random_distance(stack, channels);
    const auto draw = [&](std::uint64_t stream, std::uint64_t i, int least, int most) {
      return least + static_cast<int>(hash64(hash64(seed, stream), d, i) % (most - least + 1));
    };
    const std::size_t entries = static_cast<std::size_t>(side) * side * channels;
    // Windows of the solid, drawn at random; as many as are asked of its own, more to find the exemplar's in.
    const int drawn = static_cast<int>(
        std::min<std::int64_t>(most_windows, std::int64_t{size.x()} * size.y() * (last_z - first_z + 1)));
    std::vector<float> solid(static_cast<std::size_t>(std::max(drawn, count)) * entries);
    parallel_for(solid.size() / entries, [&](std::size_t i) {
      const Vec3i p(draw(1, i, 0, size.x() - 1), draw(2, i, 0, size.y() - 1), draw(3, i, first_z, last_z));
      float* own = solid.data() + i * entries;
      for (int v = -side / 2; v <= side / 2; ++v)
        for (int u = -side / 2; u <= side / 2; ++u) {
          const Vec3i q = p + u * along_u + v * along_v;
          const std::size_t at =
              (static_cast<std::size_t>(q.z()) * size.y() + (q.y() + size.y()) % size.y()) * size.x() +
              (q.x() + size.x()) % size.x();
          own = std::copy_n(values.data() + at * channels, channels, own);
        }
    });
    const int columns = stack.width - side + 1, rows = stack.height - side + 1;
    const auto distance = [&](const float* a, const float* b) {
      float sum = 0;
      for (std::size_t e = 0; e < entries; ++e) sum += (a[e] - b[e]) * (a[e] - b[e]);
      return sum;
    };
    std::vector<double> to_view(count, 0.0), to_solid(count, 0.0);
    parallel_for(
        static_cast<std::size_t>(count),
        [&](std::size_t i) {
          std::vector<float> other(entries);
          float best = std::numeric_limits<float>::infinity();
          for (int s = 0; s < stack.slices; ++s)
            for (int v = 0; v < rows; ++v)
              for (int u = 0; u < columns; ++u) {
                gather(stack, channels, u, v, s, other.data());
                best = std::min(best, distance(solid.data() + i * entries, other.data()));
              }
          to_view[i] = best;
          gather(stack, channels, draw(4, i, 0, columns - 1), draw(5, i, 0, rows - 1), draw(6, i, 0, stack.slices - 1),
                 other.data());
          best = std::numeric_limits<float>::infinity();
          for (std::size_t k = 0; k < solid.size() / entries; ++k)
            best = std::min(best, distance(solid.data() + k * entries, other.data()));
          to_solid[i] = best;
        },
        1);
    const auto mean = [&](const std::vector<double>& distances) {
      double sum = 0;
      for (double one : distances) sum += one;
      return scale > 0 ? sum / count / scale : (sum > 0 ? 1 : 0);
    };
    quality.window_distance[d] = mean(to_view);
    quality.coverage_distance[d] = mean(to_solid);
  }
  for (int c = 0; c < channels; ++c) {
    std::vector<float> wanted, got;
    for (const SliceStack& stack : exemplar.axes)
      for (std::size_t i = 0; i < stack.texel_count(); ++i) wanted.push_back(stack.values[i * channels + c]);
    for (std::size_t i = 0; i < values.size(); i += channels) got.push_back(values[i + c]);
    quality.histogram_distance += quantile_distance(std::move(wanted), std::move(got)) / channels;
  }
  return quality;
}

double texel_entropy(const SolidExemplar& exemplar, const SolidTexture& solid) {
  std::array<std::vector<std::int32_t>, 3> uses;
  double texels = 0;
  for (int d = 0; d < 3; ++d) {
    uses[d].assign(exemplar.axes[d].texel_count(), 0);
    texels += static_cast<double>(exemplar.axes[d].texel_count());
  }
  for (std::size_t i = 0; i < solid.axis.size(); ++i) ++uses[solid.axis[i]][solid.texel[i]];
  double entropy = 0;
  const double total = static_cast<double>(solid.axis.size());
  for (const std::vector<std::int32_t>& axis : uses)
    for (std::int32_t count : axis)
      if (count > 0) entropy -= count / total * std::log(count / total);
  return texels > 1 && total > 1 ? entropy / std::log(std::min(texels, total)) : 1;
}

}  // namespace shellgrid
