// SPDX-License-Identifier: AGPL-3.0-or-later
#include "synthesis/sample_check.h"

#include <fmt/format.h>

#include <algorithm>
#include <cmath>

#include "meshing/core/error.h"
#include "meshing/core/parallel.h"
#include "synthesis/albedo.h"

namespace shellgrid {
namespace {

// What a voxel looks and weighs like, for steps between neighbours.
Eigen::Array<float, 7, 1> signature(const MaterialSample& sample, std::size_t index) {
  Eigen::Array<float, 7, 1> values;
  values.head<3>() = sample.extinction[index].array().log1p();
  values.segment<3>(3) = diffuse_color(sample.material(index), sample.ior);
  values[6] = sample.kind[index] == VoxelKind::free_space ? 1.0f : 0.0f;
  return values;
}

using Signature = Eigen::Array<float, 7, 1>;

// Mean step across the seam over the largest mean step between neighbouring slices inside.
double seam(const MaterialSample& sample, const std::vector<Signature>& signatures, int axis) {
  const int n = sample.size[axis], other = sample.size[1 - axis];
  if (n < 3) return 0;
  std::vector<double> step(n, 0.0);  // from slice i to i + 1, wrapping
  parallel_for(
      n,
      [&](std::size_t i) {
        const int here = static_cast<int>(i), next = (here + 1) % n;
        for (int z = 0; z < sample.size.z(); ++z)
          for (int j = 0; j < other; ++j) {
            const std::size_t a = axis == 0 ? sample.index(here, j, z) : sample.index(j, here, z);
            const std::size_t b = axis == 0 ? sample.index(next, j, z) : sample.index(j, next, z);
            step[i] += (signatures[a] - signatures[b]).abs().sum();
          }
      },
      1);
  const double inside = *std::max_element(step.begin(), step.end() - 1);
  const double least = 1e-6 * other * sample.size.z();
  return step.back() <= least ? 0 : step.back() / std::max(inside, least);
}

}  // namespace

void check_coefficients(const MaterialSample& sample) {
  for (std::size_t i = 0; i < sample.voxel_count(); ++i) {
    const Vec3f &extinction = sample.extinction[i], &albedo = sample.albedo[i], &anisotropy = sample.anisotropy[i];
    const bool finite = extinction.allFinite() && albedo.allFinite() && anisotropy.allFinite() &&
                        sample.normal[i].allFinite() &&
                        (sample.surface_ior.empty() || std::isfinite(sample.surface_ior[i]));
    const bool good = finite && extinction.minCoeff() >= 0 && albedo.minCoeff() >= 0 && albedo.maxCoeff() <= 1 &&
                      anisotropy.cwiseAbs().maxCoeff() < 1;
    if (good) continue;
    const auto nx = static_cast<std::size_t>(sample.size.x()), ny = static_cast<std::size_t>(sample.size.y());
    const std::string voxel = fmt::format("voxel ({}, {}, {})", i % nx, i / nx % ny, i / (nx * ny));
    if (!finite) throw InputError(voxel + " has a number that is not finite");
    throw InputError(fmt::format(
        "{} has extinction {}, albedo {}, anisotropy {}; expected extinction >= 0 per mm, albedo 0 to 1, anisotropy "
        "between -1 and 1",
        voxel, extinction.minCoeff(), albedo.maxCoeff(), anisotropy.maxCoeff()));
  }
}

SampleCheck check_sample(const MaterialSample& sample) {
  check_coefficients(sample);
  SampleCheck check;
  const std::size_t count = sample.voxel_count();
  Eigen::Array3d absorption = Eigen::Array3d::Zero(), reduced = absorption, extinction = absorption;
  std::size_t material = 0;
  int deepest = 0;
  for (std::size_t i = 0; i < count; ++i) {
    if (sample.kind[i] == VoxelKind::free_space) {
      deepest = std::max(deepest, static_cast<int>(i / sample.size.x() / sample.size.y()) + 1);
      continue;
    }
    ++material;
    absorption += sample.material(i).absorption().cast<double>();
    reduced += sample.material(i).reduced_extinction().cast<double>();
    extinction += sample.extinction[i].array().cast<double>();
  }
  if (material == 0) throw InputError("the sample holds no material, only free space");
  const double scale = 1.0 / static_cast<double>(material);
  check.diffuse_mean_free_path = (1 / (3 * absorption * reduced * scale * scale).sqrt()).cast<float>();
  check.mean_free_path = (1 / (extinction * scale)).cast<float>();
  check.mesostructure_depth = deepest * sample.voxel;
  check.free_share = 1 - static_cast<double>(material) / static_cast<double>(count);
  std::vector<Signature> signatures(count);
  parallel_for(count, [&](std::size_t i) { signatures[i] = signature(sample, i); });
  check.seam_x = seam(sample, signatures, 0);
  check.seam_y = seam(sample, signatures, 1);

  for (int axis = 0; axis < 2; ++axis) {
    const double ratio = axis == 0 ? check.seam_x : check.seam_y;
    if (ratio > SampleCheck::most_seam)
      check.complaints.push_back(
          fmt::format("not tilable in {}: the step across the wrap-around is {:.3g} times the largest inside; crop the "
                      "sample to whole periods, or mirror it",
                      "xy"[axis], ratio));
  }
  const double needed_width = 2 * check.diffuse_mean_free_path.maxCoeff();
  // The least whole number of voxels above a length.
  const auto voxels_above = [&](double length) {
    const double count = std::floor(length / sample.voxel) + 1;
    return count < 1e9 ? static_cast<int>(count) : 0;
  };
  check.least_size = Vec3i(voxels_above(needed_width), voxels_above(needed_width),
                           voxels_above(check.mesostructure_depth + 3 * check.mean_free_path.maxCoeff()));
  for (int axis = 0; axis < 2; ++axis) {
    const double width = sample.size[axis] * sample.voxel;
    if (width > needed_width) continue;
    check.complaints.push_back(
        std::isfinite(needed_width)
            ? fmt::format(
                  "n_{} = {} voxels ({:.4g} mm) is not above two diffuse mean free paths ({:.4g} mm); make it at "
                  "least {:.0f} voxels, the voxel at least {:.4g} mm, or absorption stronger",
                  "xy"[axis], sample.size[axis], width, needed_width, std::floor(needed_width / sample.voxel) + 1,
                  needed_width / sample.size[axis])
            : fmt::format("n_{} = {} voxels is not above two diffuse mean free paths, which are infinite without "
                          "absorption; give the material some absorption",
                          "xy"[axis], sample.size[axis]));
  }
  const double needed_depth = check.mesostructure_depth + 3 * check.mean_free_path.maxCoeff();
  const double depth = sample.size.z() * sample.voxel;
  if (!(depth > needed_depth))
    check.complaints.push_back(
        fmt::format("n_z = {} voxels ({:.4g} mm) is not above the mesostructure's depth and three mean free paths "
                    "({:.4g} mm); make the thickness above {:.4g} mm ({:.0f} voxels)",
                    sample.size.z(), depth, needed_depth, needed_depth, std::floor(needed_depth / sample.voxel) + 1));
  return check;
}

Material bottom_layer_mean(const MaterialSample& sample) {
  const std::size_t layer = static_cast<std::size_t>(sample.size.x()) * sample.size.y();
  Eigen::Array3d absorption = Eigen::Array3d::Zero(), scattering = absorption, forward = absorption;
  std::size_t count = 0;
  for (std::size_t i = sample.voxel_count() - layer; i < sample.voxel_count(); ++i) {
    if (sample.kind[i] == VoxelKind::free_space) continue;
    const Material material = sample.material(i);
    absorption += material.absorption().cast<double>();
    scattering += material.scattering().cast<double>();
    forward += (material.scattering() * material.anisotropy).cast<double>();
    ++count;
  }
  if (count == 0)
    throw InputError("the sample's bottom layer is free space, so it cannot give the core; make the sample deeper");
  const Rgb anisotropy = (scattering > 0).select(forward / scattering, Eigen::Array3d::Zero()).cast<float>();
  return Material::from_absorption_scattering((absorption / count).cast<float>(), (scattering / count).cast<float>(),
                                              anisotropy);
}

}  // namespace shellgrid
