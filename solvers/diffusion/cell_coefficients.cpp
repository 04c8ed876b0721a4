// SPDX-License-Identifier: AGPL-3.0-or-later
#include "solvers/diffusion/cell_coefficients.h"

#include <algorithm>
#include <cmath>

#include "meshing/core/error.h"
#include "meshing/core/parallel.h"
#include "solvers/diffusion/trilinear_cell.h"

namespace shellgrid {
namespace {

struct Coefficients {
  Rgb absorption, reduced_extinction;
};

Coefficients coefficients(const Material& material) {
  return {material.absorption().max(0.0f), material.reduced_extinction()};
}

void check(const Material& material, const char* what) {
  const bool finite =
      material.extinction.isFinite().all() && material.albedo.isFinite().all() && material.anisotropy.isFinite().all();
  if (!finite || (material.extinction < 0).any() || (material.albedo < 0).any() || (material.albedo > 1).any() ||
      (material.anisotropy.abs() >= 1).any())
    throw InputError(std::string(what) +
                     ": extinction must be finite and not negative, albedo in 0 … 1, anisotropy in (-1, 1)");
}

// One Gauss point's view of the shell.
class ShellSampler {
 public:
  explicit ShellSampler(const ShellVolume& shell) : shell_(shell), core_(coefficients(shell.core)) {}

  // Returns whether any sample of the shell was active.
  bool sample(const Vec3& point, Coefficients& result) const {
    const Vec3 at = shell_.frame.to_index(point);
    const Vec3 low = at.array().floor();
    const Vec3 t = at - low;
    const Vec3i base = low.cast<int>();
    result = {Rgb::Zero(), Rgb::Zero()};
    float total = 0;
    for (int corner = 0; corner < 8; ++corner) {
      const int dx = corner & 1, dy = (corner >> 1) & 1, dz = corner >> 2;
      const Vec3i index = base + Vec3i(dx, dy, dz);
      const int leaf = shell_.extinction.find_leaf(shell_.extinction.leaf_of(index.x(), index.y(), index.z()));
      if (leaf < 0) continue;
      const int offset = shell_.extinction.offset_of(index.x(), index.y(), index.z());
      if (!shell_.extinction.mask_test(shell_.extinction.leaf_mask(leaf), offset)) continue;
      const auto weight =
          static_cast<float>((dx ? t.x() : 1 - t.x()) * (dy ? t.y() : 1 - t.y()) * (dz ? t.z() : 1 - t.z()));
      Material material;
      material.extinction = shell_.extinction.leaf_values(leaf)[offset].array();
      material.albedo = shell_.albedo.value(index.x(), index.y(), index.z()).array();
      material.anisotropy = shell_.anisotropy.value(index.x(), index.y(), index.z()).array();
      const Coefficients c = coefficients(material);
      result.absorption += weight * c.absorption;
      result.reduced_extinction += weight * c.reduced_extinction;
      total += weight;
    }
    if (!(total > 1e-6f)) {
      result = core_;
      return false;
    }
    result.absorption /= total;
    result.reduced_extinction /= total;
    return true;
  }

 private:
  const ShellVolume& shell_;
  Coefficients core_;
};

// Marks the points in the shell and the cells that reach below it, and continues its bottom layer there.
CoreExtension extend_below_shell(const Polygrid& polygrid, const ShellVolume& shell, const ShellSampler& sampler) {
  std::vector<char> in_shell(polygrid.points.rows()), reaches_core(polygrid.cells.rows());
  parallel_for(in_shell.size(), [&](std::size_t p) {
    Coefficients unused;
    in_shell[p] = sampler.sample(polygrid.points.row(p).transpose(), unused);
  });
  parallel_for(reaches_core.size(), [&](std::size_t cell) {
    Coefficients unused;
    for (int a = 0; a < 8; ++a)
      if (!in_shell[polygrid.cells(cell, a)] ||
          !sampler.sample(gauss_point(polygrid, static_cast<int>(cell), a), unused))
        reaches_core[cell] = 1;
  });
  return extend_core(polygrid, shell, in_shell, reaches_core);
}

Coefficients interpolate(const Polygrid& polygrid, const CoreExtension& core, std::size_t cell, int corner) {
  const TrilinearShape& shape = TrilinearQuadrature::instance().gauss[corner];
  Coefficients sum{Rgb::Zero(), Rgb::Zero()};
  for (int a = 0; a < 8; ++a) {
    const std::int32_t point = polygrid.cells(static_cast<Eigen::Index>(cell), a);
    sum.absorption += static_cast<float>(shape.value[a]) * core.absorption[point];
    sum.reduced_extinction += static_cast<float>(shape.value[a]) * core.reduced_extinction[point];
  }
  return sum;
}

}  // namespace

Vec3 gauss_point(const Polygrid& polygrid, int cell_index, int corner) {
  const TrilinearShape& shape = TrilinearQuadrature::instance().gauss[corner];
  Vec3 point = Vec3::Zero();
  for (int a = 0; a < 8; ++a) point += shape.value[a] * polygrid.points.row(polygrid.cells(cell_index, a)).transpose();
  return point;
}

CellCoefficients homogeneous_coefficients(const Polygrid& polygrid, const Material& material) {
  check(material, "material");
  const Coefficients c = coefficients(material);
  if (!(c.reduced_extinction > 0).all())
    throw InputError("material: its reduced extinction is 0 in some channel; diffusion needs a scattering object");
  CellCoefficients result;
  const std::size_t count = 8 * static_cast<std::size_t>(polygrid.cells.rows());
  result.absorption.assign(count, c.absorption);
  result.reduced_extinction.assign(count, c.reduced_extinction);
  return result;
}

CellCoefficients sample_coefficients(const Polygrid& polygrid, const ShellVolume& shell) {
  check(shell.core, "shell's core");
  const auto cells = static_cast<std::size_t>(polygrid.cells.rows());
  const float floor = static_cast<float>(0.01 / polygrid.spacing);
  CellCoefficients result;
  result.absorption.resize(8 * cells);
  result.reduced_extinction.resize(8 * cells);
  const ShellSampler sampler(shell);
  struct Counts {
    std::int64_t shell = 0, floored = 0, bad = 0;
    Counts operator+(const Counts& o) const { return {shell + o.shell, floored + o.floored, bad + o.bad}; }
  };
  if (shell.core_interpolated) result.core = extend_below_shell(polygrid, shell, sampler);
  const Counts counts = parallel_sum(
      cells, Counts{},
      [&](std::size_t cell) {
        Counts own;
        for (int corner = 0; corner < 8; ++corner) {
          Coefficients c;
          const bool in_shell = sampler.sample(gauss_point(polygrid, static_cast<int>(cell), corner), c);
          own.shell += in_shell;
          if (!in_shell && result.core) c = interpolate(polygrid, *result.core, cell, corner);
          if (!c.absorption.isFinite().all() || !c.reduced_extinction.isFinite().all() || (c.absorption < 0).any() ||
              (c.reduced_extinction < 0).any())
            ++own.bad;
          if ((c.reduced_extinction < floor).any()) ++own.floored;
          result.absorption[8 * cell + corner] = c.absorption;
          result.reduced_extinction[8 * cell + corner] = c.reduced_extinction.max(floor);
        }
        return own;
      },
      512);
  if (counts.bad > 0)
    throw InputError("shell: " + std::to_string(counts.bad) +
                     " samples hold a coefficient that is negative or not finite");
  result.from_shell = counts.shell;
  result.floored = counts.floored;
  return result;
}

}  // namespace shellgrid
