// SPDX-License-Identifier: AGPL-3.0-or-later
#include "synthesis/sample_builder.h"

#include <algorithm>
#include <cmath>

#include "meshing/core/random.h"

namespace shellgrid {

MaterialSample allocate_sample(const Vec3i& size, double voxel, double ior) {
  MaterialSample sample;
  sample.size = size;
  sample.voxel = voxel;
  sample.ior = ior;
  const std::size_t count = sample.voxel_count();
  sample.extinction.assign(count, Vec3f::Zero());
  sample.albedo.assign(count, Vec3f::Zero());
  sample.anisotropy.assign(count, Vec3f::Zero());
  sample.normal.assign(count, Vec3f::Zero());
  sample.kind.assign(count, VoxelKind::interior);
  return sample;
}

void store_material(MaterialSample& sample, std::size_t index, const Material& material) {
  sample.extinction[index] = material.extinction.matrix();
  sample.albedo[index] = material.albedo.matrix();
  sample.anisotropy[index] = material.anisotropy.matrix();
}

Material mix_like_stains(const Material& a, const Material& b, double share) {
  const float w = static_cast<float>(share);
  const Rgb least = Rgb::Constant(1e-6f);
  const Rgb from = a.absorption(), to = b.absorption();
  Rgb absorption = (from.max(least).log() * (1 - w) + to.max(least).log() * w).exp();
  // What does not absorb stays so; mixed with what does it counts as the least absorption.
  for (int c = 0; c < 3; ++c)
    if ((from[c] == 0 || w >= 1) && (to[c] == 0 || w <= 0)) absorption[c] = 0;
  const Rgb scattering = a.scattering() * (1 - w) + b.scattering() * w;
  return Material::from_absorption_scattering(absorption, scattering, a.anisotropy * (1 - w) + b.anisotropy * w);
}

Material Composition::material() const {
  if (!(share_ > 0)) return {};
  const float scale = static_cast<float>(1 / share_);
  const Rgb anisotropy = (scattering_ > 0).select(forward_ / scattering_, Rgb::Zero());
  return Material::from_absorption_scattering(absorption_.max(0.0f) * scale, scattering_ * scale, anisotropy);
}

std::vector<Vec2> spread_points(int count, double nx, double ny, std::uint64_t seed) {
  std::vector<Vec2> points;
  RandomStream random(seed, 77);
  const auto wrapped = [](double d, double n) { return d - n * std::round(d / n); };
  for (int i = 0; i < count; ++i) {
    Vec2 best = Vec2::Zero();
    double best_distance = -1;
    for (int trial = 0; trial < 20; ++trial) {
      const double x = random.next() * nx, y = random.next() * ny;
      double nearest = 1e300;
      for (const Vec2& point : points)
        nearest = std::min(nearest, std::hypot(wrapped(point.x() - x, nx), wrapped(point.y() - y, ny)));
      if (nearest > best_distance) best_distance = nearest, best = Vec2(x, y);
    }
    points.push_back(best);
  }
  return points;
}

void mark_surface(MaterialSample& sample, const std::vector<Vec3f>* outward) {
  const int nx = sample.size.x(), ny = sample.size.y(), nz = sample.size.z();
  const auto is_free = [&](int x, int y, int z) {
    if (z < 0) return true;
    if (z >= nz) return false;
    return sample.kind[sample.index((x + nx) % nx, (y + ny) % ny, z)] == VoxelKind::free_space;
  };
  const Vec3i steps[6] = {{1, 0, 0}, {-1, 0, 0}, {0, 1, 0}, {0, -1, 0}, {0, 0, 1}, {0, 0, -1}};
  std::vector<std::size_t> surface;
  for (int z = 0; z < nz; ++z)
    for (int y = 0; y < ny; ++y)
      for (int x = 0; x < nx; ++x) {
        const std::size_t index = sample.index(x, y, z);
        sample.normal[index].setZero();
        if (is_free(x, y, z)) continue;
        if (std::none_of(steps, steps + 6, [&](const Vec3i& d) { return is_free(x + d.x(), y + d.y(), z + d.z()); }))
          continue;
        surface.push_back(index);
        Vec3f normal = Vec3f::Zero();
        if (outward)
          normal = (*outward)[index];
        else
          for (int dz = -2; dz <= 2; ++dz)
            for (int dy = -2; dy <= 2; ++dy)
              for (int dx = -2; dx <= 2; ++dx)
                if (is_free(x + dx, y + dy, z + dz))
                  normal += Vec3f(dx, dy, dz) / std::max(1, dx * dx + dy * dy + dz * dz);
        sample.normal[index] = normal.norm() > 1e-6f ? normal.normalized() : Vec3f(0, 0, -1);
      }
  for (std::size_t index : surface) sample.kind[index] = VoxelKind::surface;
}

}  // namespace shellgrid
