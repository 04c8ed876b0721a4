// SPDX-License-Identifier: AGPL-3.0-or-later
#include "synthesis/periodic_noise.h"

#include <algorithm>
#include <cmath>

#include "meshing/core/random.h"

namespace shellgrid {
namespace {

double fade(double t) { return t * t * t * (t * (t * 6 - 15) + 10); }

int wrap(int i, int n) { return (i % n + n) % n; }

// Dot product of the offset with one of the cube's twelve edge directions.
double corner(std::uint64_t hash, double x, double y, double z) {
  const int h = static_cast<int>(hash >> 60);
  const double u = h < 8 ? x : y;
  const double v = h < 4 ? y : h == 12 || h == 14 ? x : z;
  return (h & 1 ? -u : u) + (h & 2 ? -v : v);
}

}  // namespace

double PeriodicNoise::octave(const Vec3& point, int cells, std::uint64_t stream) const {
  const int cells_x = std::max(1, cells);
  const int cells_y = std::max(1, static_cast<int>(std::lround(static_cast<double>(cells) * ny_ / nx_)));
  const double x = point.x() * cells_x / nx_, y = point.y() * cells_y / ny_, z = point.z() * cells_x / nx_;
  const int ix = static_cast<int>(std::floor(x)), iy = static_cast<int>(std::floor(y));
  const int iz = static_cast<int>(std::floor(z));
  const double fx = x - ix, fy = y - iy, fz = z - iz;
  const std::uint64_t key = hash64(seed_, stream);
  double values[8];
  for (int c = 0; c < 4; ++c) {
    const int dx = c & 1, dy = c >> 1;
    const std::uint64_t column = key ^ hash64(static_cast<std::uint64_t>(wrap(ix + dx, cells_x)) << 32 |
                                              static_cast<std::uint32_t>(wrap(iy + dy, cells_y)));
    for (int dz = 0; dz < 2; ++dz)
      values[c + 4 * dz] = corner(hash64(column + static_cast<std::uint64_t>(static_cast<std::int64_t>(iz + dz))),
                                  fx - dx, fy - dy, fz - dz);
  }
  const double u = fade(fx), v = fade(fy), w = fade(fz);
  const auto lerp = [](double a, double b, double t) { return a + t * (b - a); };
  return lerp(lerp(lerp(values[0], values[1], u), lerp(values[2], values[3], u), v),
              lerp(lerp(values[4], values[5], u), lerp(values[6], values[7], u), v), w);
}

double PeriodicNoise::fractal(const Vec3& point, int cells, int octaves, std::uint64_t stream) const {
  double sum = 0, amplitude = 1;
  for (int i = 0; i < octaves; ++i) {
    // A lattice's noise vanishes at its corners; shifting each octave keeps these from coinciding.
    const Vec3 shift = Vec3(0.31, 0.67, 0.43) * (i + 1) * nx_ / std::max(1, cells);
    sum += amplitude * octave(point + shift, cells, hash64(stream, static_cast<std::uint64_t>(i)));
    amplitude /= 2;
    cells *= 2;
  }
  return sum;
}

}  // namespace shellgrid
