// SPDX-License-Identifier: AGPL-3.0-or-later
#include "synthesis/procedural_sample.h"

#include <fmt/format.h>

#include <algorithm>
#include <cmath>
#include <numbers>
#include <numeric>

#include "meshing/core/error.h"
#include "meshing/core/parallel.h"
#include "meshing/core/random.h"
#include "synthesis/periodic_noise.h"
#include "synthesis/procedural_patterns.h"
#include "synthesis/sample_builder.h"

namespace shellgrid {
namespace {

// Voxels below the top.
double bump_center_depth(const BumpsPattern& pattern, double voxel) { return pattern.radius / voxel + 0.25; }
double bump_ground(const BumpsPattern& pattern, double voxel) {
  return bump_center_depth(pattern, voxel) + pattern.lift * pattern.radius / voxel;
}

}  // namespace

void fill(MaterialSample& sample, const MarblePattern& pattern, const SampleDefinition& definition) {
  const PeriodicNoise noise(sample.size.x(), sample.size.y(), definition.seed);
  const double warp = pattern.warp / sample.voxel;
  const auto warped = [&](const Vec3& p) {
    Vec3 offset;
    for (int axis = 0; axis < 3; ++axis) offset[axis] = noise.fractal(p, 3, 4, 100 + axis);
    return Vec3(p + warp * offset);
  };
  for_each_voxel(sample, [&](std::size_t index, const Vec3& p) {
    const Vec3 q = warped(p);
    const double step = 0.75;
    const Vec3 moved[3] = {warped(p + Vec3(step, 0, 0)), warped(p + Vec3(0, step, 0)), warped(p + Vec3(0, 0, step))};
    double remaining = 1;
    for (std::size_t family = 0; family < pattern.veins.size(); ++family) {
      const VeinFamily& vein = pattern.veins[family];
      const std::uint64_t stream = 10 * (family + 1);
      // Whole waves across the sample make long strands, noise alone a network.
      const bool strands = vein.waves_x != 0 || vein.waves_y != 0;
      const auto level = [&](const Vec3& at) {
        const double web = noise.fractal(at, vein.cells, 2, stream);
        if (!strands) return web;
        const double phase =
            2 * std::numbers::pi * (vein.waves_x * at.x() / sample.size.x() + vein.waves_y * at.y() / sample.size.y());
        return std::sin(phase) + 1.4 * web;
      };
      const double value = level(q);
      Vec3 gradient;
      for (int axis = 0; axis < 3; ++axis) gradient[axis] = (level(moved[axis]) - value) / step;
      // Distance to the zero set to first order; the floor keeps flat places from swelling into blots.
      const double floor = (strands ? 4.0 : 1.2) * vein.cells / sample.size.x();
      const double distance = std::abs(value) / std::max(gradient.norm(), floor);
      const double variation = 2 * noise.fractal(p, 2 * vein.cells, 2, stream + 1);
      const double half_width = 0.5 * vein.width / sample.voxel * std::exp(vein.variation * variation);
      double presence = 1;
      if (vein.coverage < 1)
        presence = smooth_step((noise.fractal(p, std::max(1, vein.cells), 1, stream + 2) + vein.coverage - 0.5) * 5);
      // A dark heart with a soft rim, half a voxel of anti-aliasing at least.
      const double heart = smooth_step((half_width - distance) / std::max(0.5, 0.5 * half_width) + 0.5);
      const double rim = 0.4 * std::exp(-distance / (half_width + 0.5));
      remaining *= 1 - vein.strength * presence * std::max(heart, rim * rim);
    }
    Material body = pattern.body;
    const double cloud = pattern.cloudiness * 2 * noise.fractal(q, 4, 5, 1);
    const double grain = 1 + 0.08 * noise.fractal(p, sample.size.x() / 4, 1, 2);
    body = Material::from_absorption_scattering(body.absorption() * static_cast<float>(std::exp(cloud)),
                                                body.scattering() * static_cast<float>(grain), body.anisotropy);
    store_material(sample, index, mix_like_stains(body, pattern.vein, 1 - remaining));
  });
}

void fill(MaterialSample& sample, const SpotsPattern& pattern, const SampleDefinition& definition) {
  const double nx = sample.size.x(), ny = sample.size.y();
  const std::vector<Vec2> centers = spread_points(pattern.count, nx, ny, definition.seed);
  std::vector<double> depth, radius;
  RandomStream random(definition.seed, 78);
  for (std::size_t i = 0; i < centers.size(); ++i) {
    depth.push_back(random.next() * 0.5 * sample.size.z());
    radius.push_back(pattern.radius / sample.voxel * (1 + pattern.variation * (2 * random.next() - 1)));
  }
  const double softness = std::max(0.25, pattern.softness / sample.voxel);
  for_each_voxel(sample, [&](std::size_t index, const Vec3& p) {
    double inside = -1e300;  // depth inside the nearest spot, voxels
    for (std::size_t i = 0; i < centers.size(); ++i) {
      double dx = p.x() - centers[i].x(), dy = p.y() - centers[i].y();
      dx -= nx * std::round(dx / nx), dy -= ny * std::round(dy / ny);
      inside = std::max(inside, radius[i] - Vec3(dx, dy, p.z() - depth[i]).norm());
    }
    store_material(sample, index, mix_like_stains(pattern.body, pattern.spot, smooth_step(inside / softness + 0.5)));
  });
}

void fill(MaterialSample& sample, const LayersPattern& pattern, const SampleDefinition& definition) {
  const PeriodicNoise noise(sample.size.x(), sample.size.y(), definition.seed);
  for_each_voxel(sample, [&](std::size_t index, const Vec3& p) {
    const double wave = 2 * pattern.waviness * noise.fractal(Vec3(p.x(), p.y(), 0), pattern.cells, 3, 1);
    double bottom = wave;
    Material material = pattern.layers.front().material;
    for (std::size_t layer = 0; layer + 1 < pattern.layers.size(); ++layer) {
      bottom += pattern.layers[layer].thickness;
      const double below = (p.z() * sample.voxel - bottom) / sample.voxel;  // voxels below the interface
      material = mix_like_stains(material, pattern.layers[layer + 1].material, smooth_step(below + 0.5));
    }
    store_material(sample, index, material);
  });
}

void fill(MaterialSample& sample, const BumpsPattern& pattern, const SampleDefinition& definition) {
  const double nx = sample.size.x(), ny = sample.size.y();
  const std::vector<Vec2> centers = spread_points(pattern.count, nx, ny, definition.seed);
  const double radius = pattern.radius / sample.voxel;
  const double center_depth = bump_center_depth(pattern, sample.voxel), ground = bump_ground(pattern, sample.voxel);
  std::vector<Vec3f> outward(sample.voxel_count());
  for_each_voxel(sample, [&](std::size_t index, const Vec3& p) {
    double ball = 1e300, stem = 1e300;  // signed distances, voxels, negative inside
    Vec3 ball_normal = Vec3::Zero(), stem_normal = Vec3::Zero();
    for (const Vec2& center : centers) {
      double dx = p.x() - center.x(), dy = p.y() - center.y();
      dx -= nx * std::round(dx / nx), dy -= ny * std::round(dy / ny);
      const Vec3 arm(dx, dy, p.z() - center_depth);
      if (arm.norm() - radius < ball) ball = arm.norm() - radius, ball_normal = arm;
      const double across = std::hypot(dx, dy) - 0.45 * radius;
      if (p.z() > center_depth && across < stem) stem = across, stem_normal = Vec3(dx, dy, 0);
    }
    const double below_ground = ground - p.z();
    Vec3 normal = below_ground <= std::min(ball, stem) ? Vec3(0, 0, -1) : ball <= stem ? ball_normal : stem_normal;
    outward[index] = (normal.norm() > 0 ? Vec3(normal.normalized()) : Vec3(0, 0, -1)).cast<float>();
    if (std::min({ball, stem, below_ground}) > 0)
      sample.kind[index] = VoxelKind::free_space;
    else
      store_material(sample, index, ball <= 0 || stem <= 0 ? pattern.bump : pattern.body);
  });
  mark_surface(sample, &outward);
}

double needed_depth(const BumpsPattern& pattern, double voxel) { return bump_ground(pattern, voxel) * voxel; }

Vec3i procedural_sample_size(const SampleDefinition& definition) {
  const double depth = std::ceil(definition.thickness / definition.voxel - 1e-6);
  if (!(definition.width >= 4 && definition.height >= 4 && definition.width <= 2048 && definition.height <= 2048))
    throw InputError("sample size must lie between 4 and 2048 texels in x and y");
  if (!(definition.voxel > 0) || !(depth >= 1) || !(depth <= 512))
    throw InputError(
        fmt::format("a thickness of {:.6g} mm and voxels of {:.6g} mm make {:.6g} layers; expected 1 to 512",
                    definition.thickness, definition.voxel, depth));
  const double needed =
      std::visit([&](const auto& pattern) { return needed_depth(pattern, definition.voxel); }, definition.pattern);
  const double layers = std::ceil(needed / definition.voxel + 1);
  if (needed > 0 && layers > depth)
    throw InputError(
        fmt::format("the surface's relief reaches {:.4g} mm deep, the thickness is only {:.4g} mm; make it at least "
                    "{:.4g} mm, or the relief lower",
                    needed, definition.thickness, layers * definition.voxel));
  return {definition.width, definition.height, static_cast<int>(depth)};
}

MaterialSample make_procedural_sample(const SampleDefinition& definition) {
  MaterialSample sample = allocate_sample(procedural_sample_size(definition), definition.voxel, definition.ior);
  std::visit(
      [&](const auto& pattern) {
        fill(sample, pattern, definition);
        if (needed_depth(pattern, definition.voxel) == 0) mark_surface(sample);
      },
      definition.pattern);
  return sample;
}

}  // namespace shellgrid
