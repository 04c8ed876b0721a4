// SPDX-License-Identifier: AGPL-3.0-or-later
// Convergence factors of the multigrid cycle, printed case by case: of the cycle alone, its energy norm's asymptotic
// reduction, and of conjugate gradients around it, the mean of those to 1e-9. SG_LONG=1 adds 64³ cells a cube, and
// SG_POLYGRID=polygrid.hdf takes an object's own grid instead of a torus's.
#include <gtest/gtest.h>

#include <cmath>
#include <cstdio>
#include <cstdlib>
#include <string>

#include "meshing/core/random.h"
#include "meshing/formats/vtkhdf_file.h"
#include "tests/support/closed_shapes.h"
#include "tests/support/diffusion_problem.h"

namespace shellgrid {
namespace {

enum class Roughness { none, voxels, blocks, octants };

CellCoefficients rough_material(const Polygrid& grid, Roughness roughness, double contrast) {
  CellCoefficients coefficients = homogeneous_coefficients(grid, test::grey_material({0.01, 1}));
  for (std::size_t k = 0; k < coefficients.absorption.size() && roughness != Roughness::none; ++k) {
    const auto cell = static_cast<Eigen::Index>(k / 8);
    const Vec3i place = grid.cell_lattice.row(cell).transpose();
    const Vec3i block = {place.x() >> 2, place.y() >> 2, place.z() >> 2};
    const auto seed = static_cast<std::uint64_t>((block.z() * 4096 + block.y()) * 4096 + block.x());
    // Voxels and octants of voxels take any power of the contrast, blocks of 4³ one of its ends.
    const double share = roughness == Roughness::voxels    ? to_unit(hash64(7, static_cast<std::uint64_t>(cell)))
                         : roughness == Roughness::octants ? to_unit(hash64(7, k))
                                                           : static_cast<double>(hash64(7, seed) & 1);
    const auto factor = static_cast<float>(std::pow(contrast, share - 0.5));
    coefficients.absorption[k] *= factor;
    coefficients.reduced_extinction[k] *= factor;
  }
  return coefficients;
}

struct Factors {
  double cycle = 0, iteration = 0;
  int iterations = 0;
};

Factors measure(const Polygrid& grid, const CellCoefficients& coefficients, const std::string& what) {
  DiffusionSolver solver(grid);
  solver.set_material(coefficients, 1.5, 1e-9);
  const RunLevel& level = solver.finest();
  const std::size_t inner = level.inner_size(), outer = level.surface.size();
  // The error of A x = 0 from noise; its energy xᵀ A x.
  LevelVector<double> x(inner, outer), image(inner, outer), correction(inner, outer);
  for (int c = 0; c < 3; ++c) {
    for (std::size_t u = 0; u < inner; ++u) x.inner[c][u] = to_unit(hash64(c, u)) - 0.5;
    for (std::size_t s = 0; s < outer; ++s) x.outer[s][c] = to_unit(hash64(c + 3, s)) - 0.5;
  }
  Factors factors;
  double last = 0;
  for (int cycle = 0; cycle < 16; ++cycle) {
    apply_level(level, x, image);
    double energy = 0;
    for (int c = 0; c < 3; ++c) {
      for (std::size_t u = 0; u < inner; ++u) energy += x.inner[c][u] * image.inner[c][u];
      for (std::size_t s = 0; s < outer; ++s) energy += x.outer[s][c] * image.outer[s][c];
    }
    if (cycle > 0) factors.cycle = std::sqrt(energy / last);
    last = energy;
    solver.apply_cycle(image, correction);
    for (int c = 0; c < 3; ++c) {
      for (std::size_t u = 0; u < inner; ++u) x.inner[c][u] -= correction.inner[c][u];
      for (std::size_t s = 0; s < outer; ++s) x.outer[s][c] -= correction.outer[s][c];
    }
  }
  const DiffusionLight light = test::light_of(solver, grid, [](const Vec3& p) {
    return Double4{p.z() > 0 ? 1.0 : 0.0, 1, p.x() > 2 ? 1.0 : 0.0, 0};
  });
  const SolveReport report = solver.solve(light, 1e-9);
  factors.iterations = report.iterations;
  const std::vector<double>& residual = report.residual_history;
  factors.iteration = std::pow(residual.back() / residual.front(), 1.0 / std::max(1, report.iterations));
  std::printf("%-44s cycle %.3f, iteration %.3f (%d)\n", what.c_str(), factors.cycle, factors.iteration,
              factors.iterations);
  std::fflush(stdout);
  return factors;
}

std::vector<int> sizes() { return std::getenv("SG_LONG") ? std::vector<int>{16, 32, 64} : std::vector<int>{16, 32}; }

TEST(MultigridConvergence, OfCubesAndBallsWithThinLayers) {
  for (const double layer : {0.1, 0.01})
    for (int n : sizes()) {
      const std::string name = std::to_string(n) + "³, layer " + std::to_string(layer).substr(0, 4);
      const Polygrid cube = test::cube_grid(n, 20, layer), ball = test::ball_grid(n, 10, layer);
      const Factors of_cube = measure(cube, rough_material(cube, Roughness::none, 1), "cube " + name);
      const Factors of_ball = measure(ball, rough_material(ball, Roughness::none, 1), "ball, flat edge cells, " + name);
      EXPECT_LE(of_cube.iteration, 0.05);
      EXPECT_LE(of_ball.iteration, 0.1);
      EXPECT_LE(of_cube.cycle, 0.1);
      EXPECT_LE(of_ball.cycle, 0.2);
    }
}

// The solver takes conjugate gradients here, and a prolongation that follows the couplings.
TEST(MultigridConvergence, OfRoughMaterials) {
  for (const Roughness roughness : {Roughness::voxels, Roughness::blocks, Roughness::octants})
    for (const double contrast : {1e3, 1e6})
      for (int n : sizes()) {
        const Polygrid grid = test::cube_grid(n, 20, 0.1);
        const Factors factors = measure(grid, rough_material(grid, roughness, contrast),
                                        std::string(roughness == Roughness::voxels    ? "voxels "
                                                    : roughness == Roughness::octants ? "octants "
                                                                                      : "blocks ") +
                                            (contrast < 1e4 ? "1e3 " : "1e6 ") + std::to_string(n) + "³");
        // Pockets and threads that are narrower than a cell: no lattice of coarse points meets them all.
        const bool hardest = roughness == Roughness::octants && contrast > 1e4;
        EXPECT_LE(factors.iteration, hardest ? 0.4 : 0.2);
        EXPECT_LE(factors.cycle, hardest ? 0.9 : 0.6);
      }
}

// A torus askew to its lattice: its polycube has stairs, and its grid the flat edge cells of any object's.
Polygrid skew_torus() {
  const TriangleMesh surface = shapes::rotated(shapes::torus(20, 8, 128, 64), 3);
  PolycubeOptions options;
  options.nodes = 2e4;
  return build_polygrid(build_voxel_polycube(surface, options), surface, {});
}

TEST(MultigridConvergence, OfAnObjectsGrid) {
  const char* path = std::getenv("SG_POLYGRID");
  const Polygrid grid = path ? read_polygrid(path) : skew_torus();
  const Factors factors = measure(grid, rough_material(grid, Roughness::none, 1), path ? path : "torus");
  EXPECT_LE(factors.iteration, 0.2);
  EXPECT_LE(factors.cycle, 0.2);
}

}  // namespace
}  // namespace shellgrid
