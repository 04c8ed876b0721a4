// SPDX-License-Identifier: AGPL-3.0-or-later
#pragma once
#include <array>

#include "solvers/diffusion/channel_lanes.h"
#include "solvers/transport/path_random.h"
#include "solvers/transport/roulette.h"

namespace shellgrid {

// A path of light on its way. Its weights of the three channels begin with a sum of one.
struct LightPath {
  PathRandom random;
  Vec3 point = Vec3::Zero(), direction = Vec3(0, 0, 1);  // mm; unit, in which it travels
  Double4 weight = {};
  std::array<bool, 2> inside = {};  // of which surface, by SurfaceKind
  std::uint32_t matter = 0;         // of the last collision, for a medium of voxels
  bool entered = false;             // has been in matter since it last came from outside
  std::uint64_t events = 0, next_limit = event_limit;
  std::uint64_t next_distance = 0;  // from which event on it may ask again how far the surface is

  bool in_matter() const { return inside[0] && !inside[1]; }
};

// What matter does with light at a place.
struct ScatteringPlace {
  Double4 albedo = {1, 1, 1, 0}, anisotropy = {};
  bool white = true, one_anisotropy = true;  // albedo 1, and the same anisotropy, in all channels
  int region = 0;                            // where absorbed power is counted: 0 core, 1 shell
};

}  // namespace shellgrid
