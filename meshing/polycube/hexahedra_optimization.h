// SPDX-License-Identifier: AGPL-3.0-or-later
#pragma once
#include <array>
#include <cstdint>
#include <vector>

#include "meshing/core/vec.h"

namespace shellgrid {

// Corner k of a hexahedron stands at (k & 1, k >> 1 & 1, k >> 2) of its own lattice, whose axes are
// right-handed.
using LatticeHexahedron = std::array<std::int32_t, 8>;

// The eight Jacobian determinants at the corners of a hexahedron, edge vectors as columns.
std::array<double, 8> corner_jacobians(const VertexMatrix& points, const LatticeHexahedron& cell);
// The least determinant at the corners and at the 2×2×2 and 3×3×3 Gauss points.
double least_jacobian(const VertexMatrix& points, const LatticeHexahedron& cell);
// The same, or a lower bound of the determinant all over the cell that is greater than `enough`.
double least_jacobian(const VertexMatrix& points, const LatticeHexahedron& cell, double enough);
// The least over the corners of determinant over the product of edge lengths: 1 for a box, ≤ 0 inverted.
double scaled_jacobian(const VertexMatrix& points, const LatticeHexahedron& cell);

// Pulls one point towards a plane: weight·((r·normal)² + tangential·r²), r = x − target.
struct PlaneAttraction {
  std::int32_t point = 0;
  Vec3 target = Vec3::Zero();
  Vec3 normal = Vec3::UnitZ();
  double weight = 0;
  double tangential = 0.02;
};

// Pulls a place of a quadrilateral towards a target: ½ weight |Σ β x − target|².
struct QuadAttraction {
  std::array<std::int32_t, 4> corners{};
  std::array<double, 4> beta{};
  Vec3 target = Vec3::Zero();
  double weight = 0;
};

// θ and α of the energy below.
struct EnergyShares {
  double volume = 0, angle = 0;
};

// Undoes folds best; and, for a grid that has few, what ends with better angles.
constexpr EnergyShares unfolding_shares{0.2, 0.0}, angular_shares{0.18, 0.82};

// Moves the points of a hexahedral mesh to minimise the distortion of its cells,
// (1 − θ) [(1 − α) tr(JᵀJ) / (3 χ^{2/3}) + α |J₁||J₂||J₃| / χ] + θ (1 + det²) / (2 χ), χ = (det + √(ε² + det²)) / 2,
// averaged over a cell's corners, plus attractions. The term of share α is the inverse of the scaled Jacobian: it minds
// angles and lets lengths differ. With ε = 0 a valid mesh stays valid at every step.
// Source: [Garanzha2021] eq. 3–6, with the term of share α beside.
class HexahedraOptimization {
 public:
  // `cell_lattice` (m×3) places cells into bricks that are worked on in parallel: cells of bricks that
  // do not touch share no point. `cell_height` (m) is the target length along the third axis, in units
  // of the spacing 1.
  HexahedraOptimization(std::vector<LatticeHexahedron> cells, const std::vector<Vec3i>& cell_lattice,
                        std::vector<double> cell_height);

  std::vector<PlaneAttraction> plane_attractions;
  std::vector<QuadAttraction> quad_attractions;
  std::vector<std::uint8_t> locked;  // n or empty: points that stay
  // Of an outer point of a thin layer its inner twin, else −1 (n or empty: none). The search then moves both together,
  // and the link between them by `link_length`, so that a thin layer does not slow it.
  std::vector<std::int32_t> twin;
  double link_length = 0.1;
  // With ε = 0, and with ε > 0, where volumes must weigh enough to undo folds.
  EnergyShares shares{0.02, 0.88}, folded_shares = unfolding_shares;
  // Twice as fast, where cells are not folded and not nearly so.
  bool single_precision = false;
  // Weight of each cell (m or empty: ones).
  std::vector<double> cell_weight;
  // Cells (m or empty: none) that are judged at the 3×3×3 Gauss points as well.
  std::vector<std::uint8_t> inside;

  // The least determinant at corners (and Gauss points where judged), relative to the target volume.
  double least_corner_jacobian(const VertexMatrix& points) const;

  // L-BFGS with memory 7. With epsilon = 0 the points must be valid at the start. Returns the energy.
  double minimize(VertexMatrix& points, int iterations, double epsilon) const;

 private:
  template <class Real>
  double cell_energies(const VertexMatrix& points, double epsilon, VertexMatrix& gradient, double& least) const;
  double evaluate(const VertexMatrix& points, double epsilon, VertexMatrix& gradient, double& least) const;

  std::vector<LatticeHexahedron> cells_;
  std::vector<double> inverse_height_;
  // Cells near each other, the points they have, and the cells' corners among these.
  struct Brick {
    std::vector<std::int32_t> cells, points;
    std::vector<std::array<std::uint16_t, 8>> corners;
  };
  std::vector<std::vector<Brick>> colours_;
};

}  // namespace shellgrid
