// SPDX-License-Identifier: AGPL-3.0-or-later
// Small base volumes of all kinds.
#pragma once
#include <cmath>
#include <string>
#include <vector>

#include "meshing/core/random.h"
#include "solvers/shell_texture/base_volume.h"

namespace shellgrid::test {

inline BaseVolume layer(const Vec3i& size, const Vec3f& extinction, const Vec3f& albedo, float anisotropy, double ior) {
  BaseVolume v;
  v.size = size;
  v.voxel = 0.5;
  v.ior = ior;
  v.extinction.assign(v.voxel_count(), extinction);
  v.albedo.assign(v.voxel_count(), albedo);
  v.anisotropy.assign(v.voxel_count(), Vec3f::Constant(anisotropy));
  v.free.assign(v.voxel_count(), 0);
  return v;
}

// Extinctions of each voxel by chance, over a factor of contrast², the channels one, twice and half as much.
inline void vary_extinction(BaseVolume& v, double contrast) {
  for (std::size_t k = 0; k < v.voxel_count(); ++k) {
    const double power = 2 * to_unit(hash64(3, k)) - 1;
    v.extinction[k] =
        Vec3f(1.0f, 2.0f, 0.5f).cwiseProduct(v.extinction[k]) * static_cast<float>(std::pow(contrast, power));
  }
}

// A mushroom: the head overhangs.
inline void cut_mushroom(BaseVolume& v) {
  const int n = v.size.x();
  for (int y = 0; y < v.size.y(); ++y)
    for (int x = 0; x < n; ++x)
      for (int z = 0; z < 4; ++z) {
        const bool head = z < 2 && x >= n / 5 && x < 4 * n / 5 && y >= n / 5 && y < 4 * n / 5;
        const bool stem = x >= 2 * n / 5 && x < 3 * n / 5 && y >= 2 * n / 5 && y < 3 * n / 5;
        if (!head && !stem) v.free[v.index(x, y, z)] = 1;
      }
}

// Knobs of another matter over veins, ten voxels deep. Any anisotropy has the same reduced coefficients.
inline BaseVolume knobs_over_veins(int width, float anisotropy = 0) {
  BaseVolume v = layer({width, width, 10}, Vec3f(1.5f, 1.6f, 1.8f), Vec3f(0.97f, 0.92f, 0.85f), anisotropy, 1.3);
  v.voxel = 0.4;
  for (int z = 0; z < 10; ++z)
    for (int y = 0; y < width; ++y)
      for (int x = 0; x < width; ++x) {
        const double cx = std::fmod(x + 0.5, 16) - 8, cy = std::fmod(y + 0.5, 16) - 8, r = std::hypot(cx, cy);
        const bool knob = z < 3 ? std::hypot(r, z - 2.5) < 5 : z < 4 && r < 3;
        const std::size_t k = v.index(x, y, z);
        const double turn = 2 * 3.14159265358979 / 48;
        const double vein = std::sin(3 * x * turn + 2 * std::sin(2 * y * turn + 0.3 * z));
        if (z < 4 && !knob) v.free[k] = 1;
        if (vein > 0.8) v.albedo[k] *= 0.9f, v.extinction[k] *= 2;
        if (z < 4) v.albedo[k] = Vec3f(0.99f, 0.98f, 0.95f);
        for (int c = 0; c < 3; ++c) {
          const float scattering = v.albedo[k][c] * v.extinction[k][c], absorption = v.extinction[k][c] - scattering;
          v.extinction[k][c] = absorption + scattering / (1 - anisotropy);
          v.albedo[k][c] = scattering / (1 - anisotropy) / v.extinction[k][c];
        }
      }
  return v;
}

struct NamedVolume {
  std::string name;
  BaseVolume volume;
};

inline std::vector<NamedVolume> base_volumes() {
  std::vector<NamedVolume> all;
  const auto add = [&](const char* name, float extinction, const Vec3f& albedo, float g, double ior, double contrast,
                       bool mushroom) {
    BaseVolume v = layer({10, 10, 8}, Vec3f::Constant(extinction), albedo, g, ior);
    if (contrast > 1) vary_extinction(v, contrast);
    if (mushroom) cut_mushroom(v);
    all.push_back({name, v});
  };
  const Vec3f white = Vec3f::Ones(), coloured(0.95f, 0.8f, 0.5f), partly(1, 0.5f, 0);
  add("flat, index 1", 1, coloured, 0, 1, 1, false);
  add("flat, index 1.3, white, dense", 4, white, 0, 1.3, 1, false);
  add("flat, g 0.8, index 1", 2, coloured, 0.8f, 1, 1, false);
  add("flat, g 0.8, index 1.3", 4, coloured, 0.8f, 1.3, 1, false);
  add("flat, veins, albedo 1, .5, 0", 1, partly, 0, 1.3, 5, false);
  add("flat, veins, g -0.4", 1, coloured, -0.4f, 1.3, 5, false);
  add("bumps, index 1", 1, coloured, 0, 1, 1, true);
  add("bumps, index 1.3, white", 2, white, 0, 1.3, 1, true);
  add("bumps, veins, index 1.3", 1, coloured, 0, 1.3, 4, true);
  add("bumps, veins, g 0.8, index 1.3", 2, coloured, 0.8f, 1.3, 4, true);
  add("bumps, g 0.8, index 1", 2, coloured, 0.8f, 1, 1, true);
  return all;
}

}  // namespace shellgrid::test
