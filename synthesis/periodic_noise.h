// SPDX-License-Identifier: AGPL-3.0-or-later
#pragma once
#include <cstdint>

#include "meshing/core/vec.h"

namespace shellgrid {

// Gradient noise on [0, n_x)×[0, n_y)×R that repeats in x and y. Source: [Perlin2002].
class PeriodicNoise {
 public:
  PeriodicNoise(int nx, int ny, std::uint64_t seed) : nx_(nx), ny_(ny), seed_(seed) {}

  // One octave with `cells` lattice cells across n_x (about as large ones across n_y and in depth); about −1 … 1.
  // point: voxels.
  double octave(const Vec3& point, int cells, std::uint64_t stream) const;

  // Octaves of doubling frequency and halving amplitude.
  double fractal(const Vec3& point, int cells, int octaves, std::uint64_t stream) const;

 private:
  int nx_, ny_;
  std::uint64_t seed_;
};

}  // namespace shellgrid
