// SPDX-License-Identifier: AGPL-3.0-or-later
// Wood and Worley cells: solid blocks.
#include <cmath>
#include <numbers>

#include "meshing/core/random.h"
#include "synthesis/periodic_noise.h"
#include "synthesis/procedural_patterns.h"
#include "synthesis/sample_builder.h"

namespace shellgrid {
namespace {

int wrap(int i, int n) { return (i % n + n) % n; }

}  // namespace

void fill(MaterialSample& sample, const WoodPattern& pattern, const SampleDefinition& definition) {
  const double nx = sample.size.x(), ny = sample.size.y(), voxel = sample.voxel;
  const PeriodicNoise noise(sample.size.x(), sample.size.y(), definition.seed);
  // Fibres are cells of a lattice across the grain, drawn out along x.
  const int lengths = std::max(1, static_cast<int>(std::lround(nx * voxel / pattern.fibre_length)));
  for_each_voxel(sample, [&](std::size_t index, const Vec3& p) {
    // Along the grain everything changes slowly.
    const Vec3 along(p.x(), p.y(), p.z());
    const double drift =
        pattern.waviness / voxel * (1.4 * noise.fractal(along, 2, 2, 1) + 0.5 * noise.octave(along, 7, 2));
    // Distance from the pith; sin makes it whole across the wrap-around in y.
    const double across = ny / std::numbers::pi * std::sin(std::numbers::pi * (p.y() / ny - 0.5));
    const double radius = std::hypot(across, p.z() - pattern.pith_depth / voxel) + drift;
    const double ring = radius * voxel / pattern.ring_width;
    const double year = std::floor(ring), age = ring - year;
    // Late wood darkens towards the ring's end and ends abruptly: over a voxel.
    const double edge = std::min(1.0, (1 - age) * pattern.ring_width / voxel + 0.5);
    double late = smooth_step((age - 0.35) / 0.6);
    late *= late * edge;
    // Every year is a little different.
    const double strength =
        0.65 + 0.35 * to_unit(hash64(definition.seed, 31, static_cast<std::uint64_t>(static_cast<std::int64_t>(year))));
    Material material = mix_like_stains(pattern.body, pattern.ring, late * strength);
    // Fibres and vessels: noise of a lattice that is fine across the grain and long along it.
    double fibre = 0, vessel = 0;
    const int row = static_cast<int>(std::floor(p.y())), layer = static_cast<int>(std::floor(p.z()));
    const std::uint64_t key = hash64(definition.seed, 32);
    const std::uint64_t strand =
        hash64(key, static_cast<std::uint64_t>(wrap(row, sample.size.y())), static_cast<std::uint64_t>(layer));
    const double position = p.x() / nx * lengths + to_unit(hash64(strand, 1));
    const double cell = std::floor(position), t = smooth_step(position - cell);
    const auto value = [&](double c) {
      return to_unit(hash64(strand, 2, static_cast<std::uint64_t>(wrap(static_cast<int>(c), lengths))));
    };
    fibre = (1 - t) * value(cell) + t * value(cell + 1) - 0.5;
    vessel = to_unit(hash64(strand, 3, static_cast<std::uint64_t>(wrap(static_cast<int>(cell), lengths))));
    double darker = std::exp(2 * pattern.fibres * fibre);
    if (vessel < pattern.pores * (1 - late)) darker *= 3;
    store_material(sample, index,
                   Material::from_absorption_scattering(material.absorption() * static_cast<float>(darker),
                                                        material.scattering(), material.anisotropy));
  });
}

void fill(MaterialSample& sample, const CellsPattern& pattern, const SampleDefinition& definition) {
  const double nx = sample.size.x(), ny = sample.size.y();
  const int cells_x = pattern.cells;
  const int cells_y = std::max(1, static_cast<int>(std::lround(pattern.cells * ny / nx)));
  const Vec3 cell(nx / cells_x, ny / cells_y, nx / cells_x);  // voxels
  const std::uint64_t key = hash64(definition.seed, 41);
  const auto hash_of = [&](int i, int j, int k) {
    return hash64(hash64(key, static_cast<std::uint64_t>(wrap(i, cells_x))),
                  static_cast<std::uint64_t>(wrap(j, cells_y)),
                  static_cast<std::uint64_t>(static_cast<std::int64_t>(k)));
  };
  const double half_wall = 0.5 * pattern.wall_width / sample.voxel;
  for_each_voxel(sample, [&](std::size_t index, const Vec3& p) {
    const Vec3 base = p.cwiseQuotient(cell).array().floor();
    struct Point {
      Vec3 place;
      std::uint64_t hash;
    };
    Point points[125];
    int count = 0, nearest = 0;
    double best = 1e300;
    for (int dk = -2; dk <= 2; ++dk)
      for (int dj = -2; dj <= 2; ++dj)
        for (int di = -2; di <= 2; ++di, ++count) {
          const Vec3 corner = base + Vec3(di, dj, dk);
          const std::uint64_t hash =
              hash_of(static_cast<int>(corner.x()), static_cast<int>(corner.y()), static_cast<int>(corner.z()));
          Vec3 offset;
          for (int axis = 0; axis < 3; ++axis)
            offset[axis] = 0.5 + pattern.jitter * (to_unit(hash64(hash, static_cast<std::uint64_t>(axis))) - 0.5);
          points[count] = {(corner + offset).cwiseProduct(cell), hash};
          const double distance = (points[count].place - p).squaredNorm();
          if (distance < best) best = distance, nearest = count;
        }
    // Distance to the nearest plane halfway between the nearest point and another.
    double wall = 1e300;
    for (int i = 0; i < count; ++i) {
      if (i == nearest) continue;
      const Vec3 apart = points[i].place - points[nearest].place;
      wall = std::min(wall, (0.5 * (points[i].place + points[nearest].place) - p).dot(apart) / apart.norm());
    }
    const double tone = pattern.variation * (2 * to_unit(hash64(points[nearest].hash, 9)) - 1);
    const Material body =
        Material::from_absorption_scattering(pattern.body.absorption() * static_cast<float>(std::exp(tone)),
                                             pattern.body.scattering(), pattern.body.anisotropy);
    store_material(sample, index, mix_like_stains(body, pattern.wall, smooth_step(half_wall - wall + 0.5)));
  });
}

}  // namespace shellgrid
