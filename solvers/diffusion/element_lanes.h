// SPDX-License-Identifier: AGPL-3.0-or-later
// Trilinear elements of 16 cells at a time, elements of the thin layer, and their Galerkin products.
#pragma once
#include <array>
#include <cstdint>

#include "solvers/diffusion/channel_lanes.h"
#include "solvers/diffusion/lattice_runs.h"
#include "solvers/diffusion/trilinear_cell.h"
#include "solvers/diffusion/wide_lanes.h"

namespace shellgrid {

// Corners here are numbered by bits: bit k towards + axis k.

// The number among 28 of the pair of corners a < b.
inline constexpr int pair_number(int a, int b) { return a * (15 - a) / 2 + b - a - 1; }

// The symmetric matrix with these couplings, coupling(a, b) for a < b, whose rows add up to zero.
template <class Value, std::size_t size, class Coupling>
inline void fill_from_couplings(Value (&matrix)[size][size], const Coupling& coupling) {
  for (std::size_t a = 0; a < size; ++a) matrix[a][a] = Value{};
  for (std::size_t a = 0; a < size; ++a)
    for (std::size_t b = a + 1; b < size; ++b) {
      const Value value = coupling(static_cast<int>(a), static_cast<int>(b));
      matrix[a][b] = matrix[b][a] = value;
      matrix[a][a] -= value;
      matrix[b][b] -= value;
    }
}

inline constexpr int slot_of_pair(int a, int b) {
  return slot_of_step((b & 1) - (a & 1), (b >> 1 & 1) - (a >> 1 & 1), (b >> 2) - (a >> 2));
}

struct CellLanes {
  Float16Lanes corner[8][3];
  Float16Lanes diffusion[3][8], absorption[3][8];  // of each channel at the Gauss point nearest each corner
};

struct ElementLanes {
  Float16Lanes coupling[3][28];   // −∫ D ∇h_a·∇h_b
  Float16Lanes absorption[3][8];  // ∫ σ_a h_a
};

// 2×2×2 Gauss points.
void core_elements(const CellLanes& cells, ElementLanes& elements);

// Couplings of the parents' corners that each child brings: Pᵀ K P with the child's trilinear weights.
void coarsen_elements(const ElementLanes& children, const std::uint8_t* octant, int count, ElementLanes& parents);

// Couplings among a core cell's corners (0–7) and the outer points above them (8–15), and what flows along the links
// between both: through (x_outer − x_inner), which coarse elements leave out.
struct BoundaryElement {
  std::array<Float4, 120> value{};
  Float4 through[8] = {};
  static constexpr int number(int a, int b) { return a < b ? a * (31 - a) / 2 + b - a - 1 : number(b, a); }
  const Float4& coupling(int a, int b) const { return value[number(a, b)]; }
  Float4& coupling(int a, int b) { return value[number(a, b)]; }
};

// Adds a cell of the thin layer, whose corners (VTK order) are nodes `node` of the core cell. Corner quadrature.
void add_layer_cell(const CellCorners& corners, const Rgb* absorption, const Rgb* reduced_extinction,
                    const std::array<std::uint8_t, 8>& node, BoundaryElement& element,
                    std::array<Float4, 16>& absorbed);

// parent += Pᵀ child P, inner and outer corners each with the child's trilinear weights.
void add_coarse_boundary(const BoundaryElement& child, int octant, BoundaryElement& parent);

}  // namespace shellgrid
