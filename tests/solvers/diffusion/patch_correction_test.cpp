// SPDX-License-Identifier: AGPL-3.0-or-later
#include "solvers/diffusion/patch_correction.h"

#include <gtest/gtest.h>
#include <tbb/global_control.h>

#include <cmath>

#include "meshing/core/random.h"
#include "tests/support/diffusion_problem.h"

namespace shellgrid {
namespace {

constexpr int cells = 16;

// A cube of equal cells; around one of its points on the side x = 0 the next points along y come within `share` of a
// cell, `length` points along z.
Polygrid squeezed_cube(double share, int length) {
  Polygrid grid = test::cube_grid(cells, 20, 0.1);
  for (Eigen::Index p = 0; p < grid.points.rows(); ++p) {
    const Vec3i at = grid.point_lattice.row(p).transpose();
    if (at.x() > 1 || at.y() != 8 || std::abs(at.z() - 7) > length) continue;
    grid.points(p, 1) -= (1 - share) * grid.spacing;
  }
  return grid;
}

struct Prepared {
  Polygrid grid;
  DiffusionSolver solver;
  RunLevel& level;
  PatchCorrection patches;

  explicit Prepared(Polygrid made)
      : grid(std::move(made)), solver(grid), level(const_cast<RunLevel&>(solver.finest())) {
    solver.set_material(homogeneous_coefficients(grid, test::grey_material({0.01, 1})), 1.5, 1e-9);
    patches.prepare(level);
  }
};

// Noise, another one for each seed.
void fill(LevelVector<float>& x, std::size_t inner, std::uint64_t seed) {
  for (int c = 0; c < 3; ++c) {
    for (std::size_t u = 0; u < inner; ++u) x.inner[c][u] = static_cast<float>(to_unit(hash64(seed, c, u)) - 0.5);
    for (std::size_t s = 0; s < x.outer.size(); ++s)
      x.outer[s][c] = static_cast<float>(to_unit(hash64(seed, c + 3, s)) - 0.5);
  }
}

double product(const LevelVector<float>& a, const LevelVector<float>& b, std::size_t inner) {
  double sum = 0;
  for (int c = 0; c < 3; ++c) {
    for (std::size_t u = 0; u < inner; ++u) sum += static_cast<double>(a.inner[c][u]) * b.inner[c][u];
    for (std::size_t s = 0; s < a.outer.size(); ++s) sum += static_cast<double>(a.outer[s][c]) * b.outer[s][c];
  }
  return sum;
}

void clear(LevelVector<float>& x, std::size_t inner) {
  for (int c = 0; c < 3; ++c) std::fill(x.inner[c], x.inner[c] + inner, 0.0f);
  std::fill(x.outer.begin(), x.outer.end(), Float4{});
}

// B r: what the patches make of a residual.
LevelVector<float> corrected(Prepared& p, std::uint64_t seed, bool backward) {
  const std::size_t inner = p.level.inner_size();
  clear(p.level.x, inner);
  fill(p.level.right_side, inner, seed);
  p.patches.apply(p.level, true, backward);
  LevelVector<float> result(inner, p.level.surface.size());
  for (int c = 0; c < 3; ++c) std::copy(p.level.x.inner[c], p.level.x.inner[c] + inner, result.inner[c]);
  result.outer = p.level.x.outer;
  return result;
}

TEST(PatchCorrection, LeavesEvenCellsAlone) {
  Prepared cube(test::cube_grid(cells, 20, 0.1));
  EXPECT_LT(cube.patches.points(), cube.level.size() / 100);
  Prepared ball(test::ball_grid(cells, 10, 0.1));
  EXPECT_LT(ball.patches.points(), ball.level.size() / 10);
}

TEST(PatchCorrection, FindsWhereCellsAreSqueezed) {
  Prepared p(squeezed_cube(0.01, 2));
  ASSERT_FALSE(p.patches.empty());
  const LevelVector<float> x = corrected(p, 1, false);
  int squeezed = 0;
  for (std::size_t u = 0; u < p.level.inner_size(); ++u) {
    const Vec3i at = p.grid.point_lattice.row(p.level.layout.point_of[u]).transpose();
    if (at.x() > 0 || at.y() != 8 || std::abs(at.z() - 7) > 1) continue;
    ++squeezed;
    EXPECT_NE(x.inner[0][u], 0) << at.transpose();
  }
  EXPECT_EQ(squeezed, 3);
}

// What is left of the residual of one patch's points is rounding.
TEST(PatchCorrection, SolvesAPatchExactly) {
  Prepared p(squeezed_cube(0.01, 1));
  const std::size_t inner = p.level.inner_size();
  const LevelVector<float> x = corrected(p, 2, false);
  LevelVector<float> image(inner, p.level.surface.size());
  apply_level(p.level, x, image, true);
  std::size_t touched = 0;
  double worst = 0;
  for (std::size_t s = 0; s < x.outer.size(); ++s) {
    if (x.outer[s][0] == 0) continue;
    ++touched;
    for (int c = 0; c < 3; ++c)
      worst = std::max<double>(worst, std::abs(p.level.right_side.outer[s][c] - image.outer[s][c]));
  }
  ASSERT_GT(touched, 0u);
  EXPECT_LT(worst, 2e-3);  // couplings reach a thousand times the residual
}

TEST(PatchCorrection, OrdersAreEachOthersTransposes) {
  Prepared p(squeezed_cube(0.01, 5));
  const std::size_t inner = p.level.inner_size();
  const LevelVector<float> forward = corrected(p, 3, false), backward = corrected(p, 4, true);
  LevelVector<float> a(inner, p.level.surface.size()), b(inner, p.level.surface.size());
  fill(a, inner, 3);
  fill(b, inner, 4);
  const double left = product(forward, b, inner), right = product(a, backward, inner);
  EXPECT_NEAR(left, right, 1e-5 * std::sqrt(product(forward, forward, inner) * product(b, b, inner)));
  EXPECT_GT(product(forward, a, inner), 0);
}

TEST(PatchCorrection, IsTheSameAtAnyThreadCount) {
  std::vector<float> first;
  for (const std::size_t threads : {1, 3}) {
    const tbb::global_control limit(tbb::global_control::max_allowed_parallelism, threads);
    Prepared p(squeezed_cube(0.01, 5));
    const LevelVector<float> x = corrected(p, 5, false);
    const std::vector<float> values(x.inner[1], x.inner[1] + p.level.inner_size());
    if (first.empty())
      first = values;
    else
      EXPECT_EQ(first, values);
  }
}

// Without patches it is up to .34.
TEST(PatchCorrection, KeepsTheCycleFastWhereCellsAreSqueezed) {
  for (const double share : {0.2, 0.05, 0.01})
    for (const int length : {0, 2, 6}) {
      const Polygrid grid = squeezed_cube(share, length);
      DiffusionSolver solver(grid);
      solver.set_material(homogeneous_coefficients(grid, test::grey_material({0.01, 1})), 1.5, 1e-9);
      const DiffusionLight light = test::light_of(solver, grid, [](const Vec3& x) {
        return Double4{x.x() < 1 ? 1.0 : 0.0, 1, x.y(), 0};
      });
      const SolveReport report = solver.solve(light, 1e-9);
      const std::vector<double>& residual = report.residual_history;
      const double factor = std::pow(residual.back() / residual.front(), 1.0 / std::max(1, report.iterations));
      std::printf("squeezed to %.2f, %d long: factor %.3f an iteration\n", share, 2 * length + 1, factor);
      EXPECT_LT(factor, 0.05);
    }
}

}  // namespace
}  // namespace shellgrid
