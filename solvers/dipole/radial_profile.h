// SPDX-License-Identifier: AGPL-3.0-or-later
// A function of distance for each channel, as a table that answers within a few nanoseconds.
#pragma once
#include <algorithm>
#include <array>
#include <bit>
#include <cstdint>
#include <cstring>
#include <functional>
#include <vector>

#include "solvers/diffusion/channel_lanes.h"

namespace shellgrid {

// Linear between nodes that stand evenly in each octave of r² + width²: found by the bits of that number, without a
// logarithm. The relative error is below 1e-3 wherever the function is above 1e-20 of its greatest value; below that
// it is taken as 0.
class RadialProfile {
 public:
  struct Channel {
    std::function<double(double)> value;  // of r, mm; positive, falling with r
    double decay = 0;                     // falls at most as e^{−decay r} times a power not above 3 of r, mm⁻¹
    double width = 1;                     // the function is smooth on this length, mm
  };
  using Channels = std::array<Channel, 3>;

  // averaged: the radius a, mm, of the disc of light that each source stands for: the mean of the function over a disc
  // in the plane at distance r is stored instead, but where a is so much below the width that they hardly differ; 0:
  // the function itself. Throws: InputError for a function that is
  // negative or not finite, or a width that is none.
  explicit RadialProfile(const Channels& channels, double averaged = 0);

  // Of squared distance, mm².
  Float4 operator()(float squared_distance) const {
    const float u = squared_distance + offset_;
    const std::uint32_t bits = std::bit_cast<std::uint32_t>(u);
    const std::uint32_t node = (bits >> shift_) - first_;
    if (node >= last_) return Float4{};
    const float part = static_cast<float>(bits & mask_) * per_node_;
    return table_[node].value + part * table_[node].step;
  }
  // Σ_k powers[k] (*this)(|place − (x, y, z)[k]|²) over k below `count`. The lists may be read, but do not count, up to
  // `lanes` − 1 numbers further.
  static constexpr int lanes = 16;
  Float4 sum(const Vec3f& place, const float* x, const float* y, const float* z, const Float4* powers,
             int count) const {
    using Floats = float __attribute__((vector_size(4 * lanes), aligned(4)));
    using Numbers = std::uint32_t __attribute__((vector_size(4 * lanes)));
    Float4 sums[2] = {};
    for (int k = 0; k < count; k += lanes) {
      const Floats dx = place.x() - *reinterpret_cast<const Floats*>(x + k),
                   dy = place.y() - *reinterpret_cast<const Floats*>(y + k),
                   dz = place.z() - *reinterpret_cast<const Floats*>(z + k);
      const Floats u = dx * dx + dy * dy + dz * dz + offset_;
      Numbers bits;
      std::memcpy(&bits, &u, sizeof bits);
      Numbers node = (bits >> shift_) - first_;
      node = node < last_ ? node : Numbers{} + last_;  // its value and step are 0
      const auto part = __builtin_convertvector(bits & mask_, Floats) * per_node_;
      alignas(64) std::uint32_t nodes[lanes];
      alignas(64) float parts[lanes];
      std::memcpy(nodes, &node, sizeof nodes);
      std::memcpy(parts, &part, sizeof parts);
      const int rest = std::min(lanes, count - k);
      for (int i = 0; i < rest; ++i) {
        const Node& at = table_[nodes[i]];
        sums[i & 1] += powers[k + i] * (at.value + parts[i] * at.step);
      }
    }
    return sums[0] + sums[1];
  }
  Rgb at(double r) const;

  double decay(int channel) const { return decay_[channel]; }
  double width(int channel) const { return width_[channel]; }
  double reach() const { return reach_; }  // beyond this distance all is 0, mm
  std::size_t bytes() const { return table_.size() * sizeof(Node); }

 private:
  struct Node {
    Float4 value, step;  // up to the next node's value
  };
  std::vector<Node> table_;  // the last one's are 0
  float offset_ = 1, per_node_ = 1;
  std::uint32_t first_ = 0, last_ = 0, mask_ = 0;
  int shift_ = 0;
  double decay_[3] = {}, width_[3] = {}, reach_ = 0;
};

}  // namespace shellgrid
