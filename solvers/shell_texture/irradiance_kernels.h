// SPDX-License-Identifier: AGPL-3.0-or-later
// Where light that enters at one place of the sample's surface is scattered to: irradiance correction kernels.
#pragma once
#include <cstdint>
#include <vector>

#include "solvers/shell_texture/base_volume.h"

namespace shellgrid {

// Scattered fluence around the place of entry, for each of some kinds of places, by bands of depth and rings of
// distance along the surface. Source: [STF §7, irradiance correction]; there one array of voxels around the place,
// here rings, as the light enters diffusely.
struct IrradianceKernels {
  double ring = 0;               // width of a ring, mm
  int rings = 0;                 // ring k: distances of k … k + 1 widths
  std::vector<int> first_layer;  // of each band, in layers of voxels, from 0 on; the last one is the bottom's, through
                                 // which light passes into the core
  // At (kernel · bands + band) · rings + ring: per area of the ring, of all light that enters as 1. Only ratios matter.
  std::vector<Vec3f> values;
  std::vector<std::uint8_t> of_texel;  // the kernel of light that enters at texel y · n_x + x

  int bands() const { return static_cast<int>(first_layer.size()); }
  int count() const { return rings > 0 ? static_cast<int>(values.size()) / (bands() * rings) : 0; }
  bool empty() const { return values.empty(); }
  int bottom() const { return bands() - 1; }
  int band_of(int layer) const;
  // Linear between the rings' middles; 0 beyond the last. `distance`, mm.
  Vec3f value(int kernel, int band, double distance) const;
  // Within this distance all bands have at least that share of their light, mm.
  double radius(double share) const;
  // Whether the lists fit each other and a sample of that size, and hold what can be.
  bool is_sound(const Vec3i& sample) const;
  // One kernel for all texels: the mean of these, each as often as it stands for a texel.
  IrradianceKernels merged() const;
};

// What a texel's kernel depends on, a row of numbers a texel, all of one scale: the reduced coefficients of the voxels
// below it, by layer, themselves and as means about it. Empty rows where all are the same.
std::vector<std::vector<float>> kernel_domains(const BaseVolume& volume);

struct KernelOptions {
  double paths = 4e4;  // of each kernel
  std::uint64_t seed = 0;
};

// Light enters at a texel's uppermost matter, from all directions as diffuse light does.
// of_texel: numbers of kernels from 0 on, each used. Throws: InputError where the list does not have the sample's size.
IrradianceKernels trace_kernels(const BaseVolume& volume, const std::vector<std::uint8_t>& of_texel,
                                const KernelOptions& options = {});

}  // namespace shellgrid
