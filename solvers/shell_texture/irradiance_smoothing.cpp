// SPDX-License-Identifier: AGPL-3.0-or-later
#include "solvers/shell_texture/irradiance_smoothing.h"

#include <algorithm>
#include <cmath>
#include <numbers>

#include "meshing/core/parallel.h"

namespace shellgrid {
namespace {

constexpr int level_steps[] = {1, 1, 2};   // voxels, along the texture; through the layers always 1
constexpr int gain_reach = 3;              // voxels to each side over which halves are compared
constexpr int pilot_reach = 1;             // over which what is kept of both tells what to keep
constexpr int error_reach = 2;             // over which errors are averaged
constexpr float whole_voxel = 0.75f;       // of a voxel's share of matter
constexpr double magnitude_floor = 1e-12;  // of the mean over all

// Sums over voxels, along one axis after the other.
class Lattice {
 public:
  explicit Lattice(const Vec3i& size) : nx_(size.x()), ny_(size.y()), nz_(size.z()) {
    voxels = static_cast<std::size_t>(nx_) * ny_ * nz_;
  }
  std::size_t voxels;

  // [1 2 1] along each axis, `step` voxels apart along the texture. Beyond top and bottom there is nothing.
  void blur(std::vector<float>& values, std::vector<float>& other, int step) const {
    const int right = step % nx_, left = (nx_ - right) % nx_;
    for (std::size_t row = 0; row < voxels; row += nx_) {
      const float* from = values.data() + row;
      float* to = other.data() + row;
      for (int x = 0; x < nx_; ++x) {
        const int after = x + right < nx_ ? x + right : x + right - nx_;
        const int before = x + left < nx_ ? x + left : x + left - nx_;
        to[x] = from[before] + 2 * from[x] + from[after];
      }
    }
    for (int z = 0; z < nz_; ++z)
      for (int y = 0; y < ny_; ++y) {
        const float *at = line(other, y, z), *before = line(other, wrapped(y - step), z),
                    *after = line(other, wrapped(y + step), z);
        float* to = line(values, y, z);
        for (int x = 0; x < nx_; ++x) to[x] = before[x] + 2 * at[x] + after[x];
      }
    other = values;
    for (int z = 0; z < nz_; ++z)
      for (int y = 0; y < ny_; ++y) {
        float* to = line(values, y, z);
        for (int x = 0; x < nx_; ++x) to[x] *= 2;
        for (const int beside : {z - 1, z + 1}) {
          if (beside < 0 || beside >= nz_) continue;
          const float* from = line(other, y, beside);
          for (int x = 0; x < nx_; ++x) to[x] += from[x];
        }
      }
  }

  // Sums over boxes: `reach` voxels to each side along the texture, never one voxel twice, and the layers beside.
  void box(std::vector<float>& values, std::vector<float>& other, int reach) const {
    const int across = std::min(reach, (nx_ - 1) / 2), along = std::min(reach, (ny_ - 1) / 2);
    for (std::size_t row = 0; row < voxels; row += nx_) {
      const float* from = values.data() + row;
      float* to = other.data() + row;
      for (int x = 0; x < nx_; ++x) to[x] = from[x];
      for (int d = 1; d <= across; ++d) {
        for (int x = d; x < nx_; ++x) to[x] += from[x - d];
        for (int x = 0; x < d; ++x) to[x] += from[x - d + nx_];
        for (int x = 0; x + d < nx_; ++x) to[x] += from[x + d];
        for (int x = nx_ - d; x < nx_; ++x) to[x] += from[x + d - nx_];
      }
    }
    for (int z = 0; z < nz_; ++z)
      for (int y = 0; y < ny_; ++y) {
        float* to = line(values, y, z);
        std::copy_n(line(other, y, z), nx_, to);
        for (int d = 1; d <= along; ++d) {
          const float *before = line(other, wrapped(y - d), z), *after = line(other, wrapped(y + d), z);
          for (int x = 0; x < nx_; ++x) to[x] += before[x] + after[x];
        }
      }
    other = values;
    for (int z = 0; z < nz_; ++z)
      for (const int beside : {z - 1, z + 1}) {
        if (beside < 0 || beside >= nz_) continue;
        const float* from = line(other, 0, beside);
        float* to = line(values, 0, z);
        for (int k = 0; k < nx_ * ny_; ++k) to[k] += from[k];
      }
  }

 private:
  int wrapped(int y) const { return ((y % ny_) + ny_) % ny_; }
  float* line(std::vector<float>& v, int y, int z) const {
    return v.data() + (static_cast<std::size_t>(z) * ny_ + y) * nx_;
  }
  const float* line(const std::vector<float>& v, int y, int z) const {
    return v.data() + (static_cast<std::size_t>(z) * ny_ + y) * nx_;
  }
  int nx_, ny_, nz_;
};

// Waves around a ring and sums and differences of channels, orthonormal.
struct Waves {
  int turns;
  std::vector<float> around;  // turns × turns: mean; cosine, sine of each wave; where turns is even the fastest
  float channels[3][3];

  explicit Waves(int count) : turns(count), around(static_cast<std::size_t>(count) * count) {
    for (int w = 0; w < turns; ++w) {
      double square = 0;
      const int wave = (w + 1) / 2;
      const bool sine = w > 0 && w % 2 == 0;
      std::vector<double> row(turns);
      for (int t = 0; t < turns; ++t) {
        const double angle = 2 * std::numbers::pi * wave * t / turns;
        row[t] = sine ? std::sin(angle) : std::cos(angle);
        square += row[t] * row[t];
      }
      for (int t = 0; t < turns; ++t) around[w * turns + t] = static_cast<float>(row[t] / std::sqrt(square));
    }
    const double mix[3][3] = {{1, 1, 1}, {1, 0, -1}, {1, -2, 1}};
    for (int m = 0; m < 3; ++m)
      for (int c = 0; c < 3; ++c)
        channels[m][c] = static_cast<float>(mix[m][c] / std::sqrt(m == 0 ? 3.0 : m == 1 ? 2.0 : 6.0));
  }
};

class Smoothing {
 public:
  Smoothing(const FunctionGrid& grid, const std::vector<float>& first, const std::vector<float>& second, float share)
      : grid_(grid),
        lattice_(grid.size),
        waves_(grid.turns),
        directions_(grid.rings * grid.turns),
        width_(3 * static_cast<std::size_t>(directions_)),
        share_(share),
        between_(share * (1 - share)),
        given_{&first, &second} {
    for (const float w : grid.weight) has_cut_ = has_cut_ || (w > 0 && w < whole_voxel);
    std::vector<float> about = grid.weight;
    nearby_ = grid.weight;
    sum_about(nearby_, pilot_reach);
    sum_about(about, gain_reach);
    for (std::size_t v = 0; v < about.size(); ++v) nearby_[v] = about[v] > 0 ? nearby_[v] / about[v] : 0;
    for (const int step : level_steps) {
      std::vector<float> all = grid.weight, other(lattice_.voxels);
      lattice_.blur(all, other, step);
      for (float& w : all) w = w > 0 ? 1 / w : 0;
      inverse_.push_back(std::move(all));
    }
  }

  SmoothedFunction result() {
    for (int h = 0; h < 2; ++h) {
      find_magnitude(h);
      take_apart(h);
    }
    // Cosine and sine of a wave share their gains.
    const int waves = grid_.turns / 2 + 1;
    parallel_for(
        static_cast<std::size_t>(3) * grid_.rings * waves,
        [&](std::size_t k) {
          const auto wave = static_cast<int>(k % waves);
          const std::size_t first = k / waves * grid_.turns + (wave == 0 ? 0 : 2 * wave - 1);
          shrink(first, wave == 0 || 2 * wave == grid_.turns ? 1 : 2);
        },
        1);
    for (int h = 0; h < 2; ++h) {
      put_together(h);
      keep_means(h);
    }
    SmoothedFunction f;
    find_error(f);
    f.value = std::move(smooth_[0]);
    for (std::size_t k = 0; k < f.value.size(); ++k) f.value[k] = share_ * f.value[k] + (1 - share_) * smooth_[1][k];
    return f;
  }

 private:
  // Of the values of all directions, by voxel and channel: smooth, above 0, and of the half alone.
  void find_magnitude(int h) {
    std::vector<float>& to = magnitude_[h];
    to.resize(3 * lattice_.voxels);
    std::vector<float> one(lattice_.voxels), other(lattice_.voxels);
    for (int c = 0; c < 3; ++c) {
      double all = 0;
      for (std::size_t v = 0; v < lattice_.voxels; ++v) {
        const float* values = given_[h]->data() + (3 * v + c) * directions_;
        float sum = 0;
        for (int l = 0; l < directions_; ++l) sum += std::abs(values[l]);
        one[v] = grid_.weight[v] * sum / static_cast<float>(directions_);
        all += static_cast<double>(one[v]) / static_cast<double>(lattice_.voxels);
      }
      lattice_.blur(one, other, 1);
      const auto least = static_cast<float>(std::max(1e-30, magnitude_floor * all));
      for (std::size_t v = 0; v < lattice_.voxels; ++v) to[3 * v + c] = std::max(one[v] * inverse_.front()[v], least);
    }
  }

  // Into waves: components × voxels, of the channels' mean first.
  void take_apart(int h) {
    std::vector<float>& to = parts_[h];
    to.resize(lattice_.voxels * width_);
    parallel_for(lattice_.voxels, [&](std::size_t v) {
      for (int ring = 0; ring < grid_.rings; ++ring)
        for (int w = 0; w < grid_.turns; ++w) {
          float wave[3];
          for (int c = 0; c < 3; ++c) {
            const float* values = given_[h]->data() + (3 * v + c) * directions_ + ring * grid_.turns;
            const float* row = waves_.around.data() + w * grid_.turns;
            wave[c] = 0;
            for (int t = 0; t < grid_.turns; ++t) wave[c] += row[t] * values[t];
            wave[c] /= magnitude_[h][3 * v + c];
          }
          for (int m = 0; m < 3; ++m)
            to[component(m, ring, w) * lattice_.voxels + v] =
                grid_.weight[v] > 0 ? waves_.channels[m][0] * wave[0] + waves_.channels[m][1] * wave[1] +
                                          waves_.channels[m][2] * wave[2]
                                    : 0.0f;
        }
    });
  }

  void put_together(int h) {
    std::vector<float>& to = smooth_[h];
    to.resize(lattice_.voxels * width_);
    parallel_for(lattice_.voxels, [&](std::size_t v) {
      std::vector<float> wave(grid_.turns);
      if (!(grid_.weight[v] > 0)) {
        std::fill_n(to.data() + width_ * v, width_, 0.0f);
        return;
      }
      for (int c = 0; c < 3; ++c)
        for (int ring = 0; ring < grid_.rings; ++ring) {
          float* values = to.data() + (3 * v + c) * directions_ + ring * grid_.turns;
          std::fill_n(values, grid_.turns, 0.0f);
          for (int w = 0; w < grid_.turns; ++w) {
            float sum = 0;
            for (int m = 0; m < 3; ++m)
              sum += waves_.channels[m][c] * parts_[h][component(m, ring, w) * lattice_.voxels + v];
            sum *= magnitude_[h][3 * v + c];
            const float* row = waves_.around.data() + w * grid_.turns;
            for (int t = 0; t < grid_.turns; ++t) values[t] += sum * row[t];
          }
        }
    });
  }

  // Gives each layer, channel and direction the mean that it had, in parts that go with the magnitude.
  void keep_means(int h) {
    const std::size_t layer = static_cast<std::size_t>(grid_.size.x()) * grid_.size.y();
    std::vector<float>& values = smooth_[h];
    const std::vector<float>& given = *given_[h];
    parallel_for(
        static_cast<std::size_t>(grid_.size.z()),
        [&](std::size_t z) {
          std::vector<double> missing(width_, 0.0);
          double magnitudes[3] = {};
          for (std::size_t v = layer * z; v < layer * (z + 1); ++v) {
            const auto weight = static_cast<double>(grid_.weight[v]);
            if (!(weight > 0)) continue;
            for (std::size_t k = 0; k < width_; ++k)
              missing[k] += weight * static_cast<double>(given[width_ * v + k] - values[width_ * v + k]);
            for (int c = 0; c < 3; ++c) magnitudes[c] += weight * static_cast<double>(magnitude_[h][3 * v + c]);
          }
          for (std::size_t v = layer * z; v < layer * (z + 1); ++v)
            for (std::size_t k = 0; k < width_ && grid_.weight[v] > 0; ++k) {
              const std::size_t c = k / directions_;
              values[width_ * v + k] +=
                  static_cast<float>(missing[k] / magnitudes[c] * static_cast<double>(magnitude_[h][3 * v + c]));
            }
        },
        1);
  }

  std::size_t component(int m, int ring, int w) const {
    return (static_cast<std::size_t>(m) * grid_.rings + ring) * grid_.turns + w;
  }

  // Details of `count` components, with common gains, in both halves.
  void shrink(std::size_t first, int count) {
    const std::size_t n = lattice_.voxels;
    struct Field {
      std::vector<float> rest, smoother, kept;
    };
    std::vector<Field> fields(2 * count);  // half by half
    std::vector<float> signal(n), noise(n), pilot(n), other(n);
    for (int k = 0; k < 2 * count; ++k) {
      const float* from = parts_[k / count].data() + (first + k % count) * n;
      fields[k].rest.assign(from, from + n);
      fields[k].kept.assign(n, 0.0f);
      set_means_apart(fields[k].rest, fields[k].kept);
    }
    for (std::size_t level = 0; level < std::size(level_steps); ++level) {
      for (Field& f : fields) {
        f.smoother.resize(n);
        for (std::size_t v = 0; v < n; ++v) f.smoother[v] = f.rest[v] * grid_.weight[v];
        lattice_.blur(f.smoother, other, level_steps[level]);
        for (std::size_t v = 0; v < n; ++v) f.smoother[v] *= inverse_[level][v];
      }
      std::fill(signal.begin(), signal.end(), 0.0f);
      std::fill(noise.begin(), noise.end(), 0.0f);
      for (int k = 0; k < count; ++k)
        for (std::size_t v = 0; v < n; ++v) {
          const Field &a = fields[k], &b = fields[count + k];
          const float x = a.rest[v] - a.smoother[v], y = b.rest[v] - b.smoother[v];
          signal[v] += grid_.weight[v] * x * y;
          noise[v] += grid_.weight[v] * between_ * (x - y) * (x - y);
        }
      sum_about(signal, gain_reach);
      sum_about(noise, gain_reach);
      for (std::size_t v = 0; v < n; ++v)
        signal[v] = signal[v] > 0 ? signal[v] / (signal[v] + std::max(noise[v], 0.0f)) : 0.0f;
      // What is kept so far tells of a smaller place how strong a detail is there.
      std::fill(pilot.begin(), pilot.end(), 0.0f);
      for (int k = 0; k < count; ++k)
        for (std::size_t v = 0; v < n; ++v) {
          const Field &a = fields[k], &b = fields[count + k];
          const float kept =
              signal[v] * (share_ * (a.rest[v] - a.smoother[v]) + (1 - share_) * (b.rest[v] - b.smoother[v]));
          pilot[v] += grid_.weight[v] * kept * kept;
        }
      sum_about(pilot, pilot_reach);
      for (std::size_t v = 0; v < n; ++v) {
        const float noise_nearby = std::max(noise[v], 0.0f) * nearby_[v];
        signal[v] = pilot[v] > 0 ? pilot[v] / (pilot[v] + noise_nearby) : 0.0f;
      }
      for (Field& f : fields)
        for (std::size_t v = 0; v < n; ++v) {
          f.kept[v] += signal[v] * (f.rest[v] - f.smoother[v]);
          f.rest[v] = f.smoother[v];
        }
    }
    for (int k = 0; k < 2 * count; ++k) {
      float* to = parts_[k / count].data() + (first + k % count) * n;
      for (std::size_t v = 0; v < n; ++v) to[v] = fields[k].kept[v] + fields[k].rest[v];
    }
  }

  // Sums about each voxel, over those of its kind alone: whole ones, or ones that the surface cuts.
  void sum_about(std::vector<float>& values, int reach) const {
    std::vector<float> other(values.size());
    if (!has_cut_) return lattice_.box(values, other, reach);
    std::vector<float> cut(values.size(), 0.0f);
    for (std::size_t v = 0; v < values.size(); ++v)
      if (grid_.weight[v] < whole_voxel) std::swap(cut[v], values[v]);
    lattice_.box(values, other, reach);
    lattice_.box(cut, other, reach);
    for (std::size_t v = 0; v < values.size(); ++v)
      if (grid_.weight[v] < whole_voxel) values[v] = cut[v];
  }

  // Each layer's mean goes to `kept`, so that it stays what it is however steeply values fall from layer to layer.
  void set_means_apart(std::vector<float>& values, std::vector<float>& kept) const {
    const std::size_t layer = static_cast<std::size_t>(grid_.size.x()) * grid_.size.y();
    for (std::size_t begin = 0; begin < values.size(); begin += layer) {
      double sum = 0, weights = 0;
      for (std::size_t v = begin; v < begin + layer; ++v) {
        sum += static_cast<double>(grid_.weight[v] * values[v]);
        weights += static_cast<double>(grid_.weight[v]);
      }
      const auto mean = static_cast<float>(weights > 0 ? sum / weights : 0);
      for (std::size_t v = begin; v < begin + layer; ++v) {
        kept[v] += mean;
        values[v] -= mean;
      }
    }
  }

  void find_error(SmoothedFunction& f) const {
    const std::size_t n = lattice_.voxels;
    f.error.resize(n * directions_);
    parallel_for(
        static_cast<std::size_t>(grid_.rings),
        [&](std::size_t ring) {
          std::vector<float> whole(n, 0.0f), left(n, 0.0f), square(n, 0.0f), mean(n * grid_.turns);
          for (std::size_t v = 0; v < n; ++v)
            for (int t = 0; t < grid_.turns; ++t) {
              const auto of = [&](const std::vector<float>& values) {
                const float* at = values.data() + 3 * v * directions_ + ring * grid_.turns + t;
                return (at[0] + at[directions_] + at[2 * directions_]) / 3;
              };
              const float y1 = of(*given_[0]), y2 = of(*given_[1]), f1 = of(smooth_[0]), f2 = of(smooth_[1]);
              const float w = grid_.weight[v], noise = between_ * (f1 - f2) * (f1 - f2),
                          value = share_ * f1 + (1 - share_) * f2;
              whole[v] += w * ((f1 - y2) * (f2 - y1) + (f1 - f2) * (y1 - y2) + noise);
              left[v] += w * noise;
              square[v] += w * value * value;
              mean[v * grid_.turns + t] = value;
            }
          for (std::vector<float>* sum : {&whole, &left, &square}) sum_about(*sum, error_reach);
          for (std::size_t v = 0; v < n; ++v) {
            const float ratio = square[v] > 0 ? std::sqrt(std::max({whole[v], left[v], 0.0f}) / square[v]) : 0.0f;
            for (int t = 0; t < grid_.turns; ++t)
              f.error[v * directions_ + ring * grid_.turns + t] = ratio * std::abs(mean[v * grid_.turns + t]);
          }
        },
        1);
  }

  const FunctionGrid& grid_;
  Lattice lattice_;
  Waves waves_;
  int directions_;
  std::size_t width_;
  bool has_cut_ = false;
  std::vector<float> nearby_;  // the weights that a pilot is summed over, of those that halves are compared over
  float share_, between_;      // the first half's; of the halves' squared difference, the variance of their mean
  const std::vector<float>* given_[2];
  std::vector<std::vector<float>> inverse_;  // by level: 1 / the blurred weights
  std::vector<float> magnitude_[2], parts_[2], smooth_[2];
};

}  // namespace

SmoothedFunction smooth_function(const FunctionGrid& grid, const std::vector<float>& first,
                                 const std::vector<float>& second, float first_share) {
  return Smoothing(grid, first, second, first_share).result();
}

}  // namespace shellgrid
