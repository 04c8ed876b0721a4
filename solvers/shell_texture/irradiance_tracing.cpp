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
#include "solvers/shell_texture/shared_walks.h"

namespace shellgrid {
namespace {

constexpr std::uint64_t least_batches = 8;  // to tell their spread
constexpr std::uint64_t most_walks_a_batch = 8192;
constexpr std::uint64_t upper_batches_a_back_batch = 3;
constexpr double checkpoint_seconds = 60;
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

  // Whether the error is looked at after so many batches.
  bool is_judged(std::uint64_t batches) const {
    if (batches < least) return false;
    std::uint64_t at = least;
    while (at < batches) at = std::max(at + 1, at + at / 8);
    return at == batches || batches >= most;
  }
};

// Relative standard error of a mean of `batches` values; −1 where nothing came.
float relative_error(double sum, double square, double more, double batches) {
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
    const auto per_back_batch = static_cast<float>(1 / static_cast<double>(sums_.back_batches));
    parallel_for(
        static_cast<std::size_t>(n_) + 1,
        [&](std::size_t l) {
          const bool back = l == static_cast<std::size_t>(n_);
          for (std::size_t v = 0; v < voxels; ++v) {
            const std::size_t at = l * voxels + v;
            t.error[at] = error_of(v, static_cast<int>(l));
            const float scale = scale_of(v);
            Vec3f value;
            for (int c = 0; c < 3; ++c)
              value[c] =
                  back ? 0.5f * per_back_batch * sums_.back[3 * v + c] : per_batch * sums_.upper[(3 * v + c) * n_ + l];
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
            for (int c = 0; c < 3; ++c)
              power[c] = back ? per_back_batch * sums_.back[3 * r + c] : per_batch * sums_.upper[(3 * r + c) * n_ + l];
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

  bool is_done(double& error) const {
    const std::uint64_t batches = sums_.upper_batches;
    if (batches >= plan_.least && !(options_.target_error > 0)) return true;
    if (!plan_.is_judged(batches)) return false;
    error = median_error(true);
    return error <= options_.target_error || batches >= plan_.most;
  }

  float scale_of(std::size_t v) const {
    const double cell = std::pow(volume_.voxel, 3);
    const bool sphere = options_.estimator == IrradianceEstimator::sphere;
    if (sphere) return static_cast<float>(volume_.free[v] ? 0 : 1 / (4.0 / 3 * std::numbers::pi * cell));
    return slab_.share()[v] > least_matter ? static_cast<float>(1 / (cell * static_cast<double>(slab_.share()[v]))) : 0;
  }

  float error_of(std::size_t v, int l) const {
    if (l == n_) {
      const double sum = static_cast<double>(sums_.back[3 * v] + sums_.back[3 * v + 1] + sums_.back[3 * v + 2]) / 3;
      return relative_error(sum, static_cast<double>(sums_.back_square[v]), 0, static_cast<double>(sums_.back_batches));
    }
    double sum = 0;
    for (int c = 0; c < 3; ++c) sum += static_cast<double>(sums_.upper[(3 * v + c) * n_ + l]) / 3;
    const std::size_t at = static_cast<std::size_t>(l) * volume_.voxel_count() + v;
    const double more = !with_beams() ? 0 : static_cast<double>(field_.mirrored[at].mean());
    return relative_error(sum, static_cast<double>(sums_.upper_square[v * n_ + l]), more,
                          static_cast<double>(sums_.upper_batches));
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
};

}  // namespace

IrradianceSums empty_sums(const BaseVolume& volume, const IrradianceOptions& options) {
  check(volume, options);
  return {volume.voxel_count(), volume.texel_count(), options.directions.count(),
          options.estimator == IrradianceEstimator::sphere};
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
