// SPDX-License-Identifier: AGPL-3.0-or-later
#pragma once
#include <cmath>
#include <cstdint>
#include <vector>

#include "meshing/core/vec.h"

namespace shellgrid {

// A sample as synthesis may lay it: by quarter turns about its depth. Layers wrap around.
struct SampleLayer {
  int sample = 0;             // which one of several
  int turn = 0;               // quarter turns: u of the sample runs along (cos, sin)(turn · 90°) of the layer
  int width = 0, height = 0;  // texels
  std::int32_t first = 0;     // texel (x, y) stands at first + y·width + x

  int texel_count() const { return width * height; }
};

// A place in a layer, texels; wrapped into [0, width)×[0, height).
struct LayerPlace {
  int layer = 0;
  Vec2f at = Vec2f::Zero();
};

// All layers that synthesis may draw from: every sample as it is, in order, then all of them turned once, and so on.
struct SampleLayers {
  std::vector<SampleLayer> list;
  int sample_count = 1;
  int symmetry = 1;  // turns, 1, 2 or 4; each is by 360°/symmetry

  static SampleLayers make(const std::vector<Eigen::Vector2i>& sizes, int symmetry);

  const SampleLayer& operator[](int layer) const { return list[layer]; }
  int size() const { return static_cast<int>(list.size()); }
  int texel_count() const { return list.back().first + list.back().texel_count(); }
  // Of the samples as they are; these come first.
  int base_texel_count() const { return list[sample_count - 1].first + list[sample_count - 1].texel_count(); }
  int turn_of(int layer) const { return layer / sample_count; }  // in steps of 360°/symmetry
  int layer_of(std::int32_t texel) const {
    int layer = 0;
    while (layer + 1 < size() && list[layer + 1].first <= texel) ++layer;
    return layer;
  }

  Vec2f wrap(int layer, Vec2f at) const {
    const float size[2] = {static_cast<float>(list[layer].width), static_cast<float>(list[layer].height)};
    for (int axis = 0; axis < 2; ++axis) {
      at[axis] -= size[axis] * std::floor(at[axis] / size[axis]);
      if (!(at[axis] < size[axis])) at[axis] = 0;
    }
    return at;
  }
  // The shortest way from b to a on the layer's torus.
  Vec2f difference(int layer, const Vec2f& a, const Vec2f& b) const {
    const float width = static_cast<float>(list[layer].width), height = static_cast<float>(list[layer].height);
    Vec2f d = a - b;
    d.x() -= width * std::round(d.x() / width);
    d.y() -= height * std::round(d.y() / height);
    return d;
  }
  // The place must be wrapped.
  std::int32_t texel(const LayerPlace& place) const {
    const SampleLayer& l = list[place.layer];
    return l.first + static_cast<int>(place.at.y()) * l.width + static_cast<int>(place.at.x());
  }
  // The same place of the sample in the layer that is turned by so many steps more. Not wrapped.
  LayerPlace turned(const LayerPlace& place, int steps) const { return steps == 0 ? place : turned_by(place, steps); }
  std::int32_t turned_texel(std::int32_t texel, int steps) const;

 private:
  LayerPlace turned_by(const LayerPlace& place, int steps) const;
};

}  // namespace shellgrid
