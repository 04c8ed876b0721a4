// SPDX-License-Identifier: AGPL-3.0-or-later
// A tiled sample unrolled over a cylinder, resampled by nearest and by interpolated coordinates, against the sample
// itself: error by voxel size, and time.
#include <chrono>
#include <cstdio>

#include "synthesis/sample_check.h"
#include "synthesis/shell_resampling.h"
#include "tests/synthesis/unrolled_shapes.h"

using namespace shellgrid;

int main() {
  std::printf(
      "pattern,voxel_mm,coordinates,voxels,other_voxel_share,extinction_rms_over_deviation,"
      "albedo_rms_over_deviation,seconds\n");
  constexpr double edge = 12.8, depth = 1.6;
  for (const char* pattern : {"marble", "cells"})
    for (const int n : {16, 32, 64, 128}) {
      const double voxel = edge / n;
      const testing::UnrolledStrip strip(16, voxel, voxel, n);
      SampleDefinition definition = pattern[0] == 'm' ? testing::marble(n) : testing::cells(n);
      definition.voxel = voxel;
      definition.thickness = depth;
      const MaterialSample sample = make_procedural_sample(definition);
      const DistanceField field = strip.field(depth);
      for (const ShellCoordinates choice : {ShellCoordinates::nearest, ShellCoordinates::interpolated}) {
        const auto started = std::chrono::steady_clock::now();
        const ShellVolume shell =
            resample_shell(strip.mesh, field, {&sample}, bottom_layer_mean(sample), depth, choice);
        const double seconds = std::chrono::duration<double>(std::chrono::steady_clock::now() - started).count();
        long voxels = 0, other = 0;
        double squares[2] = {}, sums[2] = {}, all[2] = {};
        shell.texture_coordinate.for_each_active([&](int i, int j, int k, const Vec3f& t) {
          const Vec2f exact = strip.exact(field.frame.to_world(Vec3i(i, j, k))).cast<float>();
          const std::size_t own = sample_voxel(sample, t);
          const std::size_t right = sample_voxel(sample, Vec3f(exact.x(), exact.y(), t.z()));
          ++voxels;
          other += own != right;
          const double a[2] = {sample.material(own).reduced_extinction()[1], sample.material(own).reduced_albedo()[1]};
          const double b[2] = {sample.material(right).reduced_extinction()[1],
                               sample.material(right).reduced_albedo()[1]};
          for (int c = 0; c < 2; ++c)
            squares[c] += (a[c] - b[c]) * (a[c] - b[c]), sums[c] += b[c], all[c] += b[c] * b[c];
        });
        const auto relative = [&](int c) {
          return std::sqrt(squares[c] / (all[c] - sums[c] * sums[c] / static_cast<double>(voxels)));
        };
        std::printf("%s,%g,%s,%ld,%.4f,%.4f,%.4f,%.3f\n", pattern, voxel,
                    choice == ShellCoordinates::nearest ? "nearest" : "interpolated", voxels,
                    static_cast<double>(other) / static_cast<double>(voxels), relative(0), relative(1), seconds);
      }
    }
}
