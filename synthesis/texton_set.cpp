// SPDX-License-Identifier: AGPL-3.0-or-later
#include "synthesis/texton_set.h"

#include <algorithm>
#include <cmath>
#include <numeric>

#include "meshing/core/error.h"
#include "meshing/core/parallel.h"
#include "synthesis/albedo.h"
#include "synthesis/candidate_search.h"
#include "synthesis/clustering.h"
#include "synthesis/half_space_reflectance.h"
#include "synthesis/principal_components.h"
#include "synthesis/sample_symmetry.h"

namespace shellgrid {
namespace {

constexpr int dimension = TextonSet::dimension;

// One row for each texel of all samples, one sample after the other: seven numbers for each voxel of its stack, each
// kind of number scaled to variance one.
RowMatrixf stack_features(const std::vector<const MaterialSample*>& samples) {
  int texels = 0, nz = 0;
  float least_extinction = 1e30f;
  for (const MaterialSample* sample : samples) {
    texels += sample->size.x() * sample->size.y();
    nz = std::max(nz, sample->size.z());
    for (std::size_t i = 0; i < sample->voxel_count(); ++i)
      for (int c = 0; c < 3; ++c) {
        const float value = sample->material(i).reduced_extinction()[c];
        if (value > 0) least_extinction = std::min(least_extinction, value);
      }
  }
  RowMatrixf rows(texels, 7 * nz);
  Eigen::Index first = 0;
  for (const MaterialSample* sample : samples) {
    const std::size_t layer = static_cast<std::size_t>(sample->size.x()) * sample->size.y();
    parallel_for(layer, [&](std::size_t texel) {
      const Eigen::Index row = first + static_cast<Eigen::Index>(texel);
      for (int z = 0; z < nz; ++z) {
        const std::size_t index = static_cast<std::size_t>(std::min(z, sample->size.z() - 1)) * layer + texel;
        const Material material = sample->material(index);
        const Rgb extinction = material.reduced_extinction().max(least_extinction).log();
        const Rgb color = diffuse_color(material, sample->ior);
        for (int c = 0; c < 3; ++c) rows(row, 7 * z + c) = extinction[c], rows(row, 7 * z + 3 + c) = color[c];
        rows(row, 7 * z + 6) = sample->kind[index] == VoxelKind::free_space ? 0.0f : 1.0f;
      }
    });
    first += static_cast<Eigen::Index>(layer);
  }
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

// What belongs to the samples' texels (one a row) for those of all layers.
template <class Rows>
Rows spread_to_layers(const Rows& base, const SampleLayers& layers) {
  Rows all(layers.texel_count(), base.cols());
  all.topRows(base.rows()) = base;
  for (int step = 1; step < layers.symmetry; ++step)
    for (Eigen::Index t = 0; t < base.rows(); ++t)
      all.row(layers.turned_texel(static_cast<std::int32_t>(t), step)) = base.row(t);
  return all;
}

template <class Value>
std::vector<Value> spread_to_layers(const std::vector<Value>& base, const SampleLayers& layers) {
  std::vector<Value> all(layers.texel_count());
  std::copy(base.begin(), base.end(), all.begin());
  for (int step = 1; step < layers.symmetry; ++step)
    for (std::size_t t = 0; t < base.size(); ++t)
      all[layers.turned_texel(static_cast<std::int32_t>(t), step)] = base[t];
  return all;
}

// For each texel of all layers `count` candidates of each sample, of any turn. A turned texel's are its own, turned.
std::vector<std::int32_t> all_candidates(const RowMatrixf& appearance, const SampleLayers& layers, int count,
                                         int separation) {
  const int each = count * layers.sample_count;
  std::vector<std::int32_t> result(static_cast<std::size_t>(layers.texel_count()) * each, -1);
  std::vector<int> sources(layers.sample_count);
  std::iota(sources.begin(), sources.end(), 0);
  for (int sample = 0; sample < layers.sample_count; ++sample) {
    std::vector<int> targets;
    for (int layer = sample; layer < layers.size(); layer += layers.sample_count) targets.push_back(layer);
    const std::vector<std::int32_t> found = find_candidates(appearance, layers, sources, targets, count, separation);
    for (int step = 0; step < layers.symmetry; ++step)
      for (std::int32_t t = 0; t < layers.base_texel_count(); ++t) {
        std::int32_t* const own =
            result.data() + static_cast<std::size_t>(layers.turned_texel(t, step)) * each + sample * count;
        for (int k = 0; k < count; ++k) {
          const std::int32_t candidate = found[static_cast<std::size_t>(t) * count + k];
          own[k] = candidate < 0 ? -1 : layers.turned_texel(candidate, step);
        }
      }
  }
  return result;
}

int joint_symmetry(const RowMatrixf& maps, const SampleLayers& layers, std::uint64_t seed,
                   TextonStatistics* statistics) {
  int symmetry = 4;
  for (int s = 0; s < layers.sample_count; ++s) {
    const SampleLayer& layer = layers[s];
    const SampleSymmetry found =
        find_symmetry(maps.middleRows(layer.first, layer.texel_count()), layer.width, layer.height, seed);
    symmetry = std::min(symmetry, found.symmetry);
    if (statistics) statistics->symmetry.push_back(found);
  }
  return symmetry;
}

std::vector<float> flatten(const RowMatrixf& rows) { return {rows.data(), rows.data() + rows.size()}; }

}  // namespace

std::vector<Vec3f> top_colors(const MaterialSample& sample) {
  const int nx = sample.size.x(), ny = sample.size.y(), nz = sample.size.z();
  std::vector<Vec3f> colors(static_cast<std::size_t>(nx) * ny, Vec3f::Zero());
  const ReflectanceInversion half_space(ReflectanceModel::transport, sample.ior);
  parallel_for(colors.size(), [&](std::size_t texel) {
    for (int z = 0; z < nz; ++z) {
      const std::size_t index = static_cast<std::size_t>(z) * nx * ny + texel;
      if (sample.kind[index] == VoxelKind::free_space) continue;
      colors[texel] = display_color(half_space.color(sample.material(index))).matrix();
      break;
    }
  });
  return colors;
}

TextonSet make_textons(const MaterialSample& sample, const TextonOptions& options, TextonStatistics* statistics,
                       Progress& progress) {
  return make_textons(std::vector<const MaterialSample*>{&sample}, options, statistics, progress);
}

TextonSet make_textons(const std::vector<const MaterialSample*>& samples, const TextonOptions& options,
                       TextonStatistics* statistics, Progress& progress) {
  if (samples.empty()) throw InputError("no sample was given");
  TextonSet set;
  set.voxel = samples.front()->voxel;
  set.candidate_count = options.candidate_count;
  int least = samples.front()->size.x(), fewest = 1 << 30;
  std::vector<Eigen::Vector2i> sizes;
  for (const MaterialSample* sample : samples) {
    if (std::abs(sample->voxel - set.voxel) > 1e-4 * set.voxel)
      throw InputError("one sample's voxel is " + std::to_string(set.voxel) + " mm, another's " +
                       std::to_string(sample->voxel) + " mm; they must be equal; try sg-sample --voxel");
    sizes.emplace_back(sample->size.x(), sample->size.y());
    least = std::min({least, sample->size.x(), sample->size.y()});
    fewest = std::min(fewest, sizes.back().prod());
  }
  const int separation = std::max(1, std::min(options.separation, least / 4));
  // Each excluded disc covers fewer than 4 s² texels, so enough stay for all candidates.
  if ((options.candidate_count + 1) * 4 * separation * separation > fewest)
    throw InputError("a sample of " + std::to_string(fewest) + " texels is too small for " +
                     std::to_string(options.candidate_count) + " candidates " + std::to_string(separation) +
                     " texels apart");
  int level_count = 1;
  while ((least >> level_count) >= options.least_coarse_size) ++level_count;
  progress.begin("textons", level_count + 1);

  double kept = 0;
  const RowMatrixf features = reduce_dimensions(stack_features(samples), dimension, &kept);
  if (statistics) statistics->feature_variance_kept = kept;
  set.layers = SampleLayers::make(sizes, 1);
  const int symmetry =
      options.symmetry > 0 ? options.symmetry : joint_symmetry(features, set.layers, options.seed, statistics);
  set.layers = SampleLayers::make(sizes, symmetry);
  set.features = flatten(spread_to_layers(features, set.layers));
  std::vector<Vec3f> colors;
  for (const MaterialSample* sample : samples) {
    const std::vector<Vec3f> own = top_colors(*sample);
    colors.insert(colors.end(), own.begin(), own.end());
  }
  set.color = spread_to_layers(colors, set.layers);

  RowMatrixf maps = features;
  for (int level = 0; level < level_count; ++level) {
    const int step = 1 << level;
    if (level > 0)
      for (int s = 0; s < set.layers.sample_count; ++s) {
        const SampleLayer& layer = set.layers[s];
        maps.middleRows(layer.first, layer.texel_count()) =
            blur_maps(maps.middleRows(layer.first, layer.texel_count()), layer.width, layer.height, step / 2);
      }
    const RowMatrixf spread = spread_to_layers(maps, set.layers);
    RowMatrixf windows(set.texel_count(), 25 * dimension);
    for (const SampleLayer& layer : set.layers.list)
      windows.middleRows(layer.first, layer.texel_count()) =
          weighted_windows(spread.middleRows(layer.first, layer.texel_count()), layer.width, layer.height, step);
    RowMatrixf appearance = reduce_dimensions(windows, dimension, &kept);
    if (statistics) statistics->appearance_variance_kept.push_back(kept);
    if (level == 0 || options.quantize) {
      // Where appearances become textons, a turned texel has one of its own, since it looks different.
      const Eigen::Index clustered = options.quantize ? appearance.rows() : set.layers.base_texel_count();
      const Clusters clusters = cluster(appearance.topRows(clustered), options.texton_count, 20, options.seed);
      if (level == 0) {
        set.textons = options.quantize ? clusters.labels : spread_to_layers(clusters.labels, set.layers);
        set.texton_count = static_cast<int>(clusters.centers.rows());
        if (statistics) statistics->texton_error = clusters.error;
      }
      if (options.quantize)
        for (Eigen::Index i = 0; i < appearance.rows(); ++i)
          appearance.row(i) = clusters.centers.row(clusters.labels[i]);
    }
    // Farther apart at coarse levels, as long as there is room for all candidates.
    const int room = static_cast<int>(std::sqrt(fewest / (4.0 * (set.candidate_count + 1))));
    const int apart = std::min({separation * step, std::max(separation, least / 8), room});
    set.levels.push_back({flatten(appearance), all_candidates(appearance, set.layers, set.candidate_count, apart)});
    progress.advance();
  }
  progress.end();
  return set;
}

}  // namespace shellgrid
