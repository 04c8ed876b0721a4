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
// smooth gradients, and soft round lamps on it.
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
  // Equirectangular; top row is `up`, the middle column is −z (+x where up is ±z). Null: the sky
  // above.
  std::shared_ptr<const Image> image;
  Rgb scale = Rgb::Ones();  // factor on everything
};

using Light = std::variant<DirectionalLight, PointLight, EnvironmentLight>;

// Radiance that arrives from `direction` (unit, towards the sky): sky or picture (bilinear), and lamps.
Rgb radiance(const EnvironmentLight& environment, const Vec3& direction);

// The environment as parallel lights, each with the energy ∫ L dω of its part of the sphere: the sky by a
// spherical Fibonacci set, each lamp by its own set of equal solid angles, a picture by median cuts.
// About `count` lights, at least 8 for each lamp; parts that shine nothing get none. The same environment and count
// give the same lights.
// Source: [Debevec2005 §3] for pictures.
// Throws: InputError if the picture lacks R, G or B, or holds a negative or non-finite value.
std::vector<DirectionalLight> directional_lights(const EnvironmentLight& environment, int count);

// Light that reaches a point from one direction.
struct IncidentBeam {
  Vec3 direction = Vec3(0, 0, 1);  // towards the light, unit
  double distance = 0;             // to the light, mm; infinite for parallel light
  Rgb irradiance = Rgb::Zero();    // on a plane that faces the light, W mm⁻²
};
IncidentBeam incident_beam(const DirectionalLight& light, const Vec3& point);
IncidentBeam incident_beam(const PointLight& light, const Vec3& point);

// A light that comes from one direction at each point.
using SimpleLight = std::variant<DirectionalLight, PointLight>;
IncidentBeam incident_beam(const SimpleLight& light, const Vec3& point);

// All lights as simple ones: environments become about `environment_samples` parallel lights each.
std::vector<SimpleLight> simple_lights(const std::vector<Light>& lights, int environment_samples);

}  // namespace shellgrid
