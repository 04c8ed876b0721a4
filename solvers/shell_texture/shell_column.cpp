// SPDX-License-Identifier: AGPL-3.0-or-later
#include "solvers/shell_texture/shell_column.h"

#include <algorithm>
#include <cmath>

#include "meshing/core/error.h"
#include "solvers/scattering/fresnel.h"

namespace shellgrid {

namespace {

constexpr int leaves_looked_at = 4000;
constexpr int rings = 8;              // of even light's directions
constexpr double cells_per_path = 4;  // cells of a layer in each mean free path
constexpr int most_cells = 32;        // of a layer
constexpr double grazing = 0.1;       // least cosine of a beam

// A symmetric tridiagonal system, `between` off its diagonal with a minus.
std::vector<double> solved(const std::vector<double>& diagonal, const std::vector<double>& between,
                           const std::vector<double>& right) {
  const std::size_t n = diagonal.size();
  std::vector<double> upper(n, 0.0), x(n, 0.0);
  for (std::size_t i = 0; i < n; ++i) {
    const double before = i > 0 ? between[i] : 0;
    const double pivot = diagonal[i] - (i > 0 ? before * upper[i - 1] : 0);
    upper[i] = between[i + 1] / pivot;
    x[i] = (right[i] + (i > 0 ? before * x[i - 1] : 0)) / pivot;
  }
  for (std::size_t i = n - 1; i-- > 0;) x[i] += upper[i] * x[i + 1];
  return x;
}

}  // namespace

std::vector<ShellLayer> shell_layers(const ShellVolume& shell) {
  const auto n = static_cast<std::size_t>(std::max(1.0, std::ceil(shell.thickness / shell.frame.voxel - 1e-6)));
  std::vector<ShellLayer> layers(n);
  std::vector<std::int64_t> counts(n, 0);
  const int leaves = shell.kind.leaf_count(), stride = leaves / leaves_looked_at + 1;
  using Kinds = TwoLevelGrid<std::int32_t>;
  for (int leaf = 0; leaf < leaves; leaf += stride)
    for (int offset = 0; offset < Kinds::leaf_size; ++offset) {
      if (!Kinds::mask_test(shell.kind.leaf_mask(leaf), offset)) continue;
      const std::int32_t kind = shell.kind.leaf_values(leaf)[offset];
      if (kind == 0 || kind == core_voxel_kind) continue;
      const float depth = shell.texture_coordinate.leaf_values(leaf)[offset].z();
      const auto layer = static_cast<std::size_t>(std::clamp(static_cast<int>(depth), 0, static_cast<int>(n) - 1));
      const Rgb extinction = shell.extinction.leaf_values(leaf)[offset].array(),
                scattering = extinction * shell.albedo.leaf_values(leaf)[offset].array(),
                forward = scattering * shell.anisotropy.leaf_values(leaf)[offset].array();
      layers[layer].extinction += extinction;
      layers[layer].reduced += extinction - forward;
      layers[layer].absorption += extinction - scattering;
      ++counts[layer];
    }
  int below = -1;
  for (int i = static_cast<int>(n) - 1; i >= 0; --i) {
    if (counts[i] > 0) {
      const auto count = static_cast<float>(counts[i]);
      layers[i].extinction /= count;
      layers[i].reduced /= count;
      layers[i].absorption /= count;
      below = i;
    } else if (below >= 0) {
      layers[i] = layers[below];
    }
  }
  if (below < 0) throw InputError("the shell holds no matter");
  // Empty layers below all others.
  for (std::size_t i = 1; i < n; ++i)
    if (counts[i] == 0 && !(layers[i].reduced > 0).any()) layers[i] = layers[i - 1];
  return layers;
}

ShellColumn::ShellColumn(const std::vector<ShellLayer>& layers, int channel, double voxel, double ior, bool white)
    : ior_(ior) {
  for (const ShellLayer& layer : layers) {
    const auto reduced = std::max(1e-9, static_cast<double>(layer.reduced[channel]));
    const int cells = std::clamp(static_cast<int>(std::ceil(cells_per_path * reduced * voxel)), 2, most_cells);
    counts_.push_back(cells);
    for (int k = 0; k < cells; ++k)
      cells_.push_back({voxel / cells, static_cast<double>(layer.extinction[channel]), reduced,
                        white ? 0.0 : std::min(reduced, static_cast<double>(layer.absorption[channel]))});
  }
  factor_ = diffuse_fresnel(ior).boundary_factor;
}

ShellColumn::Light ShellColumn::light(double curvature) const {
  const std::size_t n = cells_.size();
  const auto radius = [&](double z) { return 1 - curvature * z; };
  Light result;
  std::vector<double> beams(n, 0.0), source(n, 0.0);
  double down = 0;
  for (int ring = 0; ring < rings; ++ring) {
    const double square = (ring + 0.5) / rings, sine = std::sqrt(square) / ior_;
    double power = fresnel_transmittance(std::sqrt(1 - square), ior_) / rings, left = power, z = 0;
    for (std::size_t i = 0; i < n; ++i) {
      const Cell& cell = cells_[i];
      const double middle = radius(z + cell.height / 2), s = sine / middle;
      const double cosine = std::sqrt(std::max(grazing * grazing, 1 - s * s));
      const double optical = cell.extinction * cell.height / cosine, reduced = cell.reduced * cell.height / cosine;
      const double through = std::exp(-optical / 2);
      beams[i] += power * through / (cosine * middle * middle);
      // First scattering as isotropic matter of the reduced coefficients has it.
      const double lost = left * -std::expm1(-reduced);
      source[i] += lost * (1 - cell.absorption / cell.reduced);
      left -= lost;
      power *= through * through;
      z += cell.height;
    }
    down += left;
  }
  // D J φ' between the cells' middles; the outermost to the boundaries.
  std::vector<double> between(n + 1), diagonal(n, 0.0);
  double z = 0;
  const auto half = [&](std::size_t i) { return cells_[i].height / 2 * 3 * cells_[i].reduced; };
  for (std::size_t i = 0; i <= n; ++i) {
    const double area = radius(z) * radius(z);
    const double way = i == 0 ? 2 * factor_ + half(0) : i == n ? 2 + half(n - 1) : half(i - 1) + half(i);
    between[i] = area / way;
    if (i < n) z += cells_[i].height;
  }
  z = 0;
  for (std::size_t i = 0; i < n; ++i) {
    const double middle = radius(z + cells_[i].height / 2);
    diagonal[i] = between[i] + between[i + 1] + cells_[i].absorption * cells_[i].height * middle * middle;
    z += cells_[i].height;
  }
  const double end = radius(z) * radius(z);
  const std::vector<double> fluence = solved(diagonal, between, source);
  std::vector<double> from_below(n, 0.0);
  from_below[n - 1] = 4 * between[n];
  const std::vector<double> back = solved(diagonal, between, from_below);
  result.below = (fluence[n - 1] * between[n] + down) / end;
  result.lost = (4 - back[n - 1]) * between[n] / end;
  result.rising = back[0] * between[0];
  std::vector<double> from_above(n, 0.0);
  from_above[0] = between[0];
  const std::vector<double> diffuse = solved(diagonal, between, from_above);
  result.entering = (1 - diffuse[0]) * between[0];
  result.through = diffuse[n - 1] * between[n] / end;
  std::size_t at = 0;
  for (const int count : counts_) {
    double sums[3] = {};
    for (int k = 0; k < count; ++k, ++at) {
      sums[0] += beams[at] / count;
      sums[1] += fluence[at] / count;
      sums[2] += back[at] / count;
    }
    result.beams.push_back(sums[0]);
    result.fluence.push_back(sums[1]);
    result.back.push_back(sums[2]);
  }
  return result;
}

}  // namespace shellgrid
