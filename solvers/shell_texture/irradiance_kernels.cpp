// SPDX-License-Identifier: AGPL-3.0-or-later
#include "solvers/shell_texture/irradiance_kernels.h"

#include <Eigen/Geometry>
#include <algorithm>
#include <array>
#include <cmath>
#include <numbers>

#include "meshing/core/error.h"
#include "meshing/core/parallel.h"
#include "solvers/shell_texture/slab_walk.h"

namespace shellgrid {
namespace {

constexpr int most_rings = 96;
constexpr double least_extinction = 1e-6;  // mm⁻¹, for logarithms

int ring_count(const Vec3i& size) { return std::min(most_rings, 3 * size.z() + 4); }

double ring_area(double width, int ring) { return std::numbers::pi * width * width * (2 * ring + 1); }

// Where one path deposits, wherever it wraps around.
struct Deposits {
  const SlabWalk& walk;
  const IrradianceKernels& kernels;
  double x0 = 0, y0 = 0;  // place of entry
  std::vector<Double4>& sums;
  bool scattered = false;
  double shift[2] = {};

  void add(int band, double x, double y, const Double4& value) const {
    const int ring = static_cast<int>(std::hypot(x + shift[0] - x0, y + shift[1] - y0) / kernels.ring);
    if (ring < kernels.rings) sums[static_cast<std::size_t>(band) * kernels.rings + ring] += value;
  }
  void way(std::size_t voxel, const Double4& value) const {
    if (!scattered) return;
    const Vec3i& size = walk.slab().size();
    const auto at = static_cast<int>(voxel);
    const double edge = walk.slab().voxel();
    add(kernels.band_of(at / (size.x() * size.y())), (at % size.x() + 0.5) * edge,
        (at / size.x() % size.y() + 0.5) * edge, value);
  }
  void collided(const SlabPath&) { scattered = true; }
  void mirrored() {}
  void leapt() const {}
  void wrapped(int axis, double width) { shift[axis] += width; }
  void left(const SlabPath& path) const {
    if (path.direction.z() > 0) add(kernels.bottom(), path.point.x(), path.point.y(), path.weight);
  }
};

// Down from above onto matter, and in. False where there is none.
bool enter(const SlabWalk& walk, SlabPath& path) {
  path.point.z() = walk.slab().top();
  path.direction = Vec3(0, 0, 1);
  path.in_matter = false;
  const SlabWalk::Exit exit = walk.next_exit(path);
  if (exit.side != SlabWalk::Side::surface || !exit.is_known()) return false;
  path.point += exit.distance * path.direction;
  const double cosine = std::sqrt(1 - path.random.next()), sine = std::sqrt(std::max(0.0, 1 - cosine * cosine));
  const CosineSine azimuth = path.random.azimuth();
  const Vec3 normal = exit.normal;
  const Vec3 u = (std::abs(normal.x()) < 0.7 ? Vec3(1, 0, 0) : Vec3(0, 1, 0)).cross(normal).normalized();
  path.direction = sine * (azimuth.cosine * u + azimuth.sine * normal.cross(u)) - cosine * normal;
  walk.pass(path, walk.meeting(path, normal));
  return true;
}

}  // namespace

int IrradianceKernels::band_of(int layer) const {
  int band = 0;
  while (band + 2 < bands() && first_layer[band + 1] <= layer) ++band;
  return band;
}

Vec3f IrradianceKernels::value(int kernel, int band, double distance) const {
  const Vec3f* row = values.data() + (static_cast<std::size_t>(kernel) * bands() + band) * rings;
  const double place = std::max(0.0, distance / ring - 0.5);
  if (place >= rings) return Vec3f::Zero();
  const int first = static_cast<int>(place);
  const auto t = static_cast<float>(place - first);
  return (1 - t) * row[first] + (first + 1 < rings ? Vec3f(t * row[first + 1]) : Vec3f(Vec3f::Zero()));
}

double IrradianceKernels::radius(double share) const {
  int farthest = 0;
  for (int band = 0; band < bands(); ++band) {
    std::vector<double> light(rings, 0.0);
    for (int k = 0; k < count(); ++k)
      for (int r = 0; r < rings; ++r)
        light[r] += ring_area(ring, r) *
                    static_cast<double>(values[(static_cast<std::size_t>(k) * bands() + band) * rings + r].sum());
    double whole = 0, sum = 0;
    for (const double l : light) whole += l;
    int r = 0;
    while (r < rings && sum < share * whole) sum += light[r++];
    farthest = std::max(farthest, r);
  }
  return farthest * ring;
}

bool IrradianceKernels::is_sound(const Vec3i& sample) const {
  const auto fits = [](const Vec3f& value) { return value.allFinite() && (value.array() >= 0).all(); };
  return ring > 0 && rings > 0 && bands() > 1 && first_layer.front() == 0 && first_layer.back() == sample.z() &&
         std::is_sorted(first_layer.begin(), first_layer.end()) && count() > 0 &&
         values.size() == static_cast<std::size_t>(count()) * bands() * rings &&
         of_texel.size() == static_cast<std::size_t>(sample.x()) * sample.y() &&
         *std::max_element(of_texel.begin(), of_texel.end()) < count() &&
         std::all_of(values.begin(), values.end(), fits);
}

IrradianceKernels IrradianceKernels::merged() const {
  IrradianceKernels one = *this;
  if (count() <= 1) return one;
  const std::size_t length = static_cast<std::size_t>(bands()) * rings;
  one.values.assign(length, Vec3f::Zero());
  std::vector<int> texels(count(), 0);
  for (const std::uint8_t k : of_texel) ++texels[k];
  for (int k = 0; k < count(); ++k)
    for (std::size_t j = 0; j < length; ++j)
      one.values[j] += static_cast<float>(texels[k]) / static_cast<float>(of_texel.size()) * values[k * length + j];
  std::fill(one.of_texel.begin(), one.of_texel.end(), std::uint8_t{0});
  return one;
}

std::vector<std::vector<float>> kernel_domains(const BaseVolume& volume) {
  const Vec3i& size = volume.size;
  const std::size_t texels = volume.texel_count();
  // Layer by layer: extinction' as a logarithm, albedo', by channel; and the means over squares about each texel.
  std::vector<std::vector<float>> rows(texels);
  const int reach = std::max(1, size.z() / 2);
  std::vector<std::array<float, 6>> layer(texels), along(texels);
  for (int z = 0; z < size.z(); ++z) {
    for (std::size_t t = 0; t < texels; ++t) {
      const std::size_t v = z * texels + t;
      for (int c = 0; c < 3; ++c) {
        const double extinction = static_cast<double>(volume.extinction[v][c]),
                     albedo = static_cast<double>(volume.albedo[v][c]);
        const double scattering = extinction * albedo * (1 - static_cast<double>(volume.anisotropy[v][c]));
        const double reduced = extinction * (1 - albedo) + scattering;
        const bool is_free = volume.free[v] != 0 || !(reduced > 0);
        layer[t][c] = is_free ? 0.0f : static_cast<float>(std::log(std::max(least_extinction, reduced) * volume.voxel));
        layer[t][3 + c] = is_free ? 0.0f : static_cast<float>(std::sqrt(1 - std::min(1.0, scattering / reduced)));
      }
    }
    const auto wrapped = [](int i, int n) { return ((i % n) + n) % n; };
    const auto mean_along = [&](const auto& from, auto& to, int axis) {
      parallel_for(texels, [&](std::size_t t) {
        const int x = static_cast<int>(t) % size.x(), y = static_cast<int>(t) / size.x();
        std::array<float, 6> sum = {};
        for (int d = -reach; d <= reach; ++d) {
          const std::size_t other = axis == 0 ? static_cast<std::size_t>(y) * size.x() + wrapped(x + d, size.x())
                                              : static_cast<std::size_t>(wrapped(y + d, size.y())) * size.x() + x;
          for (int k = 0; k < 6; ++k) sum[k] += from[other][k] / static_cast<float>(2 * reach + 1);
        }
        to[t] = sum;
      });
    };
    for (std::size_t t = 0; t < texels; ++t) rows[t].insert(rows[t].end(), layer[t].begin(), layer[t].end());
    mean_along(layer, along, 0);
    mean_along(along, layer, 1);
    for (std::size_t t = 0; t < texels; ++t) rows[t].insert(rows[t].end(), layer[t].begin(), layer[t].end());
  }
  if (std::all_of(rows.begin(), rows.end(), [&](const auto& row) { return row == rows.front(); }))
    for (auto& row : rows) row.clear();
  return rows;
}

IrradianceKernels trace_kernels(const BaseVolume& volume, const std::vector<std::uint8_t>& of_texel,
                                const KernelOptions& options) {
  if (of_texel.size() != volume.texel_count()) throw InputError("the kernels of texels do not have the sample's size");
  const PeriodicSlab slab(volume);
  const SlabWalk walk(slab);
  IrradianceKernels kernels;
  kernels.ring = volume.voxel;
  kernels.rings = ring_count(volume.size);
  for (int layer = 0; layer < volume.size.z(); layer = std::max(layer + 1, 2 * layer))
    kernels.first_layer.push_back(layer);
  kernels.first_layer.push_back(volume.size.z());
  kernels.of_texel = of_texel;
  const int count = *std::max_element(of_texel.begin(), of_texel.end()) + 1;
  std::vector<std::vector<std::size_t>> texels(count);
  for (std::size_t t = 0; t < of_texel.size(); ++t) texels[of_texel[t]].push_back(t);
  const std::size_t length = static_cast<std::size_t>(kernels.bands()) * kernels.rings;
  kernels.values.assign(count * length, Vec3f::Zero());

  constexpr std::size_t batch = 512;
  const std::size_t batches = static_cast<std::size_t>(std::ceil(std::max(1.0, options.paths) / batch));
  std::vector<std::vector<Double4>> sums(count * batches);
  parallel_for(
      sums.size(),
      [&](std::size_t task) {
        const std::size_t kernel = task / batches;
        std::vector<Double4>& tally = sums[task];
        tally.assign(length, Double4{});
        for (std::size_t n = 0; n < batch && !texels[kernel].empty(); ++n) {
          SlabPath path{PathRandom(hash64(options.seed, 0x6b65726e656cull + kernel), task % batches * batch + n)};
          const auto pick = static_cast<std::size_t>(path.random.next() * static_cast<double>(texels[kernel].size()));
          const std::size_t texel = texels[kernel][pick];
          const double x = (static_cast<double>(texel % volume.size.x()) + path.random.next()) * volume.voxel;
          const double y = (static_cast<double>(texel / volume.size.x()) + path.random.next()) * volume.voxel;
          path.point = Vec3(x, y, 0);
          if (!enter(walk, path)) continue;
          Deposits deposits{walk, kernels, x, y, tally};
          walk.follow(path, deposits);
        }
      },
      1);
  for (std::size_t task = 0; task < sums.size(); ++task)
    for (std::size_t j = 0; j < length; ++j)
      for (int c = 0; c < 3; ++c)
        kernels.values[task / batches * length + j][c] +=
            static_cast<float>(sums[task][j][c] / (static_cast<double>(batches * batch) / 3 *
                                                   ring_area(kernels.ring, static_cast<int>(j) % kernels.rings)));
  return kernels;
}

}  // namespace shellgrid
