// SPDX-License-Identifier: AGPL-3.0-or-later
// What light paths through a slab have brought so far: enough to go on from, to the same bits as without a break.
#pragma once
#include <cstdint>
#include <vector>

namespace shellgrid {

// Sums over batches. Receivers are the voxels (weights times lengths, mm³ for unit irradiance across the direction),
// then the texels of the bottom and what is above (power, mm²).
struct IrradianceSums {
  std::uint64_t upper_batches = 0, back_batches = 0;
  std::uint64_t next_judged = 0;    // the error is not looked at before so many upper batches
  std::vector<float> upper;         // receivers × 3 directions, at (3 receiver + channel) · directions + direction
  std::vector<float> upper_square;  // voxels × directions: squares of the channels' mean
  std::vector<float> back;          // receivers × 3, of light from below
  std::vector<float> back_square;   // voxels
  // Where values are to be smoothed, of every other batch as `upper` and `back`; else empty.
  std::vector<float> upper_half, back_half;
  std::vector<double> layer_square;  // there, of layers: squares of the sums over voxels, channels and directions
  std::vector<float> single;         // voxels × 3 directions, where paths estimate I_s too
  std::vector<double> absorbed;      // directions + 1: power at collisions, where paths tell

  IrradianceSums() = default;
  IrradianceSums(std::size_t voxels, std::size_t texels, int directions, bool with_single, bool smoothed)
      : upper((voxels + texels + 1) * 3 * directions),
        upper_square(voxels * directions),
        back((voxels + texels + 1) * 3),
        back_square(voxels),
        upper_half(smoothed ? upper.size() : 0),
        back_half(smoothed ? back.size() : 0),
        layer_square(smoothed ? voxels / texels : 0),
        single(with_single ? voxels * 3 * directions : 0),
        absorbed(static_cast<std::size_t>(directions) + 1) {}

  bool fits(const IrradianceSums& other) const {
    return upper.size() == other.upper.size() && upper_square.size() == other.upper_square.size() &&
           back.size() == other.back.size() && back_square.size() == other.back_square.size() &&
           upper_half.size() == other.upper_half.size() && back_half.size() == other.back_half.size() &&
           layer_square.size() == other.layer_square.size() && single.size() == other.single.size() &&
           absorbed.size() == other.absorbed.size();
  }
};

// A way to estimate. Batches are independent of one another; adding them in their order gives the same bits at any
// thread count.
class IrradianceBatches {
 public:
  virtual ~IrradianceBatches() = default;
  virtual std::uint64_t paths_a_batch() const = 0;
  // Adds a batch of light from above, then of light from below; counts it.
  virtual void add_upper(IrradianceSums& sums) = 0;
  virtual void add_back(IrradianceSums& sums) = 0;
};

}  // namespace shellgrid
