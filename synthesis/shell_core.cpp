// SPDX-License-Identifier: AGPL-3.0-or-later
#include "synthesis/shell_core.h"

#include <fmt/format.h>

#include <algorithm>
#include <array>
#include <cmath>

#include "meshing/core/error.h"
#include "meshing/core/material_fields.h"
#include "meshing/core/parallel.h"
#include "meshing/shell/voxel_boundary.h"
#include "meshing/surface/mean_value.h"
#include "synthesis/core_voxels.h"

namespace shellgrid {
namespace {

using Fields = MaterialFields;

Material shell_material(const ShellVolume& shell, const Vec3i& v) {
  return {shell.extinction.value(v.x(), v.y(), v.z()).array(), shell.albedo.value(v.x(), v.y(), v.z()).array(),
          shell.anisotropy.value(v.x(), v.y(), v.z()).array()};
}

// The core's boundary in few triangles, and at each vertex the mean of the shell voxels next to it.
struct CoreBoundary {
  TriangleMesh mesh;
  Eigen::MatrixXd values;
  Fields least = Fields::Constant(1e300), most = Fields::Constant(-1e300);
  double edge = 0;
};

CoreBoundary core_boundary(const ShellVolume& shell, const std::vector<Vec3i>& core, int triangles) {
  const TriangleMesh fine = voxel_boundary(shell.frame, core);
  // The shell's matter about each vertex of the voxels' own boundary.
  const auto n = static_cast<std::size_t>(fine.vertex_count());
  std::vector<Fields> sums(n, Fields::Zero());
  std::vector<double> weights(n, 0.0);
  parallel_for(n, [&](std::size_t v) {
    const Vec3i base = shell.frame.to_index(fine.vertex(static_cast<int>(v))).array().floor().matrix().cast<int>();
    for (int corner = 0; corner < 8; ++corner) {
      const Vec3i at = base + Vec3i(corner & 1, corner >> 1 & 1, corner >> 2);
      if (!shell.extinction.is_active(at.x(), at.y(), at.z()) || shell.kind.value(at.x(), at.y(), at.z()) == 0)
        continue;
      sums[v] += fields_of(shell_material(shell, at));
      ++weights[v];
    }
  });
  CoreBoundary boundary;
  boundary.edge = shell.frame.voxel;
  std::vector<std::int32_t> cluster;
  for (;; boundary.edge *= 1.25) {
    boundary.mesh = cluster_vertices(fine, boundary.edge, cluster);
    if (boundary.mesh.face_count() <= triangles) break;
  }
  const auto count = static_cast<std::size_t>(boundary.mesh.vertex_count());
  std::vector<Fields> merged(count, Fields::Zero());
  std::vector<double> total(count, 0.0);
  Fields all = Fields::Zero();
  double all_weight = 0;
  for (std::size_t v = 0; v < n; ++v) {
    merged[cluster[v]] += sums[v], total[cluster[v]] += weights[v];
    all += sums[v], all_weight += weights[v];
  }
  if (!(all_weight > 0)) throw InputError("the shell's bottom is free space, from which no core can be interpolated");
  boundary.values.resize(static_cast<Eigen::Index>(count), 9);
  for (std::size_t k = 0; k < count; ++k) {
    const Fields mean = total[k] > 0 ? Fields(merged[k] / total[k]) : Fields(all / all_weight);
    boundary.values.row(static_cast<Eigen::Index>(k)) = mean.matrix().transpose();
    boundary.least = boundary.least.min(mean);
    boundary.most = boundary.most.max(mean);
  }
  return boundary;
}

}  // namespace

void fill_core_by_mean_values(ShellVolume& shell, const DistanceField& distance, int triangles,
                              CoreStatistics* statistics, Progress& progress) {
  const std::size_t bytes = shell_bytes(shell);
  const std::vector<Vec3i> core = find_core_voxels(distance, shell);
  CoreStatistics figures;
  figures.voxels = static_cast<long>(core.size());
  if (!core.empty()) {
    const CoreBoundary boundary = core_boundary(shell, core, triangles);
    figures.boundary_triangles = boundary.mesh.face_count();
    figures.boundary_edge = boundary.edge;
    // Interpolated at the corners of cubes of `step` voxels, trilinearly between.
    int step = 4;
    constexpr double most_pairs = 2e8;
    while (static_cast<double>(core.size()) / std::pow(step, 3) * boundary.mesh.face_count() > most_pairs) step *= 2;
    const auto cube_of = [&](const Vec3i& v) {
      return Vec3i((v.cast<double>() / step).array().floor().matrix().cast<int>());
    };
    Vec3i lower = cube_of(core.front()), upper = lower;
    for (const Vec3i& v : core) lower = lower.cwiseMin(cube_of(v)), upper = upper.cwiseMax(cube_of(v));
    const Vec3i size = upper - lower + Vec3i::Constant(2);
    const auto corner_index = [&](const Vec3i& c) {
      return (static_cast<std::size_t>(c.x()) * size.y() + c.y()) * size.z() + c.z();
    };
    std::vector<std::int32_t> number(static_cast<std::size_t>(size.x()) * size.y() * size.z(), -1);
    std::vector<Vec3i> corners;
    for (const Vec3i& v : core)
      for (int k = 0; k < 8; ++k) {
        const Vec3i c = cube_of(v) - lower + Vec3i(k & 1, k >> 1 & 1, k >> 2);
        std::int32_t& at = number[corner_index(c)];
        if (at < 0) at = static_cast<std::int32_t>(corners.size()), corners.push_back(c);
      }
    std::vector<Fields> at_corner(corners.size());
    progress.begin("core", static_cast<long>(corners.size()));
    parallel_for(
        corners.size(),
        [&](std::size_t k) {
          const Vec3i index = (corners[k] + lower) * step;
          at_corner[k] = mean_value(boundary.mesh, boundary.values, shell.frame.to_world(index)).transpose().array();
          progress.advance();
        },
        16);
    progress.end();
    allocate_core(shell, core);
    parallel_for(core.size(), [&](std::size_t k) {
      const Vec3i v = core[k];
      const Vec3 middle = Vec3(v.x() >> 1, v.y() >> 1, v.z() >> 1) * 2 + Vec3::Constant(0.5);  // of its block
      const Vec3i cube = cube_of(v);
      const Vec3 t = (middle - (cube * step).cast<double>()) / step;
      Fields sum = Fields::Zero();
      for (int corner = 0; corner < 8; ++corner) {
        const Vec3i o(corner & 1, corner >> 1 & 1, corner >> 2);
        const double weight = (o.x() ? t.x() : 1 - t.x()) * (o.y() ? t.y() : 1 - t.y()) * (o.z() ? t.z() : 1 - t.z());
        sum += weight * at_corner[number[corner_index(cube - lower + o)]];
      }
      set_core_voxel(shell, v, material_of(sum.max(boundary.least).min(boundary.most)));
    });
  }
  figures.bytes = shell_bytes(shell) - bytes;
  if (statistics) *statistics = figures;
}

}  // namespace shellgrid
