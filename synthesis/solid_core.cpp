// SPDX-License-Identifier: AGPL-3.0-or-later
#include <fmt/format.h>

#include <algorithm>
#include <array>
#include <cmath>

#include "meshing/core/error.h"
#include "meshing/core/parallel.h"
#include "meshing/core/random.h"
#include "synthesis/albedo.h"
#include "synthesis/core_voxels.h"
#include "synthesis/shell_core.h"

namespace shellgrid {
namespace {

using Look = Eigen::Array<float, 8, 1>;  // log σ_t', colour, two zeros: a vector register

const std::array<Vec3i, 6> sides = {Vec3i(-1, 0, 0), Vec3i(1, 0, 0),  Vec3i(0, -1, 0),
                                    Vec3i(0, 1, 0),  Vec3i(0, 0, -1), Vec3i(0, 0, 1)};

// The solid's layers without free space, down and up again: periodic in x, y and z.
class PeriodicSolid {
 public:
  explicit PeriodicSolid(const MaterialSample& sample) : sample_(sample) {
    const Vec3i n = sample.size;
    for (int z = 0; z < n.z(); ++z)
      for (int i = 0; i < n.x() * n.y(); ++i)
        if (sample.kind[static_cast<std::size_t>(z) * n.x() * n.y() + i] == VoxelKind::free_space) first_ = z + 1;
    layers_ = n.z() - first_;
    if (layers_ < 1) throw InputError("the core's sample holds free space down to its bottom; make it deeper");
    size_ = Vec3i(n.x(), n.y(), 2 * layers_);
    float least = 1e30f;
    for (std::size_t i = 0; i < sample.voxel_count(); ++i)
      for (int c = 0; c < 3; ++c)
        if (const float s = sample.material(i).reduced_extinction()[c]; s > 0) least = std::min(least, s);
    least_ = least;
    looks_.resize(static_cast<std::size_t>(size_.x()) * size_.y() * size_.z());
    parallel_for(looks_.size(), [&](std::size_t i) { looks_[i] = raw_look(sample.material(voxel(place(i)))); });
    using Sum = Eigen::Array<double, 16, 1>;
    const Sum sum = parallel_sum(looks_.size(), Sum(Sum::Zero()), [&](std::size_t i) {
      Sum s;
      s << looks_[i].cast<double>(), looks_[i].cast<double>().square();
      return s;
    });
    const auto count = static_cast<double>(looks_.size());
    const Eigen::Array<double, 8, 1> variance = sum.tail<8>() / count - (sum.head<8>() / count).square();
    for (const int group : {0, 3}) {
      const double total = variance.segment<3>(group).sum();
      scale_.segment<3>(group).setConstant(total > 1e-12 ? static_cast<float>(1 / std::sqrt(total)) : 0.0f);
    }
    for (Look& look : looks_) look *= scale_;
  }

  const Vec3i& size() const { return size_; }
  int layers() const { return layers_; }
  Vec3i place(std::size_t i) const {
    const auto x = static_cast<std::size_t>(size_.x()), y = static_cast<std::size_t>(size_.y());
    return {static_cast<int>(i % x), static_cast<int>(i / x % y), static_cast<int>(i / (x * y))};
  }
  Vec3i wrap(Vec3i p) const {
    for (int axis = 0; axis < 3; ++axis) {
      p[axis] %= size_[axis];
      if (p[axis] < 0) p[axis] += size_[axis];
    }
    return p;
  }
  std::size_t index(const Vec3i& p) const {
    return (static_cast<std::size_t>(p.z()) * size_.y() + p.y()) * size_.x() + p.x();
  }
  const Look& look(const Vec3i& wrapped) const { return looks_[index(wrapped)]; }
  Look look_of(const Material& material) const { return raw_look(material) * scale_; }
  Material material(const Vec3i& wrapped) const { return sample_.material(voxel(wrapped)); }

 private:
  std::size_t voxel(const Vec3i& p) const {
    return sample_.index(p.x(), p.y(), first_ + (p.z() < layers_ ? p.z() : 2 * layers_ - 1 - p.z()));
  }
  Look raw_look(const Material& material) const {
    Look look = Look::Zero();
    look.head<3>() = material.reduced_extinction().max(least_).log();
    look.segment<3>(3) = diffuse_color(material, sample_.ior);
    return look;
  }

  const MaterialSample& sample_;
  int first_ = 0, layers_ = 0;
  Vec3i size_ = Vec3i::Zero();
  float least_ = 1;
  Look scale_ = Look::Zero();
  std::vector<Look> looks_;
};

class SolidCore {
 public:
  SolidCore(const ShellVolume& shell, const std::vector<Vec3i>& core, const PeriodicSolid& solid,
            const SolidCoreOptions& options)
      : shell_(shell),
        core_(core),
        solid_(solid),
        options_(options),
        number_(shell.extinction.lower_leaf(), shell.extinction.leaf_counts(), nothing) {
    for (std::size_t k = 0; k < core.size(); ++k)
      number_.set(core[k].x(), core[k].y(), core[k].z(), static_cast<int>(k));
    // The shell's voxels that a core voxel may compare with.
    const double layers = shell.thickness / shell.frame.voxel;
    std::vector<Vec3i> above;
    shell.texture_coordinate.for_each_active([&](int i, int j, int k, const Vec3f& t) {
      if (t.z() < layers - context || shell.kind.value(i, j, k) == 0) return;
      number_.set(i, j, k, -2 - static_cast<int>(above.size()));
      above.emplace_back(i, j, k);
    });
    shell_looks_.resize(above.size());
    parallel_for(above.size(), [&](std::size_t k) {
      const Vec3i& v = above[k];
      shell_looks_[k] = solid.look_of({shell.extinction.value(v.x(), v.y(), v.z()).array(),
                                       shell.albedo.value(v.x(), v.y(), v.z()).array(),
                                       shell.anisotropy.value(v.x(), v.y(), v.z()).array()});
    });
    source_.resize(core.size());
    parallel_for(core.size(), [&](std::size_t k) { source_[k] = start(core[k]); });
    find_border(above);
  }

  const std::vector<Vec3i>& source() const { return source_; }
  std::size_t border_size() const { return border_.size(); }

  // Mean squared difference of looks across the shell's bottom.
  double step_to_shell() const {
    double sum = 0, count = 0;
    for (std::size_t k = 0; k < core_.size(); ++k)
      for (const Vec3i& side : sides)
        if (const int other = at(core_[k] + side); other <= -2) {
          sum += (shell_looks_[-2 - other] - solid_.look(source_[k])).square().sum();
          ++count;
        }
    return count > 0 ? sum / count : 0;
  }

  void synthesize(Progress& progress) {
    progress.begin("core", 3 * options_.passes);
    for (const int step : {4, 2, 1})
      for (int pass = 0; pass < options_.passes; ++pass) {
        // Those of one parity at once; each reads what the other parity has become.
        for (int parity = 0; parity < 2; ++parity) {
          std::vector<Vec3i> chosen(border_.size());
          parallel_for(
              border_.size(),
              [&](std::size_t i) {
                const std::int32_t k = border_[i];
                const Vec3i& v = core_[k];
                const int sum = (v.x() + v.y() + v.z()) & 1;
                chosen[i] = sum == parity ? choose(k, step, pass) : source_[k];
              },
              64);
          for (std::size_t i = 0; i < border_.size(); ++i) source_[border_[i]] = chosen[i];
        }
        progress.advance();
      }
    progress.end();
  }

 private:
  static constexpr int nothing = -1;
  static constexpr double context = 8;  // voxels: 4 diagonal ones

  int at(const Vec3i& v) const { return number_.value(v.x(), v.y(), v.z()); }

  // Slabs of the solid's layers on each other, each moved sideways at random.
  Vec3i start(const Vec3i& v) const {
    const int slab = slab_of(v.z());
    const std::uint64_t bits = hash64(options_.seed, 82, static_cast<std::uint64_t>(static_cast<std::int64_t>(slab)));
    const Vec3i moved(static_cast<int>(to_unit(hash64(bits, 1)) * solid_.size().x()),
                      static_cast<int>(to_unit(hash64(bits, 2)) * solid_.size().y()), 0);
    return solid_.wrap(Vec3i(v.x(), v.y(), v.z() - slab * solid_.layers()) + moved);
  }
  int slab_of(int z) const { return static_cast<int>(std::floor(static_cast<double>(z) / solid_.layers())); }

  // Core voxels up to `reach` steps from the shell, or half as many from where two slabs meet.
  void find_border(const std::vector<Vec3i>& above) {
    std::vector<char> seen(core_.size(), 0);
    std::vector<std::int32_t> layer;
    const auto reach_from = [&](const Vec3i& v, std::vector<std::int32_t>& next) {
      for (const Vec3i& side : sides)
        if (const int k = at(v + side); k >= 0 && !seen[k]) seen[k] = 1, next.push_back(k);
    };
    const int half = options_.reach / 2;
    for (std::size_t k = 0; k < core_.size(); ++k)
      if (const int z = core_[k].z(); slab_of(z - half) != slab_of(z) || slab_of(z + half - 1) != slab_of(z))
        seen[k] = 1, border_.push_back(static_cast<std::int32_t>(k));
    for (const Vec3i& v : above) reach_from(v, layer);
    for (int step = 1;; ++step) {
      border_.insert(border_.end(), layer.begin(), layer.end());
      if (step >= options_.reach || layer.empty()) break;
      std::vector<std::int32_t> next;
      for (const std::int32_t k : layer) reach_from(core_[k], next);
      layer = std::move(next);
    }
  }

  Vec3i choose(std::int32_t k, int step, int pass) const {
    const Vec3i v = core_[k];
    std::array<const Look*, 26> wanted;
    std::array<Vec3i, 26> offsets;
    int used = 0;
    for (int n = 0; n < 27; ++n) {
      const Vec3i o = step * Vec3i(n / 9 - 1, n / 3 % 3 - 1, n % 3 - 1);
      if (n == 13) continue;
      const int other = at(v + o);
      if (other == nothing) continue;
      wanted[used] = other >= 0 ? &solid_.look(source_[other]) : &shell_looks_[-2 - other];
      offsets[used++] = o;
    }
    const Vec3i size = solid_.size();
    float least = 3e38f;
    Vec3i best = source_[k];
    const auto consider = [&](const Vec3i& candidate, float penalty) {
      float distance = 0;
      for (int n = 0; n < used; ++n) {
        Vec3i p = candidate + offsets[n];
        for (int axis = 0; axis < 3; ++axis) {
          while (p[axis] < 0) p[axis] += size[axis];
          while (p[axis] >= size[axis]) p[axis] -= size[axis];
        }
        distance += penalty * (*wanted[n] - solid_.look(p)).square().sum();
        if (distance >= least) return;
      }
      least = distance;
      best = candidate;
    };
    consider(source_[k], 1);
    for (const int way : {1, step})
      for (const Vec3i& side : sides)
        if (const int other = at(v + way * side); other >= 0) consider(solid_.wrap(source_[other] - way * side), 1);
    RandomStream random(hash64(options_.seed, 81, static_cast<std::uint64_t>(64 * step + pass)),
                        static_cast<std::uint64_t>(k));
    // Anywhere, and nearer and nearer to the best so far.
    double radius = 1;
    for (int tries = 0; tries < 4; ++tries, radius *= 0.4) {
      Vec3i candidate;
      for (int axis = 0; axis < 3; ++axis)
        candidate[axis] = best[axis] + static_cast<int>(std::lround((random.next() - 0.5) * radius * size[axis]));
      consider(solid_.wrap(candidate), incoherence_penalty);
    }
    return best;
  }

  static constexpr float incoherence_penalty = 1.05f;

  const ShellVolume& shell_;
  const std::vector<Vec3i>& core_;
  const PeriodicSolid& solid_;
  const SolidCoreOptions& options_;
  TwoLevelGrid<std::int32_t> number_;  // ≥ 0: core voxel; ≤ −2: shell voxel −2 − number
  std::vector<Look> shell_looks_;
  std::vector<Vec3i> source_;  // of each core voxel, wrapped
  std::vector<std::int32_t> border_;
};

double step_in_sample(const PeriodicSolid& solid) {
  const auto count = static_cast<std::size_t>(solid.size().prod());
  const double sum = parallel_sum(count, 0.0, [&](std::size_t i) {
    const Vec3i p = solid.place(i);
    double s = 0;
    for (int axis = 0; axis < 3; ++axis)
      s += (solid.look(p) - solid.look(solid.wrap(p + Vec3i(Vec3i::Unit(axis))))).square().sum();
    return s / 3;
  });
  return sum / static_cast<double>(count);
}

}  // namespace

void fill_core_with_solid(ShellVolume& shell, const DistanceField& distance, const MaterialSample& solid,
                          const SolidCoreOptions& options, CoreStatistics* statistics, Progress& progress) {
  if (std::abs(solid.voxel - shell.frame.voxel) > 1e-4 * shell.frame.voxel)
    throw InputError(fmt::format("the core's sample has voxels of {} mm and the shell of {} mm; they must be equal",
                                 solid.voxel, shell.frame.voxel));
  const std::size_t bytes = shell_bytes(shell);
  const std::vector<Vec3i> core = find_core_voxels(distance, shell);
  CoreStatistics figures;
  figures.voxels = static_cast<long>(core.size());
  if (!core.empty()) {
    const PeriodicSolid periodic(solid);
    SolidCore synthesis(shell, core, periodic, options);
    figures.tiling_step = synthesis.step_to_shell();
    figures.synthesized_voxels = static_cast<long>(synthesis.border_size());
    synthesis.synthesize(progress);
    figures.shell_step = synthesis.step_to_shell();
    figures.sample_step = step_in_sample(periodic);
    const std::vector<Vec3i> source = synthesis.source();
    allocate_core(shell, core);
    parallel_for(core.size(), [&](std::size_t k) { set_core_voxel(shell, core[k], periodic.material(source[k])); });
  }
  figures.bytes = shell_bytes(shell) - bytes;
  if (statistics) *statistics = figures;
}

}  // namespace shellgrid
