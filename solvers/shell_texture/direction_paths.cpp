// SPDX-License-Identifier: AGPL-3.0-or-later
#include "solvers/shell_texture/direction_paths.h"

#include <cmath>

#include "meshing/core/parallel.h"

namespace shellgrid {
namespace {

Vec3f to_vector(const Double4& v) {
  return {static_cast<float>(v[0]), static_cast<float>(v[1]), static_cast<float>(v[2])};
}

class DirectionPaths : public IrradianceBatches {
 public:
  DirectionPaths(const SlabWalk& walk, const BaseVolume& volume, const LightDirections& directions, bool sphere,
                 std::uint64_t paths_a_batch, std::uint64_t seed)
      : walk_(walk),
        slab_(walk.slab()),
        volume_(volume),
        directions_(directions),
        sphere_(sphere),
        batch_(paths_a_batch),
        seed_(seed),
        voxels_(volume.voxel_count()),
        texels_(static_cast<std::size_t>(volume.size.x()) * volume.size.y()) {}

  std::uint64_t paths_a_batch() const override { return batch_; }

  void add_upper(IrradianceSums& sums) override {
    const std::uint64_t batch = sums.upper_batches++;
    parallel_for(
        static_cast<std::size_t>(directions_.count()),
        [&](std::size_t l) { follow_batch(static_cast<int>(l), batch, sums); }, 1);
  }
  void add_back(IrradianceSums& sums) override { follow_batch(directions_.back(), sums.back_batches++, sums); }

 private:
  struct Tally {
    std::vector<Vec3f> multiple, single;  // multiple: of all receivers
    double absorbed = 0;
  };

  struct Visitor {
    const DirectionPaths& paths;
    Tally& tally;
    bool scattered;

    void way(std::size_t voxel, const Double4& value) const {
      if (scattered && !paths.sphere_) tally.multiple[voxel] += to_vector(value);
    }
    void collided(const SlabPath& path) {
      const Double4 scatters = path.weight * to_double(paths.slab_.matter(path.voxel).albedo);
      tally.absorbed += lane_sum(path.weight - scatters);
      if (paths.sphere_) paths.add_sphere(path, scatters, scattered, tally);
      scattered = true;
    }
    void mirrored() { scattered = true; }
    void left(const SlabPath& path) const {
      const std::size_t receiver =
          path.direction.z() > 0 ? paths.voxels_ + paths.slab_.texel_at(path.point) : paths.voxels_ + paths.texels_;
      tally.multiple[receiver] += to_vector(path.weight);
    }
  };

  void follow_batch(int direction, std::uint64_t batch, IrradianceSums& sums) const {
    const int n = directions_.count();
    const bool back = direction == directions_.back();
    Tally tally;
    tally.multiple.assign(voxels_ + texels_ + 1, Vec3f::Zero());
    if (sphere_ && !back) tally.single.assign(voxels_, Vec3f::Zero());
    const std::uint64_t key = hash64(seed_, static_cast<std::uint64_t>(direction) + 1);
    for (std::uint64_t k = 0; k < batch_; ++k) {
      SlabPath path{PathRandom(key, batch * batch_ + k)};
      if (back) {
        walk_.start_below(path);
      } else {
        const double x = path.random.next() * slab_.width(0), y = path.random.next() * slab_.width(1);
        walk_.start_above(path, directions_.direction(direction), x, y);
      }
      Visitor visitor{*this, tally, back};
      walk_.follow(path, visitor);
    }
    const double power = slab_.width(0) * slab_.width(1) * (back ? 1 : directions_.direction(direction).z());
    // 3: of the paths' weights one is shared by three channels.
    const auto scale = static_cast<float>(3 * power / static_cast<double>(batch_));
    for (std::size_t r = 0; r < tally.multiple.size(); ++r) {
      const Vec3f value = scale * tally.multiple[r];
      const float mean = value.mean();
      if (back) {
        for (int c = 0; c < 3; ++c) sums.back[3 * r + c] += value[c];
        if (r < voxels_) sums.back_square[r] += mean * mean;
        continue;
      }
      for (int c = 0; c < 3; ++c) sums.upper[(3 * r + c) * n + direction] += value[c];
      if (r < voxels_) sums.upper_square[r * n + direction] += mean * mean;
    }
    for (std::size_t v = 0; v < tally.single.size(); ++v)
      for (int c = 0; c < 3; ++c) sums.single[(3 * v + c) * n + direction] += scale * tally.single[v][c];
    sums.absorbed[direction] += power * tally.absorbed / static_cast<double>(batch_);
  }

  void add_sphere(const SlabPath& path, const Double4& scatters, bool scattered, Tally& tally) const {
    const Vec3i& size = slab_.size();
    const Vec3 at = path.point / slab_.voxel();
    const int x = static_cast<int>(std::floor(at.x())), y = static_cast<int>(std::floor(at.y())),
              z = static_cast<int>(std::floor(at.z()));
    auto& sums = scattered || tally.single.empty() ? tally.multiple : tally.single;
    for (int dz = -1; dz <= 1; ++dz)
      for (int dy = -1; dy <= 1; ++dy)
        for (int dx = -1; dx <= 1; ++dx) {
          if (z + dz < 0 || z + dz >= size.z()) continue;
          if ((Vec3(x + dx + 0.5, y + dy + 0.5, z + dz + 0.5) - at).squaredNorm() > 1) continue;
          const int i = ((x + dx) % size.x() + size.x()) % size.x(), j = ((y + dy) % size.y() + size.y()) % size.y();
          const std::size_t voxel = volume_.index(i, j, z + dz);
          if (volume_.free[voxel]) continue;
          const PeriodicSlab::Matter& matter = slab_.matter(voxel);
          for (int c = 0; c < 3; ++c) {
            const double scattering = static_cast<double>(matter.albedo[c]) * static_cast<double>(matter.extinction[c]);
            if (scattering > 0) sums[voxel][c] += static_cast<float>(scatters[c] / scattering);
          }
        }
  }

  const SlabWalk& walk_;
  const PeriodicSlab& slab_;
  const BaseVolume& volume_;
  LightDirections directions_;
  bool sphere_;
  std::uint64_t batch_, seed_;
  std::size_t voxels_, texels_;
};

}  // namespace

std::unique_ptr<IrradianceBatches> direction_paths(const SlabWalk& walk, const BaseVolume& volume,
                                                   const LightDirections& directions, bool sphere,
                                                   std::uint64_t paths_a_batch, std::uint64_t seed) {
  return std::make_unique<DirectionPaths>(walk, volume, directions, sphere, paths_a_batch, seed);
}

}  // namespace shellgrid
