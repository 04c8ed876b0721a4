// SPDX-License-Identifier: AGPL-3.0-or-later
#pragma once
#include <limits>
#include <memory>
#include <optional>
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

// A rectangle that shines from one side, evenly and with the same radiance into all directions. It hides nothing.
struct AreaLight {
  Vec3 position = Vec3::Zero();     // of its middle, mm
  Vec3 direction = Vec3(0, 0, -1);  // in which it faces, unit
  Vec3 up = Vec3(0, 1, 0);          // along its height, as far as it lies in it
  double width = 1, height = 1;     // mm
  Rgb radiance = Rgb::Zero();       // W mm⁻² sr⁻¹
  int patches = 0;                  // as how many patches it is sampled; 0: as who samples says
};

// What a ray from `origin` meets of it on its way of length `distance`: its radiance from its front, else nothing.
Rgb radiance(const AreaLight& light, const Vec3& origin, const Vec3& direction,
             double distance = std::numeric_limits<double>::infinity());

// Its unit axes; along its width, its height, and its direction.
struct AreaFrame {
  Vec3 right, up, normal;
  explicit AreaFrame(const AreaLight& light);
};

// A small piece of a light with extent: shines evenly from its front.
struct PatchLight {
  Vec3 position = Vec3::Zero();     // mm
  Vec3 direction = Vec3(0, 0, -1);  // in which it faces, unit
  Rgb intensity = Rgb::Zero();      // straight ahead, W sr⁻¹; falls with the cosine
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

using Light = std::variant<DirectionalLight, PointLight, AreaLight, EnvironmentLight>;

// Whether its shadows have soft edges.
inline bool has_extent(const Light& light) {
  return std::holds_alternative<AreaLight>(light) || std::holds_alternative<EnvironmentLight>(light);
}

// Where it stands; none of lights that are infinitely far away.
std::optional<Vec3> light_position(const Light& light);

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
IncidentBeam incident_beam(const PatchLight& light, const Vec3& point);

// A light that comes from one direction at each point.
using SimpleLight = std::variant<DirectionalLight, PointLight, PatchLight>;
IncidentBeam incident_beam(const SimpleLight& light, const Vec3& point);

// The rectangle as about `count` patches of equal size, nearly square; as its own number where it has one.
std::vector<PatchLight> patch_lights(const AreaLight& light, int count);

// All lights as simple ones: environments become about `environment_samples` parallel lights each, area lights a
// quarter as many patches.
std::vector<SimpleLight> simple_lights(const std::vector<Light>& lights, int environment_samples);

}  // namespace shellgrid
