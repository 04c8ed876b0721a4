// SPDX-License-Identifier: AGPL-3.0-or-later
#include "solvers/shell_texture/irradiance_tracing.h"

#include <algorithm>
#include <chrono>
#include <cmath>
#include <memory>

#include "meshing/core/error.h"
#include "meshing/core/parallel.h"
#include "solvers/shell_texture/beam_field.h"
#include "solvers/shell_texture/direction_paths.h"
#include "solvers/shell_texture/irradiance_smoothing.h"
#include "solvers/shell_texture/shared_walks.h"

namespace shellgrid {
namespace {

constexpr std::uint64_t least_batches = 8;  // to tell their spread
constexpr std::uint64_t most_walks_a_batch = 8192;
constexpr std::uint64_t upper_batches_a_back_batch = 3;
constexpr double checkpoint_seconds = 60;
constexpr double most_smoothed = 6;  // times less is the error that values have smoothed, at most
// Where values are smoothed, of their error that of layers' means at most: it does not average out over a surface.
constexpr double most_of_layers = 1.0 / 3;
constexpr long progress_steps = 1000;

void check(const BaseVolume& volume, const IrradianceOptions& options) {
  if (options.directions.rings < 1 || options.directions.turns < 1 || options.directions.count() > 10000)
    throw InputError("irradiance: 1 … 10000 directions");
  if (!(options.paths > 0) || !(options.most_paths >= options.paths))
    throw InputError("irradiance: the number of paths must be above 0 and no more than the most");
  if (options.march_rays < 1) throw InputError("irradiance: at least one ray a texel");
  if (static_cast<double>(volume.voxel_count()) * options.directions.count() > 2e8)
    throw InputError("irradiance: more than 2e8 voxels times directions");
}

bool is_smoothed(const IrradianceOptions& options) {
  return options.smooth && options.estimator == IrradianceEstimator::shared_walks;
}

// How many batches of how many paths.
struct Plan {
  std::uint64_t batch_paths, least, most;

  Plan(const BaseVolume& volume, const IrradianceOptions& options) {
    const double texels = static_cast<double>(volume.size.x()) * volume.size.y();
    const double share = std::ceil(options.paths * texels / static_cast<double>(least_batches));
    batch_paths = static_cast<std::uint64_t>(std::clamp(share, 1.0, 1e12));
    if (options.estimator == IrradianceEstimator::shared_walks) batch_paths = std::min(batch_paths, most_walks_a_batch);
    const auto batches = [&](double paths) {
      return static_cast<std::uint64_t>(std::ceil(paths * texels / static_cast<double>(batch_paths) - 1e-9));
    };
    least = std::max(least_batches, batches(options.paths));
    most = std::max(least, batches(options.most_paths));
  }

  // After how many batches the error is looked at again where it is `missed` times what it should be. Whatever it
  // should be, those numbers are of one row that grows by a sixteenth: what is gone on with ends as if never stopped.
  std::uint64_t judged_after(std::uint64_t batches, double missed) const {
    // Errors fall with the root of the number of batches; smoothed ones less fast.
    const double soonest = static_cast<double>(batches) * std::min(2.0, 0.9 * missed * missed);
    std::uint64_t at = least;
    while (at <= batches || static_cast<double>(at) < soonest) at += std::max<std::uint64_t>(1, at / 16);
    return at;
  }
};

// Relative standard error of a mean of `batches` values; −1 where nothing came.
float standard_error(double sum, double square, double more, double batches) {
  const double mean = sum / batches, whole = mean + more;
  if (!(whole > 0) || batches < 2) return -1;
  const double variance = std::max(0.0, square / batches - mean * mean) / (batches - 1);
  return static_cast<float>(std::sqrt(variance) / whole);
}

// Where some have light, those without are unknown wholly.
double median_of(std::vector<float>& errors) {
  bool any = false;
  for (float& e : errors) {
    any = any || e >= 0;
    if (e < 0) e = 1;
  }
  if (!any) return 0;
  const auto middle = errors.begin() + static_cast<std::ptrdiff_t>(errors.size() / 2);
  std::nth_element(errors.begin(), middle, errors.end());
  return static_cast<double>(*middle);
}

class Tracing {
 public:
  Tracing(const BaseVolume& volume, const IrradianceOptions& options, IrradianceSums& sums, Progress& progress)
      : volume_(volume), options_(options), sums_(sums), slab_(volume), walk_(slab_), plan_(volume, options) {
    n_ = options.directions.count();
    const bool sphere = options.estimator == IrradianceEstimator::sphere;
    const bool shared = options.estimator == IrradianceEstimator::shared_walks;
    if (!sphere)
      field_ = march_beams(walk_, {options.directions, options.march_rays, options.march_error, options.seed, shared},
                           progress);
    if (shared)
      batches_ = shared_walks(walk_, field_, options.directions, plan_.batch_paths, options.seed);
    else
      batches_ = direction_paths(walk_, volume, options.directions, sphere, plan_.batch_paths, options.seed);
  }

  void follow(IrradianceReport& report, Progress& progress) {
    using Clock = std::chrono::steady_clock;
    auto saved = Clock::now();
    progress.begin("follow light", progress_steps);
    long shown = 0;
    bool upper_done = is_done(report.median_error);
    while (!upper_done || back_due()) {
      if (options_.interrupted && options_.interrupted()) {
        report.interrupted = true;
        break;
      }
      if (!upper_done) {
        batches_->add_upper(sums_);
        upper_done = is_done(report.median_error);
      }
      if (back_due()) batches_->add_back(sums_);
      const auto done = static_cast<double>(sums_.upper_batches);
      double share = done / static_cast<double>(options_.target_error > 0 ? plan_.most : plan_.least);
      if (options_.target_error > 0 && report.median_error > 0)
        share = std::max(share, std::pow(options_.target_error / report.median_error, 2));
      const long now = std::min(progress_steps, static_cast<long>(share * progress_steps));
      if (now > shown) progress.advance(now - shown), shown = now;
      if (options_.checkpoint && std::chrono::duration<double>(Clock::now() - saved).count() > checkpoint_seconds) {
        options_.checkpoint(sums_);
        saved = Clock::now();
      }
    }
    progress.end();
    if (sums_.upper_batches == 0 || sums_.back_batches == 0)
      throw InputError("stopped before the first paths had ended; there is no result");
    smooth_upper();
    smooth_back();
    report.median_error = median_error(true);
    report.back_error = median_error(false);
    report.paths = static_cast<double>(sums_.upper_batches * plan_.batch_paths);
    report.back_paths = static_cast<double>(sums_.back_batches * plan_.batch_paths);
    report.march_rays = field_.rays_a_texel;
    balance(report);
  }

  ShellTexture texture() const {
    const std::size_t voxels = volume_.voxel_count();
    ShellTexture t;
    t.size = volume_.size;
    t.voxel = volume_.voxel;
    t.directions = options_.directions;
    t.matter = slab_.share();
    t.single.assign(n_ * voxels, Vec3f::Zero());
    t.multiple.assign((n_ + 1) * voxels, Vec3f::Zero());
    t.error.assign((n_ + 1) * voxels, -1.0f);
    const std::size_t texels = t.texel_count();
    t.below.assign((n_ + 1) * texels, Vec3f::Zero());
    const bool marched = !field_.single.empty();
    const auto per_batch = static_cast<float>(1 / static_cast<double>(sums_.upper_batches));
    parallel_for(
        static_cast<std::size_t>(n_) + 1,
        [&](std::size_t l) {
          const bool back = l == static_cast<std::size_t>(n_);
          for (std::size_t v = 0; v < voxels; ++v) {
            const std::size_t at = l * voxels + v;
            t.error[at] = error_of(v, static_cast<int>(l));
            const float scale = scale_of(v);
            Vec3f value;
            for (int c = 0; c < 3; ++c) value[c] = (back ? 0.5f : 1.0f) * mean_of(v, c, static_cast<int>(l));
            if (!back && marched) {
              if (with_beams()) value += field_.mirrored[at];
              t.single[at] = scale * field_.single[at];
            } else if (!back) {
              for (int c = 0; c < 3; ++c) t.single[at][c] = scale * per_batch * sums_.single[(3 * v + c) * n_ + l];
            }
            // Directions that walks are borrowed from may count below zero.
            t.multiple[at] = (scale * value).cwiseMax(0.0f);
          }
          const auto texel_area = static_cast<float>(volume_.voxel * volume_.voxel);
          for (std::size_t k = 0; k < texels; ++k) {
            const std::size_t r = voxels + k;
            Vec3f power;
            for (int c = 0; c < 3; ++c) power[c] = mean_of(r, c, static_cast<int>(l));
            if (!back && with_beams()) power += field_.below[l * texels + k];
            t.below[l * texels + k] = (power / texel_area).cwiseMax(0.0f);
          }
        },
        1);
    return t;
  }

 private:
  // Whether the paths do not tell of beams that leave without a collision.
  bool with_beams() const { return options_.estimator == IrradianceEstimator::shared_walks; }

  // Light from below is one direction of many: where the others share walks it has a part of their number of its own.
  bool back_due() const {
    return sums_.back_batches * (with_beams() ? upper_batches_a_back_batch : 1) < sums_.upper_batches;
  }

  bool is_done(double& error) {
    const std::uint64_t batches = sums_.upper_batches;
    if (batches >= plan_.least && !(options_.target_error > 0)) return true;
    if (batches < std::min(std::max(plan_.least, sums_.next_judged), plan_.most)) return false;
    error = median_error(true);
    double missed = error / options_.target_error;  // how many times the error is what it should be
    if (is_smoothed(options_)) {
      missed = std::max(missed / most_smoothed, layer_error() / (most_of_layers * options_.target_error));
      if (missed <= 1) {
        smooth_upper();
        error = median_error(true);
        missed = error / options_.target_error;
      }
    }
    if (missed <= 1 || batches >= plan_.most) return true;
    sums_.next_judged = plan_.judged_after(batches, missed);
    return false;
  }

  // Relative standard error of a layer's sum over voxels, channels and directions, root mean square.
  double layer_error() const {
    const std::size_t texels = volume_.texel_count(), layers = sums_.layer_square.size();
    std::vector<double> squares(layers, 0.0);
    parallel_for(
        layers,
        [&](std::size_t z) {
          double sum = 0;
          for (std::size_t k = 3 * n_ * texels * z; k < 3 * n_ * texels * (z + 1); ++k)
            sum += static_cast<double>(sums_.upper[k]);
          const auto error = static_cast<double>(
              standard_error(sum, sums_.layer_square[z], 0, static_cast<double>(sums_.upper_batches)));
          squares[z] = error > 0 ? error * error : 0;
        },
        1);
    double sum = 0;
    for (const double square : squares) sum += square;
    return std::sqrt(sum / static_cast<double>(layers));
  }

  float scale_of(std::size_t v) const {
    const double cell = std::pow(volume_.voxel, 3);
    const bool sphere = options_.estimator == IrradianceEstimator::sphere;
    if (sphere) return static_cast<float>(volume_.free[v] ? 0 : 1 / (4.0 / 3 * std::numbers::pi * cell));
    return slab_.share()[v] > least_matter ? static_cast<float>(1 / (cell * static_cast<double>(slab_.share()[v]))) : 0;
  }

  // What batches brought to a receiver, on average.
  float mean_of(std::size_t r, int c, int l) const {
    if (l == n_) {
      if (smooth_back_.batches == sums_.back_batches && r < smooth_back_.receivers)
        return smooth_back_.value[3 * r + c];
      return sums_.back[3 * r + c] / static_cast<float>(sums_.back_batches);
    }
    const std::size_t at = (3 * r + c) * n_ + l;
    if (smooth_upper_.batches == sums_.upper_batches && r < smooth_upper_.receivers) return smooth_upper_.value[at];
    return sums_.upper[at] / static_cast<float>(sums_.upper_batches);
  }

  // What halves of the batches agree on, of voxels and the bottom's texels.
  struct Smoothed {
    std::uint64_t batches = 0;  // it was made of
    std::size_t receivers = 0;
    std::vector<float> value, error;  // as the sums
  };
  void smooth_upper() {
    if (!is_smoothed(options_) || sums_.upper_batches < 2 || smooth_upper_.batches == sums_.upper_batches) return;
    smooth_upper_ = smoothed(sums_.upper, sums_.upper_half, sums_.upper_batches, options_.directions.rings,
                             options_.directions.turns);
  }
  void smooth_back() {
    if (!is_smoothed(options_) || sums_.back_batches < 2) return;
    smooth_back_ = smoothed(sums_.back, sums_.back_half, sums_.back_batches, 1, 1);
  }
  Smoothed smoothed(const std::vector<float>& all, const std::vector<float>& half, std::uint64_t batches, int rings,
                    int turns) const {
    const std::size_t voxels = volume_.voxel_count(), texels = volume_.texel_count(),
                      directions = static_cast<std::size_t>(rings) * turns;
    Smoothed result{batches, voxels + texels, std::vector<float>(3 * (voxels + texels) * directions),
                    std::vector<float>(voxels * directions)};
    const auto second_count = static_cast<float>(batches / 2), first_count = static_cast<float>(batches) - second_count;
    const auto take = [&](const Vec3i& size, std::size_t begin, const auto& scale) {
      FunctionGrid grid{size, rings, turns, {}};
      const std::size_t count = static_cast<std::size_t>(size.x()) * size.y() * size.z();
      grid.weight.resize(count);
      std::vector<float> first(3 * count * directions), second(first.size());
      parallel_for(count, [&](std::size_t k) {
        const float by = scale(k);
        grid.weight[k] = by > 0 ? begin == 0 ? slab_.share()[k] : 1.0f : 0.0f;
        for (std::size_t i = 3 * k * directions; i < 3 * (k + 1) * directions; ++i) {
          const std::size_t at = 3 * begin * directions + i;
          first[i] = by * (all[at] - half[at]) / first_count;
          second[i] = by * half[at] / second_count;
        }
      });
      const SmoothedFunction f = smooth_function(grid, first, second, first_count / static_cast<float>(batches));
      for (std::size_t k = 0; k < count; ++k) {
        const float by = scale(k), back = by > 0 ? 1 / by : 0;
        for (std::size_t i = 3 * k * directions; i < 3 * (k + 1) * directions; ++i)
          result.value[3 * begin * directions + i] = back * f.value[i];
        if (begin > 0) continue;
        for (std::size_t i = k * directions; i < (k + 1) * directions; ++i) result.error[i] = back * f.error[i];
      }
    };
    take(volume_.size, 0, [&](std::size_t v) { return scale_of(v); });
    take({volume_.size.x(), volume_.size.y(), 1}, voxels, [](std::size_t) { return 1.0f; });
    return result;
  }

  // −1 where nothing came.
  static float relative_error(float error, double sum, double more) {
    return sum + more > 0 ? static_cast<float>(static_cast<double>(error) / (sum + more)) : -1;
  }

  float error_of(std::size_t v, int l) const {
    if (l == n_ ? smooth_back_.batches == sums_.back_batches : smooth_upper_.batches == sums_.upper_batches) {
      const double mean = static_cast<double>(mean_of(v, 0, l) + mean_of(v, 1, l) + mean_of(v, 2, l)) / 3;
      if (l == n_) return relative_error(smooth_back_.error[v], mean, 0);
      return relative_error(smooth_upper_.error[v * n_ + l], mean, mirrored(v, l));
    }
    if (l == n_) {
      const double sum = static_cast<double>(sums_.back[3 * v] + sums_.back[3 * v + 1] + sums_.back[3 * v + 2]) / 3;
      return standard_error(sum, static_cast<double>(sums_.back_square[v]), 0, static_cast<double>(sums_.back_batches));
    }
    double sum = 0;
    for (int c = 0; c < 3; ++c) sum += static_cast<double>(sums_.upper[(3 * v + c) * n_ + l]) / 3;
    return standard_error(sum, static_cast<double>(sums_.upper_square[v * n_ + l]), mirrored(v, l),
                          static_cast<double>(sums_.upper_batches));
  }

  double mirrored(std::size_t v, int l) const {
    const std::size_t at = static_cast<std::size_t>(l) * volume_.voxel_count() + v;
    return with_beams() ? static_cast<double>(field_.mirrored[at].mean()) : 0;
  }

  double median_error(bool upper) const {
    const std::uint64_t batches = upper ? sums_.upper_batches : sums_.back_batches;
    if (batches < 2) return -1;
    std::vector<std::size_t> filled;
    for (std::size_t v = 0; v < slab_.share().size(); ++v)
      if (slab_.share()[v] > 0.5f) filled.push_back(v);
    const std::size_t count = upper ? static_cast<std::size_t>(n_) : 1;
    std::vector<float> errors(filled.size() * count);
    parallel_for(filled.size(), [&](std::size_t k) {
      for (std::size_t l = 0; l < count; ++l)
        errors[k * count + l] = error_of(filled[k], upper ? static_cast<int>(l) : n_);
    });
    return errors.empty() ? 0 : median_of(errors);
  }

  void balance(IrradianceReport& report) const {
    const double area = slab_.width(0) * slab_.width(1);
    const std::size_t voxels = volume_.voxel_count(), texels = volume_.texel_count();
    report.balance.assign(static_cast<std::size_t>(n_) + 1, {});
    for (int l = 0; l <= n_; ++l) {
      const bool back = l == n_;
      const double power = back ? area : area * options_.directions.direction(l).z();
      const double batches = static_cast<double>(back ? sums_.back_batches : sums_.upper_batches);
      const auto gathered = [&](std::size_t r, int c) {
        return static_cast<double>(back ? sums_.back[3 * r + c] : sums_.upper[(3 * r + c) * n_ + l]) / batches;
      };
      DirectionBalance& b = report.balance[l];
      for (int c = 0; c < 3; ++c) {
        b.left_above += gathered(voxels + texels, c) / 3;
        for (std::size_t k = 0; k < texels; ++k) b.left_below += gathered(voxels + k, c) / 3;
      }
      if (!back && with_beams()) {
        b.left_above += static_cast<double>(field_.above[l].mean());
        for (std::size_t k = 0; k < texels; ++k)
          b.left_below += static_cast<double>(field_.below[l * texels + k].mean());
      }
      b.absorbed = sums_.absorbed[l] / batches;
      if (with_beams()) {
        for (std::size_t v = 0; v < voxels; ++v) {
          const PeriodicSlab::Matter& matter = slab_.matter(v);
          for (int c = 0; c < 3; ++c) {
            double way = gathered(v, c);
            if (!back) {
              const std::size_t at = static_cast<std::size_t>(l) * voxels + v;
              way += static_cast<double>(field_.single[at][c] + field_.mirrored[at][c]);
            }
            b.absorbed += way * static_cast<double>(matter.extinction[c] * (1 - matter.albedo[c])) / 3;
          }
        }
      }
      b.absorbed /= power;
      b.left_above /= power;
      b.left_below /= power;
    }
  }

  const BaseVolume& volume_;
  const IrradianceOptions& options_;
  IrradianceSums& sums_;
  PeriodicSlab slab_;
  SlabWalk walk_;
  Plan plan_;
  int n_ = 0;
  BeamField field_;
  std::unique_ptr<IrradianceBatches> batches_;
  Smoothed smooth_upper_, smooth_back_;
};

}  // namespace

IrradianceSums empty_sums(const BaseVolume& volume, const IrradianceOptions& options) {
  check(volume, options);
  return {volume.voxel_count(), volume.texel_count(), options.directions.count(),
          options.estimator == IrradianceEstimator::sphere, is_smoothed(options)};
}

ShellTexture trace_irradiance(const BaseVolume& volume, const IrradianceOptions& options, IrradianceSums& sums,
                              IrradianceReport* report, Progress& progress) {
  if (!sums.fits(empty_sums(volume, options))) throw InternalError("sums of other light paths");
  Tracing tracing(volume, options, sums, progress);
  IrradianceReport own;
  tracing.follow(own, progress);
  if (report) *report = own;
  return tracing.texture();
}

ShellTexture trace_irradiance(const BaseVolume& volume, const IrradianceOptions& options, IrradianceReport* report,
                              Progress& progress) {
  IrradianceSums sums = empty_sums(volume, options);
  return trace_irradiance(volume, options, sums, report, progress);
}

}  // namespace shellgrid
