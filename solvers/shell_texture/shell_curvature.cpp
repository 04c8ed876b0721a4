// SPDX-License-Identifier: AGPL-3.0-or-later
#include "solvers/shell_texture/shell_curvature.h"

#include <algorithm>
#include <cmath>
#include <memory>

#include "meshing/core/error.h"
#include "meshing/core/parallel.h"
#include "solvers/scattering/fresnel.h"
#include "solvers/shell_texture/core_light.h"

namespace shellgrid {

namespace {

constexpr double least_bend = -1, greatest_bend = 0.75;  // H times the thickness
constexpr int bend_steps = 28;
constexpr double least_mending = 0.5;
constexpr double least_ratio = 0.25, greatest_ratio = 4;
constexpr int leaves_looked_at = 4000;
constexpr int rings = 8;                // of even light's directions
constexpr double cells_per_path = 4;    // cells of a layer in each mean free path
constexpr int most_cells = 32;          // of a layer
constexpr double grazing = 0.1;         // least cosine of a beam
constexpr double reach_of_bends = 0.5;  // of the thickness: edge of the pieces that curvature is told of

// One channel of a shell, flat or bent.
class Column {
 public:
  struct Light {
    std::vector<double> beams, fluence, back;  // means of the layers
    double below = 0, lost = 0;                // lost: of diffuse light from below what does not return
  };

  // white: as if it did not absorb.
  Column(const std::vector<ShellLayer>& layers, int channel, double voxel, double ior, bool white = false) : ior_(ior) {
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

  Light light(double curvature) const {
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

 private:
  struct Cell {
    double height, extinction, reduced, absorption;
  };

  // A symmetric tridiagonal system, `between` off its diagonal with a minus.
  static std::vector<double> solved(const std::vector<double>& diagonal, const std::vector<double>& between,
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

  double ior_, factor_ = 1;
  std::vector<int> counts_;  // of each layer's cells
  std::vector<Cell> cells_;
};

float ratio(double bent, double flat) {
  return flat > 0 ? static_cast<float>(std::clamp(bent / flat, least_ratio, greatest_ratio)) : 1.0f;
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

BentShell::BentShell(const std::vector<ShellLayer>& layers, double voxel, double ior, double bend)
    : layers_(layers.size()) {
  if (layers.empty() || !(voxel > 0) || !(bend < 1))
    throw InputError("a bent shell has layers, and its bend is below 1");
  const double curvature = bend / (voxel * static_cast<double>(layers.size()));
  for (int c = 0; c < 3; ++c) {
    const Column column(layers, c, voxel, ior), white(layers, c, voxel, ior, true);
    const Column::Light flat = column.light(0), bent = column.light(curvature);
    const Column::Light even = white.light(0), bent_even = white.light(curvature);
    // White matter in even light is as bright whatever its shape. Diffusion errs a little where light enters, and
    // not as much in both shapes: what it misses there is taken from all that is scattered.
    const double core = even.lost > 0 ? even.below / even.lost : 0;
    for (std::size_t i = 0; i < layers.size(); ++i) {
      const double scattered = bent_even.fluence[i] + core * bent_even.back[i];
      const double wanted = even.beams[i] + even.fluence[i] + core * even.back[i] - bent_even.beams[i];
      const double mended = scattered > 0 ? std::clamp(wanted / scattered, least_mending, 1 / least_mending) : 1;
      layers_[i].single[c] = ratio(bent.beams[i], flat.beams[i]);
      layers_[i].multiple[c] = ratio(mended * bent.fluence[i], flat.fluence[i]);
      layers_[i].back[c] = ratio(mended * bent.back[i], flat.back[i]);
    }
    loss_[c] = ratio(bent.lost, flat.lost);
    below_[c] = ratio(bent.below * even.below * bent_even.lost, flat.below * bent_even.below * even.lost);
  }
}

std::vector<float> mean_curvatures(const TexturedFrames& frames, double depth, double reach) {
  const std::vector<float> above = vertex_areas(frames.mesh), below = core_areas(frames, depth);
  const VertexBuckets pieces(frames, above, reach);
  std::vector<Rgb> areas(static_cast<std::size_t>(pieces.count()));
  for (int i = 0; i < pieces.count(); ++i) {
    double over = 0, under = 0;
    for (const int v : pieces[i].members) {
      over += static_cast<double>(above[v]);
      under += static_cast<double>(below[v]);
    }
    areas[i] = Rgb::Constant(over > 0 ? static_cast<float>(under / over) : 1.0f);
  }
  const std::vector<Rgb> means = at_vertices(frames, pieces, areas);
  std::vector<float> result(means.size());
  for (std::size_t v = 0; v < means.size(); ++v)
    result[v] = static_cast<float>((1 - std::sqrt(static_cast<double>(means[v][0]))) / depth);
  return result;
}

ShellCurvature::ShellCurvature(const TexturedFrames& frames, const ShellVolume& shell, double ior)
    : thickness_(shell.thickness) {
  if (!(thickness_ > 0)) throw InputError("a shell's thickness is above 0");
  curvatures_ = mean_curvatures(frames, thickness_, reach_of_bends * thickness_);
  for (float& curvature : curvatures_)
    curvature = static_cast<float>(std::clamp(static_cast<double>(curvature) * thickness_, least_bend, greatest_bend) /
                                   thickness_);
  const std::vector<ShellLayer> layers = shell_layers(shell);
  std::vector<std::unique_ptr<BentShell>> steps(bend_steps + 1);
  parallel_for(
      steps.size(),
      [&](std::size_t i) {
        const double bend = least_bend + (greatest_bend - least_bend) * static_cast<double>(i) / bend_steps;
        steps[i] = std::make_unique<BentShell>(layers, thickness_ / static_cast<double>(layers.size()), ior, bend);
      },
      1);
  for (const std::unique_ptr<BentShell>& step : steps) steps_.push_back(*step);
}

ShellCurvature::Place ShellCurvature::place_of(int vertex) const {
  const double bend = static_cast<double>(curvatures_[vertex]) * thickness_;
  const double at =
      std::clamp((bend - least_bend) / (greatest_bend - least_bend) * bend_steps, 0.0, static_cast<double>(bend_steps));
  const int step = std::min(static_cast<int>(at), bend_steps - 1);
  return {step, static_cast<float>(at - step)};
}

BentShell::Ratios ShellCurvature::at(int vertex, float depth) const {
  const Place place = place_of(vertex);
  const auto n = static_cast<int>(steps_.front().layers().size());
  const float level = std::clamp(depth - 0.5f, 0.0f, static_cast<float>(n - 1));
  const int layer = std::min(static_cast<int>(level), std::max(0, n - 2)), next = std::min(layer + 1, n - 1);
  const float part = level - static_cast<float>(layer);
  BentShell::Ratios result{Rgb::Zero(), Rgb::Zero(), Rgb::Zero()};
  const auto add = [&](const BentShell::Ratios& ratios, float weight) {
    result.single += weight * ratios.single;
    result.multiple += weight * ratios.multiple;
    result.back += weight * ratios.back;
  };
  for (int k = 0; k < 2; ++k) {
    const std::vector<BentShell::Ratios>& values = steps_[place.step + k].layers();
    const float weight = k ? place.part : 1 - place.part;
    add(values[layer], weight * (1 - part));
    add(values[next], weight * part);
  }
  return result;
}

Rgb ShellCurvature::below(int vertex) const {
  const Place place = place_of(vertex);
  return (1 - place.part) * steps_[place.step].below() + place.part * steps_[place.step + 1].below();
}

Rgb ShellCurvature::loss(int vertex) const {
  const Place place = place_of(vertex);
  return (1 - place.part) * steps_[place.step].loss() + place.part * steps_[place.step + 1].loss();
}

}  // namespace shellgrid
