// SPDX-License-Identifier: AGPL-3.0-or-later
#include "solvers/diffusion/beam_source.h"

#include <gtest/gtest.h>
#include <oneapi/tbb/global_control.h>

#include <cmath>
#include <cstring>

#include "meshing/core/error.h"
#include "solvers/diffusion/cell_walk.h"
#include "solvers/diffusion/polygrid_diffusion.h"
#include "solvers/scattering/fresnel.h"
#include "tests/support/closed_shapes.h"
#include "tests/support/diffusion_problem.h"

namespace shellgrid {
namespace {

// Fluence of a slab lit by a beam of irradiance 1 through z = 0, along `direction`.
struct LitSlab {
  Polygrid grid;
  PolygridSystem system;
  BeamSource beams;
  std::vector<Double4> fluence;
  double area = 0;

  LitSlab(const DiffusionCoefficients& material, int n, double thickness, double ior,
          const Vec3& direction = Vec3(0, 0, 1), double layer = 0.1)
      : grid(test::slab_grid(n, 2, thickness, layer)) {
    const CellCoefficients c = homogeneous_coefficients(grid, test::grey_material(material));
    system = assemble_polygrid_system(grid, c, ior);
    area = 0.5 * system.surface_area;
    beams = trace_beams(grid, c, ior, [&](std::int32_t quad, std::vector<EnteringBeam>& list) {
      if (grid.points(grid.boundary_quads(quad, 0), 2) > 0.5 * thickness) return;
      const double share = 0.25 * area / 4;  // 2 × 2 quads with 2 × 2 beams each
      for (double s : {0.25, 0.75})
        for (double t : {0.25, 0.75}) list.push_back({s, t, direction, Double4{share, 2 * share, 0, 0}});
    });
    DiffusionSolver solver(grid);
    solver.set_material(c, ior, 1e-9);
    solver.solve(solver.source_light(beams.source), 1e-9);
    const std::vector<Double4> at_points = solver.fluence();
    for (std::int32_t point : system.point_of_unknown) fluence.push_back(at_points[point]);
  }
  // Power that leaves diffusely through z = 0.
  double reflected() const {
    double sum = 0;
    for (std::size_t u = 0; u < fluence.size(); ++u)
      if (grid.points(system.point_of_unknown[u], 2) < 1e-9)
        sum += system.boundary_area[u] * fluence[u][0] / (2 * system.boundary_factor);
    return sum / area;
  }
  double fluence_error(const BeamSlabSolution& exact) const {
    double error = 0, size = 0;
    for (std::size_t u = 0; u < fluence.size(); ++u) {
      const double expected = exact.fluence(grid.points(system.point_of_unknown[u], 2));
      error += (fluence[u][0] - expected) * (fluence[u][0] - expected);
      size += expected * expected;
    }
    return std::sqrt(error / size);
  }
};

TEST(BeamSlab, SolvesTheDiffusionEquationWithItsBoundaryConditions) {
  for (double absorption : {0.0, 0.05}) {
    const DiffusionCoefficients m{absorption, 1.2};
    const double thickness = 5, h = 1e-4;
    const BeamSlabSolution slab(m, thickness, 1.4, 2);
    for (double z : {0.3, 2.0, 4.5}) {
      const double curvature = (slab.fluence(z + h) - 2 * slab.fluence(z) + slab.fluence(z - h)) / (h * h);
      const double source = 2 * m.reduced_scattering * std::exp(-(m.absorption + m.reduced_scattering) * z);
      EXPECT_NEAR(m.diffusion() * curvature - m.absorption * slab.fluence(z) + source, 0, 1e-5);
    }
    const double reach = 2 * diffuse_fresnel(1.4).boundary_factor * m.diffusion();
    EXPECT_NEAR(slab.fluence(0), reach * (slab.fluence(h) - slab.fluence(-h)) / (2 * h), 1e-5);
    EXPECT_NEAR(slab.fluence(thickness), -reach * (slab.fluence(thickness + h) - slab.fluence(thickness - h)) / (2 * h),
                1e-5);
    if (absorption == 0) {
      EXPECT_NEAR(slab.exitance_at_zero + slab.exitance_at_thickness, 2 * (1 - std::exp(-1.2 * thickness)), 1e-9);
    }
  }
}

TEST(BeamSource, ASlabMeetsTheClosedFormToSecondOrder) {
  const DiffusionCoefficients m{0.03, 1};
  const double thickness = 6;
  const BeamSlabSolution exact(m, thickness, 1, 1);
  const LitSlab coarse(m, 16, thickness, 1), fine(m, 32, thickness, 1), finest(m, 64, thickness, 1);
  EXPECT_LT(fine.fluence_error(exact), 0.4 * coarse.fluence_error(exact));
  EXPECT_LT(finest.fluence_error(exact), 0.4 * fine.fluence_error(exact));
  EXPECT_LT(finest.fluence_error(exact), 1e-3);
  EXPECT_NEAR(finest.reflected(), exact.exitance_at_zero, 2e-3 * exact.exitance_at_zero);
  // The grid's material is in single precision.
  EXPECT_NEAR(finest.beams.leaving[0] / finest.area, std::exp(-1.03 * thickness), 1e-3 * std::exp(-1.03 * thickness));
  EXPECT_NEAR(finest.beams.entering[1], 2 * finest.beams.entering[0], 1e-12);
  EXPECT_EQ(finest.beams.entering[2], 0);
}

TEST(BeamSource, ThinLayersAndSlopingBeamsMakeNoDifference) {
  const DiffusionCoefficients m{0.03, 1};
  const BeamSlabSolution exact(m, 6, 1, 1);
  const LitSlab thin(m, 64, 6, 1, Vec3(0, 0, 1), 0.01);
  EXPECT_LT(thin.fluence_error(exact), 1e-3);
  // A beam at 60° to the normal goes twice as far to each depth.
  const LitSlab sloping(m, 64, 6, 1, Vec3(std::sin(M_PI / 3), 0, std::cos(M_PI / 3)));
  EXPECT_NEAR(sloping.beams.leaving[0] / sloping.area, std::exp(-12.36), 1e-4);
  EXPECT_GT(sloping.reflected(), 1.1 * exact.exitance_at_zero);
}

TEST(BeamSource, AClearSlabMirrorsTheBeamBetweenItsFaces) {
  const DiffusionCoefficients m{0.02, 0.03};
  const LitSlab slab(m, 12, 5, 1.5);
  const double passed = std::exp(-0.05 * 5), mirrored = 0.04;
  EXPECT_NEAR(slab.beams.leaving[0] / slab.area, passed * (1 - mirrored) / (1 - mirrored * passed), 1e-4);
  EXPECT_NEAR(slab.beams.absorbed[0], 0.4 * (slab.beams.entering[0] - slab.beams.leaving[0]), 1e-6);
  Double4 sum = slab.beams.absorbed + slab.beams.leaving;
  for (const Double4& value : slab.beams.source) sum += value;
  EXPECT_NEAR(sum[0] / slab.beams.entering[0], 1, 1e-12);
  EXPECT_EQ(slab.beams.cut_off, 0);
}

// What is left of a beam that is mirrored to and fro is no scattered light.
TEST(BeamSource, WhatANearlyClearObjectScattersIsInProportionToItsMatter) {
  double scattered[2];
  for (int k = 0; k < 2; ++k) {
    const LitSlab slab({0, k == 0 ? 1e-3 : 1e-6}, 8, 5, 1.5);
    scattered[k] = slab.beams.entering[0] - slab.beams.leaving[0];
  }
  EXPECT_NEAR(scattered[0] / scattered[1], 1000, 10);
}

TEST(BeamSource, AThinObjectTakesFewerBeamsOfTheSameLight) {
  const Polygrid grid = test::ball_grid(12, 10, 0.1);
  const TriangleMesh surface = shapes::sphere(10, 4);
  const SceneGeometry geometry(surface);
  EnvironmentLight sky;
  sky.zenith = Rgb(1, 2, 3);
  sky.horizon = Rgb(0.3f, 0.2f, 0.1f);
  const CellCoefficients c = homogeneous_coefficients(grid, test::grey_material({0.001, 0.01}));
  for (const Light& light : {Light(sky), Light(DirectionalLight{Vec3(0, 0, -1), Rgb::Ones()})}) {
    const auto source = [&](double most_steps) {
      return first_collision_source(grid, c, surface, geometry, {light}, 1.5, 32, most_steps);
    };
    const BeamSource all = source(1e12), some = source(0.2 * static_cast<double>(all.steps));
    EXPECT_GT(all.steps, 5e4);
    EXPECT_LT(some.steps, 0.4 * static_cast<double>(all.steps));
    EXPECT_NEAR(some.entering[0], all.entering[0], 0.03 * all.entering[0]);
    EXPECT_NEAR(some.leaving[0], all.leaving[0], 0.03 * all.leaving[0]);
    double upper[2] = {}, whole[2] = {};
    for (std::size_t p = 0; p < all.source.size(); ++p)
      for (int k = 0; k < 2; ++k) {
        const double power = (k == 0 ? all : some).source[p][0];
        whole[k] += power;
        if (grid.points(static_cast<Eigen::Index>(p), 2) > 0) upper[k] += power;
      }
    EXPECT_NEAR(whole[1], whole[0], 0.03 * whole[0]);
    EXPECT_NEAR(upper[1], upper[0], 0.05 * upper[0]);
  }
}

// Chandrasekhar's exact reflectance of a half-space, g = 0, equal indices, normal incidence.
TEST(BeamSource, AHalfSpaceIsNearerToTransportThanWithTheBoundarySource) {
  const double exact[2] = {0.752721, 0.912845}, albedo[2] = {0.99, 0.999};
  for (int k = 0; k < 2; ++k) {
    const DiffusionCoefficients m{1 - albedo[k], albedo[k]};
    const double beams = BeamSlabSolution(m, 400, 1, 1).exitance_at_zero;
    const double boundary = SlabSolution(m, 400, 1, 1, 0).exitance_at_zero;
    EXPECT_NEAR(beams, exact[k], 0.006 * exact[k]);
    EXPECT_LT(std::abs(beams - exact[k]), 0.25 * std::abs(boundary - exact[k]));
  }
  const LitSlab grid({0.01, 0.99}, 100, 40, 1);
  EXPECT_NEAR(grid.reflected(), exact[0], 0.01 * exact[0]);
}

TEST(BeamSource, TheWholeSolverBalancesEnergy) {
  const Polygrid grid = test::ball_grid(12, 10, 0.1);
  const TriangleMesh surface = shapes::sphere(10, 5);
  EnvironmentLight sky;
  sky.zenith = sky.horizon = Rgb(1, 2, 3);
  sky.ground = Rgb(0.1f, 0, 0);
  const std::vector<Light> lights = {DirectionalLight{Vec3(0.3, 0, -1).normalized(), Rgb(1, 2, 3)},
                                     PointLight{Vec3(30, 5, 0), Rgb(500, 300, 100)}, sky};
  DiffusionOptions options;
  options.source = "first-collision";
  options.beam_samples = 16;
  for (double scattering : {0.02, 0.5, 3.0}) {
    const Material m = Material::from_absorption_scattering(Rgb(0, 0.01f, 0.3f),
                                                            Rgb::Constant(static_cast<float>(scattering)), Rgb::Zero());
    const DiffusionResult r = solve_polygrid_diffusion(grid, surface, m, 1.5, lights, options);
    ASSERT_TRUE(r.beams);
    EXPECT_EQ(r.beams->lost, 0);
    for (int c = 0; c < 3; ++c) {
      EXPECT_LT(r.beams->cut_off_power[c], 1e-3 * r.energy.entering[c]);
      EXPECT_LT(r.energy.relative_defect[c], 1e-10);
      EXPECT_NEAR(r.energy.entering[c], r.surface_entering[c], 0.03 * r.energy.entering[c]);
      EXPECT_NEAR(r.surface_leaving[c] + r.beams->leaving[c], r.energy.leaving[c], 0.02 * r.energy.leaving[c]);
    }
    EXPECT_EQ(r.beams->absorbed[0], 0);
    EXPECT_EQ(r.negative_vertices, 0);
    if (scattering == 3.0) EXPECT_LT(r.beams->leaving[0], 1e-3 * r.energy.entering[0]);
    if (scattering == 0.02) EXPECT_GT(r.beams->leaving[0], 0.5 * r.energy.entering[0]);
  }
}

TEST(BeamSource, GivesTheSameBytesAtOneAndMoreThreads) {
  const Polygrid grid = test::ball_grid(16, 10, 0.1);
  const TriangleMesh surface = shapes::sphere(10, 4);
  CellCoefficients c = homogeneous_coefficients(grid, test::grey_material({0.01, 1}));
  test::add_contrast(c, 100);
  const SceneGeometry geometry(surface);
  std::vector<Double4> first;
  for (int threads : {1, 2, 4}) {
    oneapi::tbb::global_control control(oneapi::tbb::global_control::max_allowed_parallelism, threads);
    const BeamSource beams =
        first_collision_source(grid, c, surface, geometry, {DirectionalLight{Vec3(0, 0, -1), Rgb(1, 2, 3)}}, 1.4, 16);
    if (first.empty()) first = beams.source;
    EXPECT_EQ(std::memcmp(first.data(), beams.source.data(), first.size() * sizeof(Double4)), 0) << threads;
  }
}

TEST(CellWalk, FindsEveryPlaceOfADistortedGridFromFarAway) {
  const Polygrid grid = test::ball_grid(8, 10, 0.1);
  const CellNeighbours neighbours(grid);
  int found = 0;
  for (int cell = 0; cell < grid.cells.rows(); ++cell) {
    const Vec3 point = gauss_point(grid, cell, cell % 8);
    CellPlace place{0, Vec3::Constant(0.5)};
    int face = -1;
    // Straight ways through the ball never leave it; cells are visited on the way.
    const Vec3 start = gauss_point(grid, 0, 6);
    for (int k = 1; k <= 20; ++k)
      ASSERT_EQ(walk_to(grid, neighbours, start + (point - start) * k / 20.0, place, face), WalkEnd::inside);
    const TrilinearShape shape(place.reference);
    Vec3 there = Vec3::Zero();
    for (int a = 0; a < 8; ++a) there += shape.value[a] * grid.points.row(grid.cells(place.cell, a)).transpose();
    ASSERT_LT((there - point).norm(), 1e-6);
    found += place.cell == cell;
  }
  EXPECT_GT(found, 0.99 * grid.cells.rows());
}

TEST(CellWalk, RefusesQuadsThatAreNoFaces) {
  Polygrid grid = test::ball_grid(6, 5, 0.1);
  std::swap(grid.boundary_quads(0, 0), grid.boundary_quads(7, 1));
  EXPECT_THROW(CellNeighbours{grid}, InputError);
}

}  // namespace
}  // namespace shellgrid
