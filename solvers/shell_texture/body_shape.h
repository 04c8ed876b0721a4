// SPDX-License-Identifier: AGPL-3.0-or-later
// What an object's shape does to light that is put together from flat pieces of its shell and a dipole's core.
#pragma once
#include <functional>
#include <vector>

#include "solvers/dipole/core_exchange.h"
#include "solvers/render/scene_geometry.h"
#include "solvers/shell_texture/shell_column.h"
#include "solvers/shell_texture/spread_light.h"

namespace shellgrid {

// The dipole's core as the pictures have it.
struct FlatCore {
  std::function<std::vector<Rgb>(CoreSurface&)> exitance;  // of points that are lit so, W mm⁻²
  Rgb total = Rgb::Zero();                                 // of diffuse light the share that a half-space returns
};

// By how much light that leaves an object of the shell's and core's mean matter is brighter than the same put together
// as pictures are: from a flat shell, lit as each place is, and a dipole's core below it. Diffusion in the whole
// object, with the scene's light at its surface, is divided by that sum: at edges, in thin places and where bright and
// dark sides meet it counts how light goes on within the body. Light that leaves and falls on the object again is of
// it. In a plane it is 1. Where light has no kernels to spread by, even light is taken instead of the scene's, and none
// falls on the object again.
struct BodyShape {
  std::vector<Rgb> ratios;  // at vertices; empty: all 1
  bool whole = false;       // they are of diffusion in the whole object; else of light that falls on it again alone
  double spacing = 0;       // of the grid, mm
  std::int64_t cells = 0;
  int iterations = 0;
};
struct BodyShapeOptions {
  bool diffusion = true;  // where a grid of so many cells at most can follow the light in the object
  double most_cells = 1e5;
  bool returns = true;  // light that leaves and falls on the object again
};
// ior: inside over outside. Throws: InputError where there is no matter.
BodyShape body_shape(const TexturedFrames& frames, const SceneGeometry& geometry, const ShellVolume& shell, double ior,
                     const SpreadLight& light, const LightDirections& directions, const FlatCore& core,
                     const BodyShapeOptions& options = {});

}  // namespace shellgrid
