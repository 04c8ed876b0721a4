// SPDX-License-Identifier: AGPL-3.0-or-later
// What a surface's curvature does to light that a shell texture function knows of a plane.
#pragma once
#include <array>
#include <vector>

#include "solvers/shell_texture/shell_column.h"
#include "solvers/shell_texture/vertex_buckets.h"

namespace shellgrid {

// A shell bent to a ball's beside the same shell flat: light in it, by depth below its surface.
//
// Between spheres diffusion is a line's, with an area J(z) = (1 − H z)² at depth z: −(D J φ')' + σ_a J φ = q, where the
// beams of even light are scattered first. They spread as they go down between spheres, sin θ growing as 1/(1 − H z).
// Above φ = 2 C D φ' (D2), below nothing comes in, or diffuse light alone. Solved for both shapes, the ratios are what
// curvature does to φ; u = r φ obeys the plane's equation, so that in deep white matter it is 1/(1 − H z).
class BentShell {
 public:
  struct Ratios {
    Rgb single = Rgb::Ones();    // fluence of beams
    Rgb multiple = Rgb::Ones();  // of scattered light that came from above
    Rgb back = Rgb::Ones();      // of diffuse light from below
  };
  // bend: H times the shell's thickness, below 1; voxel: a layer's thickness, mm; ior: inside over outside.
  BentShell(const std::vector<ShellLayer>& layers, double voxel, double ior, double bend);

  const std::vector<Ratios>& layers() const { return layers_; }
  const Rgb& below() const { return below_; }  // of what passes down, per area of the core
  const Rgb& loss() const { return loss_; }    // of what does not return of diffuse light from the core

 private:
  std::vector<Ratios> layers_;
  Rgb below_ = Rgb::Ones(), loss_ = Rgb::Ones();
};

// Mean curvatures H of the surface, 1/mm, positive where it is convex, over about `reach` mm: from the areas that the
// surface has there and `depth` mm below, J = (1 − H depth)².
std::vector<float> mean_curvatures(const TexturedFrames& frames, double depth, double reach);

// Those ratios at every vertex of a surface. Threads may share it.
class ShellCurvature {
 public:
  // The shell below the surface, with its matter; ior: inside over outside.
  ShellCurvature(const TexturedFrames& frames, const ShellVolume& shell, double ior);

  // depth: below the surface, voxels.
  BentShell::Ratios at(int vertex, float depth) const;
  Rgb below(int vertex) const;
  Rgb loss(int vertex) const;
  float curvature(int vertex) const { return curvatures_[vertex]; }  // H, 1/mm, as far as the ratios follow it

 private:
  struct Place {
    int step;
    float part;
  };
  Place place_of(int vertex) const;

  std::vector<float> curvatures_;
  double thickness_ = 0;
  std::vector<BentShell> steps_;  // over the bend
};

}  // namespace shellgrid
