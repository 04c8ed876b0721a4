// SPDX-License-Identifier: AGPL-3.0-or-later
#include "synthesis/texton_set.h"

#include <algorithm>
#include <cmath>

#include "meshing/core/error.h"
#include "meshing/core/parallel.h"
#include "synthesis/albedo.h"
#include "synthesis/candidate_search.h"
#include "synthesis/clustering.h"
#include "synthesis/principal_components.h"

namespace shellgrid {
namespace {

constexpr int dimension = TextonSet::dimension;

// One row for each texel: seven numbers for each voxel of its stack, each kind of number scaled to variance one.
RowMatrixf stack_features(const MaterialSample& sample) {
  const int nx = sample.size.x(), ny = sample.size.y(), nz = sample.size.z();
  RowMatrixf rows(nx * ny, 7 * nz);
  float least_extinction = 1e30f;
  for (std::size_t i = 0; i < sample.voxel_count(); ++i)
    for (int c = 0; c < 3; ++c) {
      const float value = sample.material(i).reduced_extinction()[c];
      if (value > 0) least_extinction = std::min(least_extinction, value);
    }
  parallel_for(static_cast<std::size_t>(nx) * ny, [&](std::size_t texel) {
    for (int z = 0; z < nz; ++z) {
      const std::size_t index = static_cast<std::size_t>(z) * nx * ny + texel;
      const Material material = sample.material(index);
      const Rgb extinction = material.reduced_extinction().max(least_extinction).log();
      const Rgb color = diffuse_color(material, sample.ior);
      for (int c = 0; c < 3; ++c) rows(texel, 7 * z + c) = extinction[c], rows(texel, 7 * z + 3 + c) = color[c];
      rows(texel, 7 * z + 6) = sample.kind[index] == VoxelKind::free_space ? 0.0f : 1.0f;
    }
  });
  const int groups[3][2] = {{0, 3}, {3, 6}, {6, 7}};
  for (const auto& group : groups) {
    double variance = 0;
    for (int z = 0; z < nz; ++z)
      for (int c = group[0]; c < group[1]; ++c) {
        const Eigen::VectorXd column = rows.col(7 * z + c).cast<double>();
        variance += (column.array() - column.mean()).square().mean();
      }
    const float scale = variance > 1e-12 ? static_cast<float>(1 / std::sqrt(variance)) : 0.0f;
    for (int z = 0; z < nz; ++z) rows.middleCols(7 * z + group[0], group[1] - group[0]) *= scale;
  }
  return rows;
}

// Blurs with [1 4 6 4 1]/16 at the given step, wrapping around.
RowMatrixf blur(const RowMatrixf& maps, int width, int height, int step) {
  const float weights[5] = {1 / 16.f, 4 / 16.f, 6 / 16.f, 4 / 16.f, 1 / 16.f};
  RowMatrixf across(maps.rows(), maps.cols()), result(maps.rows(), maps.cols());
  for (int pass = 0; pass < 2; ++pass) {
    const RowMatrixf& from = pass == 0 ? maps : across;
    RowMatrixf& to = pass == 0 ? across : result;
    parallel_for(static_cast<std::size_t>(width) * height, [&](std::size_t texel) {
      const int x = static_cast<int>(texel) % width, y = static_cast<int>(texel) / width;
      to.row(texel).setZero();
      for (int k = -2; k <= 2; ++k) {
        const int sx = pass == 0 ? ((x + k * step) % width + width) % width : x;
        const int sy = pass == 1 ? ((y + k * step) % height + height) % height : y;
        to.row(texel) += weights[k + 2] * from.row(sy * width + sx);
      }
    });
  }
  return result;
}

RowMatrixf windows(const RowMatrixf& maps, int width, int height, int step) {
  RowMatrixf rows(maps.rows(), 25 * maps.cols());
  parallel_for(static_cast<std::size_t>(width) * height, [&](std::size_t texel) {
    const int x = static_cast<int>(texel) % width, y = static_cast<int>(texel) / width;
    for (int k = 0; k < 25; ++k) {
      const int dx = k % 5 - 2, dy = k / 5 - 2;
      const int sx = ((x + dx * step) % width + width) % width, sy = ((y + dy * step) % height + height) % height;
      const float weight = std::exp(-0.125f * static_cast<float>(dx * dx + dy * dy));  // σ = 2 texels, squared weight
      rows.block(texel, k * maps.cols(), 1, maps.cols()) = weight * maps.row(sy * width + sx);
    }
  });
  return rows;
}

std::vector<float> flatten(const RowMatrixf& rows) { return {rows.data(), rows.data() + rows.size()}; }

}  // namespace

std::vector<Vec3f> top_colors(const MaterialSample& sample) {
  const int nx = sample.size.x(), ny = sample.size.y(), nz = sample.size.z();
  std::vector<Vec3f> colors(static_cast<std::size_t>(nx) * ny, Vec3f::Zero());
  parallel_for(colors.size(), [&](std::size_t texel) {
    for (int z = 0; z < nz; ++z) {
      const std::size_t index = static_cast<std::size_t>(z) * nx * ny + texel;
      if (sample.kind[index] == VoxelKind::free_space) continue;
      colors[texel] = display_color(diffuse_color(sample.material(index), sample.ior)).matrix();
      break;
    }
  });
  return colors;
}

TextonSet make_textons(const MaterialSample& sample, const TextonOptions& options, TextonStatistics* statistics,
                       Progress& progress) {
  TextonSet set;
  set.width = sample.size.x();
  set.height = sample.size.y();
  set.voxel = sample.voxel;
  const int least = std::min(set.width, set.height);
  const int separation = std::max(1, std::min(options.separation, least / 4));
  // Each excluded disc covers fewer than 4 s² texels, so enough stay for all candidates.
  if ((options.candidate_count + 1) * 4 * separation * separation > set.texel_count())
    throw InputError("a sample of " + std::to_string(set.width) + " x " + std::to_string(set.height) +
                     " texels is too small for " + std::to_string(options.candidate_count) + " candidates " +
                     std::to_string(separation) + " texels apart");
  set.candidate_count = options.candidate_count;
  int level_count = 1;
  while ((least >> level_count) >= options.least_coarse_size) ++level_count;
  progress.begin("textons", level_count + 1);

  double kept = 0;
  RowMatrixf maps = reduce_dimensions(stack_features(sample), dimension, &kept);
  set.features = flatten(maps);
  if (statistics) statistics->feature_variance_kept = kept;
  set.color = top_colors(sample);
  for (int level = 0; level < level_count; ++level) {
    const int step = 1 << level;
    if (level > 0) maps = blur(maps, set.width, set.height, step / 2);
    RowMatrixf appearance = reduce_dimensions(windows(maps, set.width, set.height, step), dimension, &kept);
    if (statistics) statistics->appearance_variance_kept.push_back(kept);
    if (level == 0 || options.quantize) {
      const Clusters clusters = cluster(appearance, options.texton_count, 20, options.seed);
      if (level == 0) {
        set.textons = clusters.labels;
        set.texton_count = static_cast<int>(clusters.centers.rows());
        if (statistics) statistics->texton_error = clusters.error;
      }
      if (options.quantize)
        for (Eigen::Index i = 0; i < appearance.rows(); ++i)
          appearance.row(i) = clusters.centers.row(clusters.labels[i]);
    }
    // Farther apart at coarse levels, as long as there is room for all candidates.
    const int room = static_cast<int>(std::sqrt(set.texel_count() / (4.0 * (set.candidate_count + 1))));
    const int apart = std::min({separation * step, std::max(separation, least / 8), room});
    set.levels.push_back(
        {flatten(appearance), find_candidates(appearance, set.width, set.height, set.candidate_count, apart)});
    progress.advance();
  }
  progress.end();
  return set;
}

}  // namespace shellgrid
