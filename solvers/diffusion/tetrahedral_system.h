// SPDX-License-Identifier: AGPL-3.0-or-later
// The diffusion equation on linear tetrahedral elements: what the polygrid is compared with.
#pragma once
#include <vector>

#include "meshing/core/material.h"
#include "meshing/core/tetrahedral_mesh.h"
#include "solvers/diffusion/diffusion_system.h"

namespace shellgrid {

// Assembles ∫ D ∇φ·∇v + ∫ σ_a φ v + ∫_A φ v / (2C) on linear elements, one coefficient an element: σ_a and σ_t', mm⁻¹,
// one entry a tetrahedron. Unknowns are the mesh's points; the surface is the triangles that one tetrahedron has.
// Absorption and surface terms are lumped. `ior` ≥ 1. Source: PHYSICS D1, D2. Throws: InputError for a tetrahedron that
// is inverted or flat, an index out of range, coefficients that are not one a tetrahedron, not finite or not positive.
DiffusionSystem assemble_tetrahedral_system(const TetrahedralMesh& mesh, const std::vector<Rgb>& absorption,
                                            const std::vector<Rgb>& reduced_extinction, double ior);

}  // namespace shellgrid
