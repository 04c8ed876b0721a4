// SPDX-License-Identifier: AGPL-3.0-or-later
#include "synthesis/sample_layers.h"

#include "meshing/core/error.h"

namespace shellgrid {
namespace {

int modulo(int a, int n) { return (a % n + n) % n; }

}  // namespace

SampleLayers SampleLayers::make(const std::vector<Eigen::Vector2i>& sizes, int symmetry) {
  if (sizes.empty() || (symmetry != 1 && symmetry != 2 && symmetry != 4)) throw InternalError("no such layers");
  SampleLayers layers;
  layers.sample_count = static_cast<int>(sizes.size());
  layers.symmetry = symmetry;
  std::int32_t first = 0;
  for (int step = 0; step < symmetry; ++step)
    for (int s = 0; s < layers.sample_count; ++s) {
      const int turn = step * 4 / symmetry;
      const bool across = turn % 2 == 1;
      layers.list.push_back(
          {s, turn, across ? sizes[s].y() : sizes[s].x(), across ? sizes[s].x() : sizes[s].y(), first});
      first += sizes[s].prod();
    }
  return layers;
}

LayerPlace SampleLayers::turned_by(const LayerPlace& place, int steps) const {
  if (symmetry == 1) return place;
  const SampleLayer& from = list[place.layer];
  const float width = static_cast<float>(from.width), height = static_cast<float>(from.height);
  const int to = modulo(turn_of(place.layer) + steps, symmetry) * sample_count + from.sample;
  switch (modulo(list[to].turn - from.turn, 4)) {
    case 1:
      return {to, Vec2f(height - place.at.y(), place.at.x())};
    case 2:
      return {to, Vec2f(width - place.at.x(), height - place.at.y())};
    case 3:
      return {to, Vec2f(place.at.y(), width - place.at.x())};
    default:
      return {to, place.at};
  }
}

std::int32_t SampleLayers::turned_texel(std::int32_t texel, int steps) const {
  const int layer = layer_of(texel), index = texel - list[layer].first;
  const Vec2f middle(static_cast<float>(index % list[layer].width) + 0.5f,
                     static_cast<float>(index / list[layer].width) + 0.5f);
  return this->texel(turned({layer, middle}, steps));
}

}  // namespace shellgrid
