// SPDX-License-Identifier: AGPL-3.0-or-later
#include "solvers/diffusion/element_lanes.h"

#include <Eigen/Geometry>

#include "solvers/diffusion/divided_cell.h"

namespace shellgrid {
namespace {

using Lanes = Float16Lanes;

constexpr float near_weight = 0.78867513459481288f, far_weight = 0.21132486540518712f;

// Weight of a corner's side at a Gauss point's side.
constexpr float side_weight(int corner_side, int point_side) {
  return corner_side == point_side ? near_weight : far_weight;
}

// Gradients of the corners' shape functions at the Gauss points, in reference coordinates.
struct GaussTable {
  float gradient[8][8][3];  // point, corner, axis
  float value[8][8];
  constexpr GaussTable() : gradient(), value() {
    for (int q = 0; q < 8; ++q)
      for (int a = 0; a < 8; ++a) {
        float weight[3] = {}, slope[3] = {};
        for (int axis = 0; axis < 3; ++axis) {
          weight[axis] = side_weight(a >> axis & 1, q >> axis & 1);
          slope[axis] = a >> axis & 1 ? 1.0f : -1.0f;
        }
        value[q][a] = weight[0] * weight[1] * weight[2];
        for (int axis = 0; axis < 3; ++axis)
          gradient[q][a][axis] = slope[axis] * weight[(axis + 1) % 3] * weight[(axis + 2) % 3];
      }
  }
};
constexpr GaussTable gauss;

// Weights of the parent's corners at the child's along one axis: [child side][parent side].
struct AxisWeights {
  float w[2][2];
};
constexpr AxisWeights axis_weights(int half) {
  return half == 0 ? AxisWeights{{{1, 0}, {0.5f, 0.5f}}} : AxisWeights{{{0.5f, 0.5f}, {0, 1}}};
}

// m ← Wᵀ m W along one axis.
template <int size>
void lift_axis(Float4 (&m)[size][size], int bit, const AxisWeights& weights) {
  const auto& w = weights.w;
  for (int a = 0; a < size; ++a) {
    if (a & bit) continue;
    for (int b = 0; b < size; ++b) {
      const Float4 low = m[a][b], high = m[a | bit][b];
      m[a][b] = w[0][0] * low + w[1][0] * high;
      m[a | bit][b] = w[0][1] * low + w[1][1] * high;
    }
  }
  for (int a = 0; a < size; ++a)
    for (int b = 0; b < size; ++b) {
      if (b & bit) continue;
      const Float4 low = m[a][b], high = m[a][b | bit];
      m[a][b] = w[0][0] * low + w[1][0] * high;
      m[a][b | bit] = w[0][1] * low + w[1][1] * high;
    }
}

// Replaces the elements of those cells whose octants conduct too differently.
void divide_rough_cells(const Lanes (&metric)[8][6], const Lanes (&volume)[8], const CellLanes& cells, int channel,
                        ElementLanes& elements) {
  const Lanes(&diffusion)[8] = cells.diffusion[channel];
  Lanes least = diffusion[0], greatest = diffusion[0];
  for (int q = 1; q < 8; ++q) {
    least = least < diffusion[q] ? least : diffusion[q];
    greatest = greatest > diffusion[q] ? greatest : diffusion[q];
  }
  const auto rough = greatest > divided_contrast * least;
  bool any = false;
  for (int i = 0; i < 16; ++i) any = any || rough[i];
  if (!any) return;
  Lanes loss[8], coupling[28], absorption[8];
  for (int q = 0; q < 8; ++q) loss[q] = cells.absorption[channel][q] * volume[q];
  divided_element(metric, diffusion, loss, coupling, absorption);
  for (int k = 0; k < 28; ++k) elements.coupling[channel][k] = rough ? coupling[k] : elements.coupling[channel][k];
  for (int a = 0; a < 8; ++a) elements.absorption[channel][a] = rough ? absorption[a] : elements.absorption[channel][a];
}

}  // namespace

void core_elements(const CellLanes& cells, ElementLanes& elements) {
  for (int c = 0; c < 3; ++c) {
    for (int k = 0; k < 28; ++k) elements.coupling[c][k] = Lanes{};
    for (int a = 0; a < 8; ++a) elements.absorption[c][a] = Lanes{};
  }
  // Edges along each axis: the cell's derivative there is their bilinear mean.
  Lanes edge[3][4][3];
  for (int axis = 0; axis < 3; ++axis)
    for (int k = 0; k < 4; ++k) {
      const int low = ((k & 1) << (axis + 1) % 3) | ((k >> 1) << (axis + 2) % 3);
      for (int d = 0; d < 3; ++d) edge[axis][k][d] = cells.corner[low | 1 << axis][d] - cells.corner[low][d];
    }
  Lanes octant_metric[8][6], volume[8];
  for (int q = 0; q < 8; ++q) {
    Lanes j[3][3];  // ∂x_d / ∂ξ_axis
    for (int axis = 0; axis < 3; ++axis) {
      const int s = q >> (axis + 1) % 3 & 1, t = q >> (axis + 2) % 3 & 1;
      for (int d = 0; d < 3; ++d) {
        j[axis][d] = Lanes{};
        for (int k = 0; k < 4; ++k) j[axis][d] += side_weight(k & 1, s) * side_weight(k >> 1, t) * edge[axis][k][d];
      }
    }
    Lanes cofactor[3][3];  // rows: the reference axes
    for (int axis = 0; axis < 3; ++axis) {
      const Lanes* u = j[(axis + 1) % 3];
      const Lanes* v = j[(axis + 2) % 3];
      for (int d = 0; d < 3; ++d) cofactor[axis][d] = u[(d + 1) % 3] * v[(d + 2) % 3] - u[(d + 2) % 3] * v[(d + 1) % 3];
    }
    const Lanes determinant = j[0][0] * cofactor[0][0] + j[0][1] * cofactor[0][1] + j[0][2] * cofactor[0][2];
    const Lanes share = 0.125f / determinant;
    Lanes metric[3][3];
    for (int k = 0; k < 3; ++k)
      for (int l = k; l < 3; ++l)
        metric[k][l] = metric[l][k] = share * (cofactor[k][0] * cofactor[l][0] + cofactor[k][1] * cofactor[l][1] +
                                               cofactor[k][2] * cofactor[l][2]);
    for (int k = 0; k < 3; ++k) octant_metric[q][k] = metric[k][k];
    octant_metric[q][3] = metric[0][1];
    octant_metric[q][4] = metric[0][2];
    octant_metric[q][5] = metric[1][2];
    // ∇h_a·∇h_b det J / 8 once for the three channels.
    Lanes flux[8][3];
    for (int b = 0; b < 8; ++b)
      for (int k = 0; k < 3; ++k)
        flux[b][k] = gauss.gradient[q][b][0] * metric[k][0] + gauss.gradient[q][b][1] * metric[k][1] +
                     gauss.gradient[q][b][2] * metric[k][2];
    for (int a = 0; a < 8; ++a)
      for (int b = a + 1; b < 8; ++b) {
        const Lanes product = gauss.gradient[q][a][0] * flux[b][0] + gauss.gradient[q][a][1] * flux[b][1] +
                              gauss.gradient[q][a][2] * flux[b][2];
        for (int c = 0; c < 3; ++c) elements.coupling[c][pair_number(a, b)] -= cells.diffusion[c][q] * product;
      }
    volume[q] = 0.125f * determinant;
    for (int c = 0; c < 3; ++c) {
      const Lanes loss = cells.absorption[c][q] * volume[q];
      for (int a = 0; a < 8; ++a) elements.absorption[c][a] += gauss.value[q][a] * loss;
    }
  }
  for (int c = 0; c < 3; ++c) divide_rough_cells(octant_metric, volume, cells, c, elements);
}

void coarsen_elements(const ElementLanes& children, const std::uint8_t* octant, int count, ElementLanes& parents) {
  Lanes weight[3][2][2];
  for (int axis = 0; axis < 3; ++axis)
    for (int i = 0; i < 16; ++i) {
      const AxisWeights w = axis_weights(octant[i < count ? i : 0] >> axis & 1);
      for (int k = 0; k < 4; ++k) reinterpret_cast<float*>(&weight[axis][k >> 1][k & 1])[i] = w.w[k >> 1][k & 1];
    }
  for (int c = 0; c < 3; ++c) {
    Lanes m[8][8];
    fill_from_couplings(m, [&](int a, int b) { return children.coupling[c][pair_number(a, b)]; });
    for (int axis = 0; axis < 3; ++axis) {
      const int bit = 1 << axis;
      const auto& w = weight[axis];
      for (int a = 0; a < 8; ++a) {
        if (a & bit) continue;
        for (int b = 0; b < 8; ++b) {
          const Lanes low = m[a][b], high = m[a | bit][b];
          m[a][b] = w[0][0] * low + w[1][0] * high;
          m[a | bit][b] = w[0][1] * low + w[1][1] * high;
        }
      }
      for (int b = 0; b < 8; ++b) {
        if (b & bit) continue;
        for (int a = 0; a < 8; ++a) {
          const Lanes low = m[a][b], high = m[a][b | bit];
          m[a][b] = w[0][0] * low + w[1][0] * high;
          m[a][b | bit] = w[0][1] * low + w[1][1] * high;
        }
      }
    }
    for (int a = 0; a < 8; ++a)
      for (int b = a + 1; b < 8; ++b) parents.coupling[c][pair_number(a, b)] = m[a][b];
  }
}

void add_layer_cell(const CellCorners& corners, const Rgb* absorption, const Rgb* reduced_extinction,
                    const std::array<std::uint8_t, 8>& node, BoundaryElement& element,
                    std::array<Float4, 16>& absorbed) {
  // At a corner only it and its three neighbours along edges have gradients; VTK order.
  static constexpr int along[8][3] = {{1, 3, 4}, {0, 2, 5}, {3, 1, 6}, {2, 0, 7},
                                      {5, 7, 0}, {4, 6, 1}, {7, 5, 2}, {6, 4, 3}};
  for (int q = 0; q < 8; ++q) {
    Vec3 edge[3];
    double sign = 1;
    for (int k = 0; k < 3; ++k) {
      edge[k] = (corners.row(along[q][k]) - corners.row(q)).transpose();
      sign *= corner_coordinate[q][k] ? -1 : 1;
    }
    // Dual vectors: the neighbours' gradients times the determinant.
    const Vec3 dual[3] = {edge[1].cross(edge[2]), edge[2].cross(edge[0]), edge[0].cross(edge[1])};
    const double signed_determinant = edge[0].dot(dual[0]);
    const double determinant = sign * signed_determinant;
    const double share = 1 / (8 * determinant);
    double product[3][3];
    for (int k = 0; k < 3; ++k)
      for (int l = k; l < 3; ++l) product[k][l] = product[l][k] = share * dual[k].dot(dual[l]);
    const Float4 diffusion = 1.0f / (3.0f * (to_lanes(reduced_extinction[q]) + Float4{0, 0, 0, 1}));
    const Float4 colours = {1, 1, 1, 0};
    for (int k = 0; k < 3; ++k) {
      // With the corner itself, whose gradient is minus the neighbours' sum.
      const double with_own = -(product[k][0] + product[k][1] + product[k][2]);
      const Float4 value = colours * diffusion * static_cast<float>(-with_own);
      const int a = node[q], b = node[along[q][k]];
      if (a % 8 == b % 8)
        element.through[a % 8] += value;
      else
        element.coupling(a, b) += value;
      for (int l = k + 1; l < 3; ++l)
        element.coupling(node[along[q][k]], node[along[q][l]]) -=
            colours * diffusion * static_cast<float>(product[k][l]);
    }
    absorbed[node[q]] += to_lanes(absorption[q]) * static_cast<float>(determinant / 8);
  }
}

void add_coarse_boundary(const BoundaryElement& child, int octant, BoundaryElement& parent) {
  Float4 m[16][16];
  for (int a = 0; a < 16; ++a) m[a][a] = Float4{};
  for (int a = 0; a < 16; ++a)
    for (int b = a + 1; b < 16; ++b) {
      const Float4 value = child.coupling(a, b);
      m[a][b] = m[b][a] = value;
      m[a][a] -= value;
      m[b][b] -= value;
    }
  for (int axis = 0; axis < 3; ++axis) {
    const AxisWeights weights = axis_weights(octant >> axis & 1);
    lift_axis(m, 1 << axis, weights);
  }
  for (int a = 0; a < 16; ++a)
    for (int b = a + 1; b < 16; ++b) parent.coupling(a, b) += m[a][b];
}

}  // namespace shellgrid
