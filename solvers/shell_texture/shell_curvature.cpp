// SPDX-License-Identifier: AGPL-3.0-or-later
#include "solvers/shell_texture/shell_curvature.h"

#include <algorithm>
#include <cmath>
#include <memory>

#include "meshing/core/error.h"
#include "meshing/core/parallel.h"
#include "solvers/shell_texture/core_light.h"
#include "solvers/shell_texture/shell_column.h"

namespace shellgrid {

namespace {

constexpr double least_bend = -1, greatest_bend = 0.75;  // H times the thickness
constexpr int bend_steps = 28;
constexpr double least_mending = 0.5;
constexpr double least_ratio = 0.25, greatest_ratio = 4;
constexpr double reach_of_bends = 0.5;  // of the thickness: edge of the pieces that curvature is told of

float ratio(double bent, double flat) {
  return flat > 0 ? static_cast<float>(std::clamp(bent / flat, least_ratio, greatest_ratio)) : 1.0f;
}

}  // namespace

BentShell::BentShell(const std::vector<ShellLayer>& layers, double voxel, double ior, double bend)
    : layers_(layers.size()) {
  if (layers.empty() || !(voxel > 0) || !(bend < 1))
    throw InputError("a bent shell has layers, and its bend is below 1");
  const double curvature = bend / (voxel * static_cast<double>(layers.size()));
  for (int c = 0; c < 3; ++c) {
    const ShellColumn column(layers, c, voxel, ior), white(layers, c, voxel, ior, true);
    const ShellColumn::Light flat = column.light(0), bent = column.light(curvature);
    const ShellColumn::Light even = white.light(0), bent_even = white.light(curvature);
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
