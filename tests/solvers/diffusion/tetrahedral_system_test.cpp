// SPDX-License-Identifier: AGPL-3.0-or-later
#include "solvers/diffusion/tetrahedral_system.h"

#include <gtest/gtest.h>

#include <array>
#include <cmath>

#include "meshing/core/error.h"
#include "solvers/diffusion/closed_forms.h"
#include "tests/support/coupling_solution.h"
#include "tests/support/diffusion_problem.h"

namespace shellgrid {
namespace {

constexpr double ior = 1.4;

// Each cell of a polygrid as six tetrahedra about its diagonal.
TetrahedralMesh split(const Polygrid& grid) {
  constexpr int corner_order[8] = {0, 1, 3, 2, 4, 5, 7, 6};
  constexpr int paths[6][2] = {{1, 2}, {2, 4}, {4, 1}, {2, 1}, {4, 2}, {1, 4}};
  TetrahedralMesh mesh;
  mesh.points = grid.points;
  mesh.tetrahedra.resize(6 * grid.cells.rows(), 4);
  for (Eigen::Index c = 0; c < grid.cells.rows(); ++c) {
    std::array<std::int32_t, 8> at{};  // by the corner's place in the cell, one bit an axis
    for (int k = 0; k < 8; ++k) at[k] = grid.cells(c, corner_order[k]);
    for (int p = 0; p < 6; ++p) {
      const int first = paths[p][0], second = first | paths[p][1];
      mesh.tetrahedra.row(6 * c + p) << at[0], at[first], at[second], at[7];
      const Vec3 o = mesh.points.row(at[0]).transpose(), u = mesh.points.row(at[first]).transpose(),
                 v = mesh.points.row(at[second]).transpose(), w = mesh.points.row(at[7]).transpose();
      if ((u - o).cross(v - o).dot(w - o) < 0) std::swap(mesh.tetrahedra(6 * c + p, 1), mesh.tetrahedra(6 * c + p, 2));
    }
  }
  return mesh;
}

std::vector<Double4> solve(const DiffusionSystem& system, const std::vector<Double4>& irradiance) {
  return test::solve_coupling(system.matrix, boundary_source(system, irradiance)).values;
}

DiffusionSystem assemble(const TetrahedralMesh& mesh, const DiffusionCoefficients& material) {
  const std::size_t count = static_cast<std::size_t>(mesh.tetrahedra.rows());
  return assemble_tetrahedral_system(
      mesh, std::vector<Rgb>(count, Rgb::Constant(static_cast<float>(material.absorption))),
      std::vector<Rgb>(count, Rgb::Constant(static_cast<float>(material.absorption + material.reduced_scattering))),
      ior);
}

TEST(TetrahedralSystem, HasTheMeshsVolumeAndSurface) {
  const DiffusionSystem system = assemble(split(test::cube_grid(3, 2, 0.1)), {0.1, 1});
  EXPECT_NEAR(system.volume, 8, 1e-12);
  EXPECT_NEAR(system.surface_area, 24, 1e-12);
}

TEST(TetrahedralSystem, WhiteObjectReturnsAllLight) {
  const DiffusionSystem system = assemble(split(test::ball_grid(6, 5, 0.1)), {0, 1});
  std::vector<Double4> irradiance(system.matrix.size(), Double4{1, 1, 1, 0});
  const std::vector<Double4> fluence = solve(system, irradiance);
  for (const Double4& f : fluence) EXPECT_NEAR(f[0], fluence[0][0], 1e-6 * fluence[0][0]);
  const EnergyBalance balance = energy_balance(system, fluence, irradiance);
  EXPECT_LT(balance.relative_defect[0], 1e-9);
  EXPECT_NEAR(balance.leaving[0], balance.entering[0], 1e-9 * balance.entering[0]);
}

TEST(TetrahedralSystem, ConservesEnergyUnderLightFromOneSide) {
  const TetrahedralMesh mesh = split(test::cube_grid(8, 4, 0.1));
  const DiffusionSystem system = assemble(mesh, {0.2, 1});
  std::vector<Double4> irradiance(system.matrix.size(), Double4{});
  for (std::size_t i = 0; i < irradiance.size(); ++i)
    if (mesh.points(i, 2) > 0.9 * mesh.points.col(2).maxCoeff()) irradiance[i] = Double4{1, 0, 0, 0};
  const EnergyBalance balance = energy_balance(system, solve(system, irradiance), irradiance);
  EXPECT_GT(balance.absorbed[0], 0);
  EXPECT_LT(balance.relative_defect[0], 1e-9);
}

TEST(TetrahedralSystem, BallConvergesAtSecondOrder) {
  const DiffusionCoefficients material{0.002, 1};
  const SphereSolution exact(material, 10, ior, 1);
  double error[2];
  for (int k = 0; k < 2; ++k) {
    const TetrahedralMesh mesh = split(test::ball_grid(8 << k, 10, 0.5));
    const DiffusionSystem system = assemble(mesh, material);
    const std::vector<Double4> irradiance(system.matrix.size(), Double4{1, 1, 1, 0});
    const std::vector<Double4> exitance = boundary_exitance(system, solve(system, irradiance), irradiance);
    double sum = 0;
    for (std::size_t i = 0; i < exitance.size(); ++i) sum += system.boundary_area[i] * exitance[i][0];
    error[k] = std::abs(sum / system.surface_area / exact.exitance - 1);
  }
  EXPECT_LT(error[1], 0.01);
  EXPECT_GT(std::log2(error[0] / error[1]), 1.7);
}

TEST(TetrahedralSystem, RefusesWhatIsWrong) {
  const TetrahedralMesh mesh = split(test::cube_grid(2, 2, 0.1));
  const std::size_t count = static_cast<std::size_t>(mesh.tetrahedra.rows());
  const std::vector<Rgb> good(count, Rgb::Ones());
  EXPECT_THROW(assemble_tetrahedral_system(mesh, {}, good, ior), InputError);
  EXPECT_THROW(assemble_tetrahedral_system(mesh, good, std::vector<Rgb>(count, Rgb::Zero()), ior), InputError);
  EXPECT_THROW(assemble_tetrahedral_system({}, {}, {}, ior), InputError);
  TetrahedralMesh wrong = mesh;
  std::swap(wrong.tetrahedra(3, 0), wrong.tetrahedra(3, 1));
  EXPECT_THROW(assemble_tetrahedral_system(wrong, good, good, ior), InputError);
  wrong = mesh;
  wrong.tetrahedra(0, 0) = static_cast<int>(mesh.points.rows());
  EXPECT_THROW(assemble_tetrahedral_system(wrong, good, good, ior), InputError);
}

}  // namespace
}  // namespace shellgrid
