// SPDX-License-Identifier: AGPL-3.0-or-later
// The paper's validity claim [STF §6]: a voxel of a synthesised shell may take its irradiance from the sample where it
// lies among the same neighbours as there, as far as twice the diffuse mean free path. Flat patches are grown with
// neighbourhoods of several sizes and traced themselves; what is traced is held against what the sample assigns.
#include <gtest/gtest.h>

#include <algorithm>
#include <cmath>
#include <cstdio>
#include <vector>

#include "meshing/core/random.h"
#include "solvers/shell_texture/irradiance_tracing.h"
#include "synthesis/surface_synthesis.h"
#include "tests/support/timing.h"
#include "tests/synthesis/synthesis_shapes.h"

namespace shellgrid {
namespace {

using test::long_form;

constexpr double voxel = 0.4;      // mm
constexpr double reach_mm = 2.05;  // diffuse mean free path of the sample's body, mm

MaterialSample spotted_wax(int size) {
  SampleDefinition definition;
  definition.width = definition.height = size;
  definition.voxel = voxel;
  definition.thickness = 3.2;
  definition.ior = 1.3;
  definition.pattern = SpotsPattern{testing::material({0.05f, 0.05f, 0.05f}, {1.5f, 1.5f, 1.5f}),
                                    testing::material({1, 0.5f, 0.2f}, {1, 1.5f, 3}),
                                    size * size / 50,
                                    1.0,
                                    0.5,
                                    0.3};
  return make_procedural_sample(definition);
}

BaseVolume volume_of(const MaterialSample& sample) {
  BaseVolume volume;
  volume.size = sample.size;
  volume.voxel = sample.voxel;
  volume.ior = sample.ior;
  volume.extinction = sample.extinction;
  volume.albedo = sample.albedo;
  volume.anisotropy = sample.anisotropy;
  volume.free.assign(sample.voxel_count(), 0);
  return volume;
}

// A square of texels, each taken from some place of the sample: texel (x, y) is `texel[y·side + x]`.
struct Patch {
  int side = 0;
  std::vector<int> texel;

  BaseVolume volume(const BaseVolume& sample) const {
    BaseVolume v = sample;
    v.size = Vec3i(side, side, sample.size.z());
    v.free.assign(v.voxel_count(), 0);
    for (auto* values : {&v.extinction, &v.albedo, &v.anisotropy}) values->resize(v.voxel_count());
    for (int z = 0; z < v.size.z(); ++z)
      for (int t = 0; t < side * side; ++t) {
        const std::size_t to = z * v.texel_count() + t, from = z * sample.texel_count() + texel[t];
        v.extinction[to] = sample.extinction[from];
        v.albedo[to] = sample.albedo[from];
        v.anisotropy[to] = sample.anisotropy[from];
      }
    return v;
  }
};

// Two estimates with independent noise: products of their differences have none on average.
struct Traced {
  ShellTexture halves[2];
};

Traced trace(const BaseVolume& volume, double paths, std::uint64_t seed) {
  IrradianceOptions options;
  options.directions = {2, 4};
  options.march_rays = 4;
  options.paths = options.most_paths = paths;
  Traced traced;
  for (int k = 0; k < 2; ++k) {
    options.seed = 2 * seed + k;
    traced.halves[k] = trace_irradiance(volume, options);
  }
  return traced;
}

// Root mean square of traced less assigned I_m, relative to the assigned, over what lies `margin` texels from the
// patch's edge.
double difference(const Traced& sample, const Traced& patch, const Patch& texels, int margin) {
  double square = 0, scale = 0;
  const ShellTexture &here = patch.halves[0], &there = sample.halves[0];
  for (int l = 0; l <= here.directions.count(); ++l)
    for (int z = 0; z < here.size.z(); ++z)
      for (int y = margin; y < texels.side - margin; ++y)
        for (int x = margin; x < texels.side - margin; ++x) {
          const int t = y * texels.side + x;
          const std::size_t to = here.at(l, z * here.texel_count() + t),
                            from = there.at(l, z * there.texel_count() + texels.texel[t]);
          Eigen::Array3f off[2];
          for (int k = 0; k < 2; ++k)
            off[k] = patch.halves[k].multiple[to].array() - sample.halves[k].multiple[from].array();
          square += static_cast<double>((off[0] * off[1]).sum());
          scale += static_cast<double>(
              (sample.halves[0].multiple[from].array() * sample.halves[1].multiple[from].array()).sum());
        }
  return std::sqrt(std::max(0.0, square) / scale);
}

// Squares of the sample, `across` texels wide, side by side, each from a place of its own.
Patch squares(int side, int across, int sample_side) {
  Patch patch{side, std::vector<int>(static_cast<std::size_t>(side) * side)};
  for (int y = 0; y < side; ++y)
    for (int x = 0; x < side; ++x) {
      const std::uint64_t square = y / across * side + x / across;
      const int u = static_cast<int>(sample_side * to_unit(hash64(7, 2 * square)));
      const int v = static_cast<int>(sample_side * to_unit(hash64(7, 2 * square + 1)));
      patch.texel[y * side + x] = (v + y) % sample_side * sample_side + (u + x) % sample_side;
    }
  return patch;
}

Patch grow(int side, const TextonSet& textons, SynthesisOptions options) {
  options.direction = Vec3(1, 0, 0);
  const SurfaceTexture texture = synthesize_surface(testing::patch(side - 1, voxel), textons, options);
  const SampleLayer& layer = textons.layers[0];
  Patch patch{side, {}};
  for (const Vec2f& at : texture.coordinate)
    patch.texel.push_back(static_cast<int>(at.y()) % layer.height * layer.width +
                          static_cast<int>(at.x()) % layer.width);
  return patch;
}

TEST(SynthesisValidity, TracedIrradianceComesToTheAssignedAsNeighbourhoodsGrow) {
  const int size = 48, side = long_form() ? 96 : 48, margin = 8;
  const double paths = long_form() ? 800 : 24;
  const MaterialSample sample = spotted_wax(size);
  const BaseVolume volume = volume_of(sample);
  const Traced assigned = trace(volume, paths, 1);
  std::printf("I_m traced against assigned, relative RMSE; twice the diffuse mean free path is %.1f texels\n",
              2 * reach_mm / voxel);
  const auto judged = [&](const char* name, int across, const Patch& patch) {
    const double error = difference(assigned, trace(patch.volume(volume), paths, 2), patch, margin);
    std::printf("%-28s %2d texels  %.4f\n", name, across, error);
    std::fflush(stdout);
    return error;
  };
  const auto falls = [](const std::vector<double>& errors) {
    for (std::size_t k = 1; k < errors.size(); ++k) EXPECT_LT(errors[k], errors[k - 1]);
  };

  std::vector<double> errors;
  for (int across = 1; across <= side / 2; across *= long_form() ? 2 : 4)
    errors.push_back(judged("squares of the sample", across, squares(side, across, size)));
  falls(errors);
  const double unlike = errors.front();
  errors.clear();
  for (const int across : {5, 10, 20}) {
    TextonOptions analysis;
    analysis.least_coarse_size = size * 5 / across;  // of windows of 5 texels, at this level the widest
    errors.push_back(judged("synthesised, windows up to", across, grow(side, make_textons(sample, analysis), {})));
  }
  falls(errors);
  EXPECT_LT(errors.back(), unlike / 3);
  EXPECT_LT(errors.back(), 0.06);
}

}  // namespace
}  // namespace shellgrid
