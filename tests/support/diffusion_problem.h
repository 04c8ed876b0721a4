// SPDX-License-Identifier: AGPL-3.0-or-later
// A polygrid, its system and its solution, for tests of the diffusion solver.
#pragma once
#include <Eigen/LU>
#include <functional>
#include <vector>

#include "solvers/diffusion/closed_forms.h"
#include "solvers/diffusion/diffusion_solver.h"
#include "solvers/diffusion/polygrid_system.h"
#include "tests/support/polygrid_shapes.h"

namespace shellgrid::test {

// The same material in all three channels.
inline Material grey_material(const DiffusionCoefficients& c) {
  return Material::from_absorption_scattering(Rgb::Constant(static_cast<float>(c.absorption)),
                                              Rgb::Constant(static_cast<float>(c.reduced_scattering)), Rgb::Zero());
}

// Solution of a problem, at the unknowns of its system.
struct SolvedProblem {
  Polygrid grid;
  PolygridSystem system;
  std::vector<Double4> irradiance, fluence, exitance;
  SolveReport report;
  EnergyBalance energy;

  Vec3 position(std::size_t unknown) const { return grid.points.row(system.point_of_unknown[unknown]).transpose(); }
};

inline DiffusionLight light_of(const DiffusionSolver& solver, const Polygrid& grid,
                               const std::function<Double4(const Vec3&)>& light) {
  DiffusionLight result;
  for (std::int32_t point : solver.grid().outer_point)
    result.irradiance.push_back(to_float(light(grid.points.row(point).transpose())));
  return result;
}

// `light(point)`: irradiance of channel 0, 1, 2 at outer points.
inline SolvedProblem solve_problem(Polygrid grid, const CellCoefficients& coefficients, double ior,
                                   const std::function<Double4(const Vec3&)>& light, double tolerance = 1e-9) {
  SolvedProblem p;
  p.grid = std::move(grid);
  p.system = assemble_polygrid_system(p.grid, coefficients, ior);
  DiffusionSolver solver(p.grid);
  solver.set_material(coefficients, ior, tolerance);
  const DiffusionLight lit = light_of(solver, p.grid, light);
  p.report = solver.solve(lit, tolerance);
  const std::vector<Double4> fluence = solver.fluence(), exitance = solver.exitance(lit);
  const std::size_t n = fluence.size();
  p.irradiance.assign(n, Double4{});
  p.exitance.assign(n, Double4{});
  p.fluence.resize(n);
  for (std::size_t u = 0; u < n; ++u) p.fluence[u] = fluence[p.system.point_of_unknown[u]];
  for (std::size_t s = 0; s < exitance.size(); ++s) {
    const std::int32_t u = p.system.unknown_of_point[solver.grid().outer_point[s]];
    p.irradiance[u] = to_double(lit.irradiance[s]);
    p.exitance[u] = exitance[s];
  }
  p.energy = solver.energy(lit);
  return p;
}

inline Double4 uniform_light(const Vec3&) { return Double4{1, 1, 1, 0}; }

// Relative L2 error of the exitance of channel 0 over the surface.
inline double exitance_error(const SolvedProblem& p, const std::function<double(const Vec3&)>& exact) {
  double error = 0, size = 0;
  for (std::size_t u = 0; u < p.exitance.size(); ++u) {
    if (!(p.system.boundary_area[u] > 0)) continue;
    const double expected = exact(p.position(u));
    error += p.system.boundary_area[u] * (p.exitance[u][0] - expected) * (p.exitance[u][0] - expected);
    size += p.system.boundary_area[u] * expected * expected;
  }
  return std::sqrt(error / size);
}

// Relative L2 difference of two exitances at the solver's outer points over the surface, of the worst channel.
inline double exitance_difference(const DiffusionSolver& solver, const std::vector<Double4>& a,
                                  const std::vector<Double4>& b) {
  double worst = 0;
  for (int c = 0; c < 3; ++c) {
    double error = 0, size = 0;
    for (std::size_t s = 0; s < a.size(); ++s) {
      error += solver.surface().area[s] * (a[s][c] - b[s][c]) * (a[s][c] - b[s][c]);
      size += solver.surface().area[s] * b[s][c] * b[s][c];
    }
    worst = std::max(worst, std::sqrt(error / size));
  }
  return worst;
}

// mm³, by one Gauss point.
inline double cell_volume(const Polygrid& grid, Eigen::Index cell) {
  static const int corner[8][3] = {{0, 0, 0}, {1, 0, 0}, {1, 1, 0}, {0, 1, 0},
                                   {0, 0, 1}, {1, 0, 1}, {1, 1, 1}, {0, 1, 1}};
  Eigen::Matrix3d jacobian = Eigen::Matrix3d::Zero();
  for (int a = 0; a < 8; ++a)
    for (int axis = 0; axis < 3; ++axis)
      jacobian.col(axis) += (corner[a][axis] ? 0.25 : -0.25) * grid.points.row(grid.cells(cell, a)).transpose();
  return jacobian.determinant();
}

// Relative L2 error of the fluence of channel 0 over the volume.
inline double fluence_error(const SolvedProblem& p, const std::function<double(const Vec3&)>& exact) {
  std::vector<double> volume(p.fluence.size());
  for (Eigen::Index cell = 0; cell < p.grid.cells.rows(); ++cell)
    for (int a = 0; a < 8; ++a)
      volume[p.system.unknown_of_point[p.grid.cells(cell, a)]] += cell_volume(p.grid, cell) / 8;
  double error = 0, size = 0;
  for (std::size_t u = 0; u < p.fluence.size(); ++u) {
    const double expected = exact(p.position(u));
    error += volume[u] * (p.fluence[u][0] - expected) * (p.fluence[u][0] - expected);
    size += volume[u] * expected * expected;
  }
  return std::sqrt(error / size);
}

// σ_t' scaled by a factor that varies by `contrast` from sample to sample, at random.
inline void add_contrast(CellCoefficients& coefficients, double contrast) {
  for (std::size_t k = 0; k < coefficients.reduced_extinction.size(); ++k) {
    // Cells, not samples, differ, as voxels do.
    std::uint64_t bits = 0x9e3779b97f4a7c15ull * (k / 8 + 1);
    bits = (bits ^ (bits >> 31)) * 0xbf58476d1ce4e5b9ull;
    const double unit = static_cast<double>((bits ^ (bits >> 29)) >> 11) * 0x1.0p-53;
    coefficients.reduced_extinction[k] *= static_cast<float>(std::pow(contrast, unit - 0.5));
  }
}

}  // namespace shellgrid::test
