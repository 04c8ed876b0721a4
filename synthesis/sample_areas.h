// SPDX-License-Identifier: AGPL-3.0-or-later
#pragma once
#include <limits>
#include <vector>

#include "synthesis/tangent_neighbours.h"

namespace shellgrid {

// Vertices next to each other that want the same of several samples.
struct PaintedArea {
  std::int32_t sample = 0;
  std::vector<std::int32_t> vertices;
  double surface = 0;  // mm²
  double depth = 0;    // mm: how far its innermost vertex is from other areas, as far as it was looked for
};

// Which samples each vertex may take: its own freely, others near their areas.
class SampleAreas {
 public:
  // wanted: n, of each vertex. blend_width: how far a sample may reach into another's area, mm; into an area that is
  // itself narrow no farther than leaves it its middle. blend_cost: price of the farthest.
  SampleAreas(const TexturedSurface& surface, const std::vector<std::int32_t>& wanted, int sample_count,
              double blend_width, double blend_cost);

  // What a vertex pays for a sample: 0 for its own, more the farther its area is, endless beyond.
  float price(std::int32_t vertex, int sample) const {
    return price_[static_cast<std::size_t>(vertex) * sample_count_ + sample];
  }
  bool allows(std::int32_t vertex, int sample) const { return price(vertex, sample) < never; }
  const std::vector<PaintedArea>& list() const { return areas_; }

  static constexpr float never = std::numeric_limits<float>::infinity();

 private:
  int sample_count_;
  std::vector<float> price_;  // n × samples
  std::vector<PaintedArea> areas_;
};

}  // namespace shellgrid
