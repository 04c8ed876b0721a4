// SPDX-License-Identifier: AGPL-3.0-or-later
#include "solvers/transport/core_voxels.h"

#include <algorithm>
#include <array>
#include <cmath>
#include <string>
#include <vector>

#include "meshing/core/error.h"
#include "meshing/core/material_fields.h"
#include "meshing/core/parallel.h"

namespace shellgrid {
namespace {

using Fields = MaterialFields;

const std::array<Vec3i, 6> sides = {-Vec3i::UnitX(), Vec3i::UnitX(),  -Vec3i::UnitY(),
                                    Vec3i::UnitY(),  -Vec3i::UnitZ(), Vec3i::UnitZ()};

// A dense box of voxels or blocks about the shell.
struct Box {
  Vec3i lower, size;
  std::size_t count() const { return static_cast<std::size_t>(size.x()) * size.y() * size.z(); }
  bool contains(const Vec3i& v) const {
    return ((v - lower).array() >= 0).all() && ((v - lower).array() < size.array()).all();
  }
  std::size_t index(const Vec3i& v) const {
    const Vec3i at = v - lower;
    return (static_cast<std::size_t>(at.x()) * size.y() + at.y()) * size.z() + at.z();
  }
  Vec3i place(std::size_t i) const {
    const auto y = static_cast<std::size_t>(size.y()), z = static_cast<std::size_t>(size.z());
    return lower + Vec3i(static_cast<int>(i / (y * z)), static_cast<int>(i / z % y), static_cast<int>(i % z));
  }
};

// Of 2³ voxels.
Vec3i block_of(const Vec3i& voxel) { return {voxel.x() >> 1, voxel.y() >> 1, voxel.z() >> 1}; }

// The voxels below the shell, in an order that hangs on the shell alone.
std::vector<Vec3i> find_core(const ShellVolume& shell, const Box& box, const std::vector<Vec3i>& deepest,
                             const std::function<bool(const Vec3&)>& inside) {
  const auto active = [&](const Vec3i& v) { return shell.extinction.is_active(v.x(), v.y(), v.z()); };
  std::vector<char> seen(box.count(), 0);
  std::vector<Vec3i> core;
  const auto take = [&](const Vec3i& v) {
    seen[box.index(v)] = 1;
    core.push_back(v);
  };
  for (const Vec3i& v : deepest)
    for (const Vec3i& side : sides) {
      const Vec3i n = v + side;
      if (!box.contains(n) || seen[box.index(n)] || active(n)) continue;
      if (inside(shell.frame.to_world(n))) take(n);
    }
  for (std::size_t k = 0; k < core.size(); ++k)
    for (const Vec3i& side : sides) {
      const Vec3i n = core[k] + side;
      if (!box.contains(n)) throw InputError("shell: it has a gap, through which its core reaches out of it");
      if (!seen[box.index(n)] && !active(n)) take(n);
    }
  return core;
}

// Jacobi-preconditioned conjugate gradients for Σ_j (x_i − x_j) = 0 over the neighbours j of each free block i.
void solve_laplace(const std::vector<std::array<std::int32_t, 6>>& links, const std::vector<Fields>& fixed,
                   double tolerance, std::vector<Fields>& x) {
  const std::size_t n = x.size();
  // link ≥ 0: a free block; ≤ −2: fixed block −2 − link; −1: nothing.
  const auto apply = [&](const std::vector<Fields>& from, std::vector<Fields>& to) {
    parallel_for(
        n,
        [&](std::size_t i) {
          Fields sum = Fields::Zero();
          for (const std::int32_t link : links[i]) {
            if (link == -1) continue;
            sum += from[i];
            if (link >= 0) sum -= from[static_cast<std::size_t>(link)];
          }
          to[i] = sum;
        },
        1024);
  };
  const auto dot = [&](const std::vector<Fields>& a, const std::vector<Fields>& b) {
    return parallel_sum(n, Fields(Fields::Zero()), [&](std::size_t i) { return Fields(a[i] * b[i]); });
  };
  const auto quotient = [](const Fields& a, const Fields& b) -> Fields {
    return (b.abs() > 0).select(a / b, Fields::Zero());
  };
  std::vector<Fields> source(n, Fields::Zero()), residual(n), z(n), direction(n, Fields::Zero()), image(n);
  std::vector<double> diagonal(n, 0.0);
  for (std::size_t i = 0; i < n; ++i)
    for (const std::int32_t link : links[i]) {
      diagonal[i] += link != -1;
      if (link <= -2) source[i] += fixed[static_cast<std::size_t>(-2 - link)];
    }
  const Fields size = dot(source, source);
  apply(x, image);
  for (std::size_t i = 0; i < n; ++i) residual[i] = source[i] - image[i];
  Fields last = Fields::Zero();
  constexpr int most_iterations = 5000;
  for (int iteration = 0;; ++iteration) {
    const double relative = std::sqrt(quotient(dot(residual, residual), size).maxCoeff());
    if (relative <= tolerance) return;
    if (!(relative < 1e100) || iteration >= most_iterations)
      throw NumericalError("core: no convergence after " + std::to_string(iteration) +
                           " iterations; relative residual " + std::to_string(relative));
    for (std::size_t i = 0; i < n; ++i) z[i] = residual[i] / std::max(diagonal[i], 1.0);
    const Fields energy = dot(residual, z);
    const Fields factor = iteration == 0 ? Fields(Fields::Zero()) : quotient(energy, last);
    for (std::size_t i = 0; i < n; ++i) direction[i] = z[i] + factor * direction[i];
    apply(direction, image);
    const Fields length = quotient(energy, dot(direction, image));
    for (std::size_t i = 0; i < n; ++i) {
      x[i] += length * direction[i];
      residual[i] -= length * image[i];
    }
    last = energy;
  }
}

}  // namespace

ShellVolume with_core_voxels(const ShellVolume& shell, const std::function<bool(const Vec3&)>& inside,
                             double tolerance) {
  ShellVolume result = shell;
  result.core_interpolated = false;
  const double layers = shell.thickness / shell.frame.voxel;
  const Box box{8 * shell.extinction.lower_leaf() - Vec3i::Ones(),
                8 * shell.extinction.leaf_counts() + 2 * Vec3i::Ones()};
  std::vector<Vec3i> deepest;
  shell.texture_coordinate.for_each_active([&](int i, int j, int k, const Vec3f& t) {
    if (t.z() > layers - 1 && shell.kind.value(i, j, k) != 0 && shell.extinction.is_active(i, j, k))
      deepest.emplace_back(i, j, k);
  });
  if (deepest.empty()) return result;
  const std::vector<Vec3i> core = find_core(shell, box, deepest, inside);
  if (core.empty()) return result;

  // Blocks by number: of fixed ones −2 − number, of free ones their number, −1 of others.
  const Vec3i first = block_of(box.lower);
  const Box blocks{first, block_of(box.lower + box.size - Vec3i::Ones()) - first + Vec3i::Ones()};
  std::vector<std::int32_t> number(blocks.count(), -1);
  std::vector<Fields> fixed, free;
  std::vector<double> voxels_in;
  for (const Vec3i& v : deepest) {
    std::int32_t& at = number[blocks.index(block_of(v))];
    if (at == -1) {
      at = static_cast<std::int32_t>(-2 - static_cast<std::int64_t>(fixed.size()));
      fixed.emplace_back(Fields::Zero());
      voxels_in.push_back(0);
    }
    const Material m{shell.extinction.value(v.x(), v.y(), v.z()).array(),
                     shell.albedo.value(v.x(), v.y(), v.z()).array(),
                     shell.anisotropy.value(v.x(), v.y(), v.z()).array()};
    const Fields f = fields_of(m);
    if (!f.isFinite().all() || (f.head<6>() < 0).any())
      throw InputError("shell: its bottom layer holds a coefficient that is negative or not finite");
    fixed[static_cast<std::size_t>(-2 - at)] += f;
    ++voxels_in[static_cast<std::size_t>(-2 - at)];
  }
  Fields least = Fields::Constant(1e300), most = -least, mean = Fields::Zero();
  for (std::size_t k = 0; k < fixed.size(); ++k) {
    fixed[k] /= voxels_in[k];
    least = least.min(fixed[k]);
    most = most.max(fixed[k]);
    mean += fixed[k] / static_cast<double>(fixed.size());
  }
  std::vector<Vec3i> free_blocks;
  for (const Vec3i& v : core) {
    const Vec3i block = block_of(v);
    std::int32_t& at = number[blocks.index(block)];
    if (at != -1) continue;
    at = static_cast<std::int32_t>(free_blocks.size());
    free_blocks.push_back(block);
  }
  std::vector<std::array<std::int32_t, 6>> links(free_blocks.size());
  for (std::size_t i = 0; i < free_blocks.size(); ++i)
    for (std::size_t side = 0; side < 6; ++side) {
      const Vec3i other = free_blocks[i] + sides[side];
      links[i][side] = blocks.contains(other) ? number[blocks.index(other)] : -1;
    }
  free.assign(free_blocks.size(), mean);
  solve_laplace(links, fixed, tolerance, free);
  for (Fields& f : free) f = f.max(least).min(most);

  for (const Vec3i& v : core) {
    const std::int32_t at = number[blocks.index(block_of(v))];
    const Material m =
        material_of(at >= 0 ? free[static_cast<std::size_t>(at)] : fixed[static_cast<std::size_t>(-2 - at)]);
    // Deeper than any shell.
    result.texture_coordinate.set(v.x(), v.y(), v.z(), Vec3f(0, 0, static_cast<float>(layers + 1e6)));
    result.extinction.set(v.x(), v.y(), v.z(), m.extinction.matrix());
    result.albedo.set(v.x(), v.y(), v.z(), m.albedo.min(1.0f).matrix());
    result.anisotropy.set(v.x(), v.y(), v.z(), m.anisotropy.matrix());
    result.kind.set(v.x(), v.y(), v.z(), core_voxel_kind);
  }
  return result;
}

}  // namespace shellgrid
