// SPDX-License-Identifier: AGPL-3.0-or-later
// The hexahedron whose octants conduct differently: trilinear within each octant; between its corners the fluence
// follows what the octants about that place conduct.
// Source: [HouWu1997 §2] (elements that resolve the coefficients inside of them). Deviates: a place between corners
// takes their mean, each weighted by its octant's D, which is exact across layers, along them, and for equal octants,
// where it is the trilinear hexahedron. One D a Gauss point in the trilinear one conducts across an insulating layer
// what the other octants do, and has vectors that are not constant and yet cost almost nothing.
#pragma once
#include "solvers/diffusion/lattice_runs.h"

namespace shellgrid {

// Greatest ratio of two octants' D up to which a cell stays the plain trilinear one.
inline constexpr float divided_contrast = 20;

// ∫ ∂_k h_a ∂_l h_b over the unit cube (+ the same with k, l exchanged where they differ); corners by bits. Metrics
// here hold xx, yy, zz, xy, xz, yz.
struct OctantIntegrals {
  float value[28][6] = {};
  constexpr OctantIntegrals() {
    constexpr int axes[6][2] = {{0, 0}, {1, 1}, {2, 2}, {0, 1}, {0, 2}, {1, 2}};
    int pair = 0;
    for (int a = 0; a < 8; ++a)
      for (int b = a + 1; b < 8; ++b, ++pair) {
        const auto sign = [](int corner, int axis) { return corner >> axis & 1 ? 1.0f : -1.0f; };
        const auto mass = [&](int axis) { return (a ^ b) >> axis & 1 ? 1.0f / 6 : 1.0f / 3; };
        for (int m = 0; m < 6; ++m) {
          const int k = axes[m][0], l = axes[m][1];
          if (k == l)
            value[pair][m] = sign(a, k) * sign(b, k) * mass((k + 1) % 3) * mass((k + 2) % 3);
          else
            value[pair][m] = 0.25f * mass(3 - k - l) * (sign(a, k) * sign(b, l) + sign(a, l) * sign(b, k));
        }
      }
  }
};
inline constexpr OctantIntegrals octant_integrals;

// `metric`: of each octant det J J⁻¹ J⁻ᵀ / 8 at its Gauss point, in the cell's reference coordinates; `coupling`:
// −∫ D ∇ψ_a·∇ψ_b of each pair a < b; `loss`: of each octant what it absorbs; `absorption`: ∫ σ_a ψ_a.
template <class Value>
void divided_element(const Value (&metric)[8][6], const Value (&diffusion)[8], const Value (&loss)[8],
                     Value (&coupling)[28], Value (&absorption)[8]) {
  // Of the node between corners along `between` of the axes, from the side that `corner` has along the others.
  Value share[8][8];  // of a corner among those that its node takes from: [between][corner]
  for (int between = 0; between < 8; ++between)
    for (int first = 0; first < 8; ++first) {
      if (first & between) continue;
      Value total = Value{};
      for (int p = 0; p < 8; ++p)
        if ((p & ~between) == first) total += diffusion[p];
      const Value inverse = 1.0f / total;
      for (int p = 0; p < 8; ++p)
        if ((p & ~between) == first) share[between][p] = diffusion[p] * inverse;
    }
  for (Value& c : coupling) c = Value{};
  for (Value& a : absorption) a = Value{};
  for (int q = 0; q < 8; ++q) {
    Value weight[8][8];  // of the octant's node, of the cell's corner
    for (int n = 0; n < 8; ++n)
      for (int p = 0; p < 8; ++p) weight[n][p] = ((p ^ q) & ~(n ^ q)) == 0 ? share[n ^ q][p] : Value{};
    Value own[28];
    for (int pair = 0; pair < 28; ++pair) {
      Value sum = octant_integrals.value[pair][0] * metric[q][0];
      for (int m = 1; m < 6; ++m) sum += octant_integrals.value[pair][m] * metric[q][m];
      own[pair] = -4.0f * diffusion[q] * sum;
    }
    // What flows from each node, as differences: they are exact where nothing does.
    for (int p = 0; p < 8; ++p) {
      Value flow[8];
      for (Value& f : flow) f = Value{};
      int pair = 0;
      for (int a = 0; a < 8; ++a)
        for (int b = a + 1; b < 8; ++b, ++pair) {
          const Value part = own[pair] * (weight[a][p] - weight[b][p]);
          flow[a] += part;
          flow[b] -= part;
        }
      for (int r = p + 1; r < 8; ++r) {
        Value sum = weight[0][r] * flow[0];
        for (int n = 1; n < 8; ++n) sum += weight[n][r] * flow[n];
        coupling[p * (15 - p) / 2 + r - p - 1] -= sum;
      }
    }
    for (int n = 0; n < 8; ++n)
      for (int p = 0; p < 8; ++p)
        if (((p ^ q) & ~(n ^ q)) == 0) absorption[p] += 0.125f * loss[q] * weight[n][p];
  }
}

}  // namespace shellgrid
