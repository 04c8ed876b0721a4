// SPDX-License-Identifier: AGPL-3.0-or-later
#pragma once
#include <memory>
#include <variant>
#include <vector>

#include "meshing/core/image.h"
#include "meshing/core/vec.h"

namespace shellgrid {

// Parallel light. `irradiance` is on a plane that faces it, W mm⁻².
struct DirectionalLight {
  Vec3 direction = Vec3(0, 0, -1);  // in which the light travels, unit
  Rgb irradiance = Rgb::Zero();
};

// A point that radiates equally into all directions.
struct PointLight {
  Vec3 position = Vec3::Zero();  // mm
  Rgb intensity = Rgb::Zero();   // W sr⁻¹; irradiance at distance r facing it: intensity / r²
};

// Radiance from infinitely far away, W mm⁻² sr⁻¹: either an equirectangular picture or a sky of
// smooth gradients with soft round lamps on it.
struct EnvironmentLight {
  struct Lamp {
    Vec3 direction = Vec3(0, 0, 1);  // towards the lamp, unit
    double half_angle = 0.2;         // radians
    double softness = 0.2;           // share of the half angle over which it fades
    Rgb radiance = Rgb::Zero();
  };
  Vec3 up = Vec3(0, 1, 0);
  Rgb zenith = Rgb::Zero(), horizon = Rgb::Zero(), ground = Rgb::Zero();
  std::vector<Lamp> lamps;
  // Equirectangular; top row is `up`, the middle column is −z (or the scene's fallback when up is z). Null: the sky
  // above. Scaled by `scale`.
  std::shared_ptr<const Image> image;
  Rgb scale = Rgb::Ones();
};

using Light = std::variant<DirectionalLight, PointLight, EnvironmentLight>;

}  // namespace shellgrid
