// SPDX-License-Identifier: AGPL-3.0-or-later
// The energy of discrete solutions, printed case by case: D4, white objects that return all light, constant fluence in
// uniform light; on cubes, balls and polygrids of objects, in both precisions. SG_LONG=1 takes finer grids,
// SG_POLYGRID=polygrid.hdf another object.
#include <gtest/gtest.h>

#include <cmath>
#include <cstdio>
#include <cstdlib>
#include <string>

#include "meshing/core/random.h"
#include "meshing/formats/vtkhdf_file.h"
#include "solvers/scattering/fresnel.h"
#include "tests/support/closed_shapes.h"
#include "tests/support/diffusion_problem.h"

namespace shellgrid {
namespace {

constexpr double ior = 1.5;

// Askew to the lattice: their polycubes have stairs, and their grids the flat edge cells of any object's.
Polygrid object_grid(const TriangleMesh& surface) {
  PolycubeOptions options;
  options.nodes = std::getenv("SG_LONG") ? 6e4 : 6e3;
  const TriangleMesh turned = shapes::rotated(surface, 3);
  return build_polygrid(build_voxel_polycube(turned, options), turned, {});
}

const std::vector<std::pair<std::string, Polygrid>>& grids() {
  static const auto made = [] {
    const int n = std::getenv("SG_LONG") ? 32 : 12;
    std::vector<std::pair<std::string, Polygrid>> list;
    list.emplace_back("cube", test::cube_grid(n, 20, 0.1));
    list.emplace_back("ball", test::ball_grid(n, 10, 0.1));
    list.emplace_back("torus", object_grid(shapes::torus(20, 8, 96, 48)));
    list.emplace_back("plate", object_grid(shapes::box(Vec3(40, 30, 6))));
    list.emplace_back("double cone", object_grid(shapes::double_cone(24, 10, 14, 8)));
    if (const char* path = std::getenv("SG_POLYGRID")) list.emplace_back(path, read_polygrid(path));
    return list;
  }();
  return made;
}

// In each channel other absorption; the extinction of each cell by chance within the contrast.
CellCoefficients material(const Polygrid& grid, double contrast, bool white) {
  CellCoefficients coefficients = homogeneous_coefficients(grid, test::grey_material({0, 1}));
  for (std::size_t k = 0; k < coefficients.absorption.size(); ++k) {
    const auto factor = static_cast<float>(std::pow(contrast, to_unit(hash64(11, k / 8)) - 0.5));
    coefficients.reduced_extinction[k] *= factor;
    if (!white) coefficients.absorption[k] = factor * Rgb(1e-4f, 0.01f, 0.3f);
  }
  return coefficients;
}

Double4 lamp(const Vec3& x) { return Double4{x.z() > 0 ? 1.0 : 0.0, x.x() > 0 ? 3.0 : 0.0, 1e-3, 0}; }

struct Precision {
  const char* name;
  double tolerance, energy;
};
constexpr Precision precisions[] = {{"single", 0.002, 1e-5}, {"double", 1e-9, 1e-10}};
// The solver keeps absorption and light at each point in single precision, whatever it solves in: what a system that is
// assembled apart makes of its solution.
constexpr double rounding = 1e-6;

struct Balance {
  double defect = 0;  // |∫q − ∫M − ∫σ_a φ| over ∫q, the worst channel's, of the operator that was solved
  double apart = 0;   // the same of a system that is assembled apart
  double returned = 0;  // |∫M − ∫q| over ∫q
  double spread = 0;    // of the fluence, from its mean where it should be constant
};

Balance balance(const test::SolvedProblem& p) {
  Balance b;
  const EnergyBalance energy = energy_balance(p.system, p.fluence, p.irradiance);
  for (int c = 0; c < 3; ++c) {
    double leaving = 0;
    for (std::size_t u = 0; u < p.exitance.size(); ++u) leaving += p.system.boundary_area[u] * p.exitance[u][c];
    b.defect = std::max(b.defect, p.energy.relative_defect[c]);
    b.apart = std::max(b.apart, std::abs(energy.entering[c] - leaving - energy.absorbed[c]) / energy.entering[c]);
    b.returned = std::max(b.returned, std::abs(leaving - energy.entering[c]) / energy.entering[c]);
    const double expected = 4 / (1 - diffuse_fresnel(ior).fluence_reflectance);
    for (const Double4& value : p.fluence) b.spread = std::max(b.spread, std::abs(value[c] / expected - 1));
  }
  return b;
}

TEST(DiffusionEnergy, WhatEntersLeavesOrIsAbsorbed) {
  for (const auto& [name, grid] : grids())
    for (const double contrast : {1.0, 1e3})
      for (const Precision& precision : precisions) {
        const Balance b =
            balance(test::solve_problem(grid, material(grid, contrast, false), ior, lamp, precision.tolerance));
        std::printf("%-12s contrast %-5g %s: |q - M - absorbed| %.1e of q, by a system assembled apart %.1e\n",
                    name.c_str(), contrast, precision.name, b.defect, b.apart);
        EXPECT_LE(b.defect, precision.energy) << name;
        EXPECT_LE(b.apart, rounding) << name;
      }
}

TEST(DiffusionEnergy, WhiteObjectsReturnAllLight) {
  for (const auto& [name, grid] : grids())
    for (const double contrast : {1.0, 1e3})
      for (const Precision& precision : precisions) {
        const Balance b =
            balance(test::solve_problem(grid, material(grid, contrast, true), ior, lamp, precision.tolerance));
        std::printf("%-12s contrast %-5g %s: |M - q| %.1e of q\n", name.c_str(), contrast, precision.name, b.returned);
        EXPECT_LE(b.returned, precision.energy) << name;
      }
}

TEST(DiffusionEnergy, UniformLightMakesConstantFluenceInWhiteObjects) {
  for (const auto& [name, grid] : grids())
    for (const double contrast : {1.0, 1e3})
      for (const Precision& precision : precisions) {
        const Balance b = balance(
            test::solve_problem(grid, material(grid, contrast, true), ior, test::uniform_light, precision.tolerance));
        std::printf("%-12s contrast %-5g %s: fluence within %.1e, tolerance %.0e\n", name.c_str(), contrast,
                    precision.name, b.spread, precision.tolerance);
        EXPECT_LE(b.spread, std::max(3 * precision.tolerance, rounding)) << name;
        EXPECT_LE(b.returned, precision.energy) << name;
      }
}

}  // namespace
}  // namespace shellgrid
