// SPDX-License-Identifier: AGPL-3.0-or-later
// Light from any direction as a sum over the directions of a table.
#pragma once
#include <array>
#include <vector>

#include "solvers/shell_texture/shell_texture.h"

namespace shellgrid {

// Light from one of the table's directions: its irradiance across the direction.
struct DirectionWeight {
  int direction = 0;
  Vec3f weight = Vec3f::Zero();
};

// Light of unit irradiance from any direction as a sum over four of the table's. Linear in the polar angle and, around
// the circle, in the azimuth; over the zenith from one side to the other. Below the lowest ring it fades as the cosine
// does; from the horizon on there is none. Directions are unit, towards the light, in the sample's frame: x and y along
// the texture, z out of the matter.
//
// Many lights at once, each in a lane.
struct DirectionBlends {
  static constexpr int lanes = 16;
  using Numbers = float __attribute__((vector_size(4 * lanes)));
  using Indices = int __attribute__((vector_size(4 * lanes)));
  std::array<Indices, 4> directions;
  std::array<Numbers, 4> weights;  // 0 where there is less to blend

  DirectionBlends(const LightDirections& table, const Numbers& x, const Numbers& y, const Numbers& z);
};

// The same for one light.
std::vector<DirectionWeight> blend_directions(const LightDirections& table, const Vec3& to_light);

}  // namespace shellgrid
