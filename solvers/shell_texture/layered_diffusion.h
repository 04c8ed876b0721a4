// SPDX-License-Identifier: AGPL-3.0-or-later
// Diffuse light in a whole object whose matter is layered by its depth below the surface.
#pragma once
#include <cstdint>
#include <vector>

#include "meshing/core/triangle_mesh.h"
#include "solvers/shell_texture/shell_column.h"

namespace shellgrid {

// The object's matter by depth: layers from the surface down, and a core below them.
struct LayeredMatter {
  std::vector<ShellLayer> layers;
  double layer_thickness = 0;  // mm
  ShellLayer core;
  double ior = 1;  // inside over outside
};

// −∇·(D ∇φ) + σ_a φ = 0 in the object, and at its surface φ = φ_e − 2 C D ∂φ/∂n: diffuse light of fluence φ_e shines
// in (PHYSICS D2), and none is scattered before. Source: [Ishimaru1978, ch. 9].
//
// Finite volumes on a regular grid; a cell belongs to the object where its middle does. A cell's face between inside
// and outside stands for |n_a| times its area of the surface, n the surface's normal there and a the face's axis, so
// that planes have their area however they lie; the surface's distance is that of the plane. What flows in is mended by
// what a half-space shows of the grid's error, by where its plane lies between the grid's points.
class LayeredDiffusion {
 public:
  // spacing: of the grid, mm. Throws: InputError where the surface is not closed, or the grid too large.
  LayeredDiffusion(const TriangleMesh& mesh, const LayeredMatter& matter, double spacing);

  // What flows in through pieces of the surface, by their own φ_e.
  struct Flow {
    std::vector<Rgb> inward;   // of each piece, mean over its part of the surface
    std::vector<float> areas;  // of the grid's surface that is a piece's, mm²; 0: it has none
    int iterations = 0;        // of conjugate gradients
  };
  // piece_of_vertex: of each of the mesh's vertices; about: φ_e of each piece. tolerance: of the residual, relative.
  Flow flow(const std::vector<int>& piece_of_vertex, const std::vector<Rgb>& about, double tolerance = 1e-3) const;

  std::int64_t cells() const { return static_cast<std::int64_t>(absorption_.size()); }
  double spacing() const { return spacing_; }

 private:
  using Lanes = float __attribute__((vector_size(16)));
  struct Face {
    int cell, vertex;
    float area;         // of the surface, mm²
    Lanes conductance;  // mm²
    Lanes mending;
  };

  double spacing_;
  std::vector<Lanes> absorption_;                   // σ_a V of each cell, mm²
  std::vector<Lanes> conductances_[3];              // to the next cell along each axis, mm²; 0: none
  std::vector<std::int32_t> before_[3], after_[3];  // −1: none
  std::vector<Lanes> diagonal_;
  std::vector<Face> faces_;
};

}  // namespace shellgrid
