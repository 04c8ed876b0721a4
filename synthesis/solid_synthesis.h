// SPDX-License-Identifier: AGPL-3.0-or-later
#pragma once
#include <array>
#include <cstdint>
#include <vector>

#include "meshing/core/progress.h"
#include "meshing/core/vec.h"

namespace shellgrid {

// Slices of a material perpendicular to one axis, all of one size; one alone is a photograph. In a slice perpendicular
// to x the columns run along y and the rows along z, to y along x and z, to z along x and y. Texel (column u, row v) of
// slice s is at ((s·height + v)·width + u), its channels one after another.
struct SliceStack {
  int width = 0, height = 0, slices = 1;
  std::vector<float> values;
  std::size_t texel_count() const { return static_cast<std::size_t>(width) * height * slices; }
};

// What a solid shall look like when it is cut perpendicular to x, y and z. Distances of texels are distances of their
// channels, so these should be comparable.
struct SolidExemplar {
  int channels = 3;
  std::array<SliceStack, 3> axes;
};

struct SolidOptions {
  Vec3i size = Vec3i(96, 96, 12);
  int window = 7;         // texels a side, odd
  int candidates = 4;     // k: similar windows remembered for each
  int coarse_passes = 8;  // on the coarsest level
  int fine_passes = 8;    // on each finer one
  double evenness = 1;    // how strongly texels and windows used too often are avoided; 0: not at all
  std::uint64_t seed = 1;
};

// Each voxel is a copy of one texel.
struct SolidTexture {
  Vec3i size = Vec3i::Zero();
  std::vector<std::uint8_t> axis;   // whose stack the texel is of
  std::vector<std::int32_t> texel;  // its index there
  std::size_t index(int x, int y, int z) const { return (static_cast<std::size_t>(z) * size.y() + y) * size.x() + x; }
};

// A solid whose slices along all three axes look like the exemplar's: from coarse to fine, each slice's windows are
// matched to the exemplar's by k-coherence, and each voxel becomes the texel, of those that the windows over it
// propose, nearest to their weighted mean; texels and windows in use more often than their share count as farther.
// Periodic in x and y, not in z. Voxel (x, y, z) is stored at (z·n_y + y)·n_x + x. The same at any thread count.
// Source: [Kopf2007], [ChenWang2010]; k-coherence from [Tong2002], discrete choice from [Han2006].
// Throws: InputError for exemplars smaller than 8 texels or without values, sizes out of range.
SolidTexture synthesize_solid(const SolidExemplar& exemplar, const SolidOptions& options,
                              Progress& progress = no_progress());

// How well a solid's slices show the exemplar, and all of it. Distances of windows (5×5) are those to the nearest one,
// over twice the variance of the exemplar's windows: what two windows drawn at random are apart. The first alone would
// praise what is smooth or always the same. Source: the two directions are those of [Simakov2008].
struct SolidQuality {
  std::array<double, 3> window_distance{};    // of the solid's slices perpendicular to x, y, z to the exemplar
  std::array<double, 3> coverage_distance{};  // of the exemplar to as many as 20000 windows of the solid's slices
  double histogram_distance = 0;              // mean distance between quantiles, over the deviation, mean of channels
};

// values: of the solid's voxels, channels one after another. count: windows per axis.
SolidQuality measure_solid(const SolidExemplar& exemplar, const Vec3i& size, const std::vector<float>& values,
                           int count = 400, std::uint64_t seed = 0);

// The values that a solid's texels have.
std::vector<float> solid_values(const SolidExemplar& exemplar, const SolidTexture& solid);

// Entropy of the texels' use over its greatest possible value: low where few are repeated.
double texel_entropy(const SolidExemplar& exemplar, const SolidTexture& solid);

}  // namespace shellgrid
