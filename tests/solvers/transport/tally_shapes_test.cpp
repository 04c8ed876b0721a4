// SPDX-License-Identifier: AGPL-3.0-or-later
// Published values and closed forms; the long form of the published ones is in tests/accuracy.
#include <gtest/gtest.h>

#include <cmath>
#include <limits>
#include <numbers>

#include "meshing/core/error.h"
#include "solvers/scattering/fresnel.h"
#include "solvers/transport/tally_shapes.h"

namespace shellgrid {
namespace {

TallyResult measure(const TallyProblem& problem, double paths) {
  const TallyTransport transport(problem);
  const PathKind kind = transport.kind();
  PathState state(kind.scalars, kind.field_size);
  PathLimits limits;
  limits.paths = paths;
  follow_paths(kind, limits, state);
  return transport.result(state);
}

void expect_near(const Estimate& found, double expected, double errors = 3) {
  EXPECT_NEAR(found.value, expected, errors * found.standard_error + 1e-12);
}

TallyProblem slab(const TallyLayer& layer, double thickness, double ior) {
  TallyProblem p;
  p.layers = {layer};
  p.thickness = thickness;
  p.ior = ior;
  return p;
}

double total(const TallyResult& r) {
  double sum = r.diffuse_reflectance.value + r.specular_reflectance.value + r.transmittance.value + r.lost.value;
  for (const Estimate& e : r.absorbed) sum += e.value;
  return sum;
}

TEST(TallyShapes, SlabOfVanDeHulst) {
  const TallyResult r = measure(slab({1, 9, 0.75}, 0.2, 1), 300000);
  expect_near(r.diffuse_reflectance, 0.09739);
  expect_near(r.transmittance, 0.66096);
  expect_near(r.unscattered, std::exp(-2.0));
  EXPECT_EQ(r.specular_reflectance.value, 0);
}

TEST(TallyShapes, HalfSpaceOfChandrasekhar) {
  for (const auto& [albedo, reflectance] :
       {std::pair{0.5, 0.115226}, {0.9, 0.414947}, {0.99, 0.752721}, {0.999, 0.912845}}) {
    TallyProblem p;
    p.shape = TallyShape::half_space;
    p.layers = {{1 - albedo, albedo, 0}};
    const TallyResult r = measure(p, 60000);
    expect_near(r.diffuse_reflectance, reflectance);
    EXPECT_EQ(r.transmittance.value, 0);
  }
}

// Half-space with a boundary, as tabulated by Giovanelli (1955) for MCML: isotropic, albedo .9, index 1.5, normal
// light.
TEST(TallyShapes, HalfSpaceOfGiovanelli) {
  TallyProblem p;
  p.shape = TallyShape::half_space;
  p.layers = {{1, 9, 0}};
  p.ior = 1.5;
  const TallyResult r = measure(p, 200000);
  EXPECT_NEAR(r.specular_reflectance.value, 0.04, 1e-12);
  EXPECT_NEAR(r.diffuse_reflectance.value + r.specular_reflectance.value, 0.2600,
              3 * r.diffuse_reflectance.standard_error + 5e-5);
}

TEST(TallyShapes, EnergyAddsUp) {
  TallyProblem sphere;
  sphere.shape = TallyShape::sphere;
  sphere.layers = {{0.002, 1.5, 0, 6}, {0.05, 0.5, 0.6, 10}};
  sphere.ior = 1.4;
  sphere.source = TallySource::diffuse;
  for (const TallyProblem& p : {slab({0.3, 2, 0.9}, 3, 1.5), sphere}) {
    const TallyResult r = measure(p, 40000);
    double sum = 0;
    for (const Estimate& e : r.absorbed) sum += e.standard_error;
    EXPECT_NEAR(total(r), 1,
                0.02 * sum + 4 * r.transmittance.standard_error + 4 * r.diffuse_reflectance.standard_error);
    EXPECT_EQ(r.lost.value, 0);
  }
}

TEST(TallyShapes, WhiteShapesLoseNothing) {
  for (const double ior : {1.0, 1.3, 2.5}) {
    TallyProblem sphere;
    sphere.shape = TallyShape::sphere;
    sphere.layers = {{0, 0.4, 0, 1}, {0, 0, 0, 2}, {0, 3, 0.8, 5}};
    sphere.ior = ior;
    for (const TallyProblem& p : {slab({0, 5, 0.5}, 2, ior), sphere}) EXPECT_NEAR(total(measure(p, 3000)), 1, 1e-9);
  }
}

// Beer's law: matter that does not scatter.
TEST(TallyShapes, PureAbsorptionFollowsBeer) {
  TallyProblem p;
  p.shape = TallyShape::sphere;
  p.source = TallySource::centre;
  p.layers = {{0.1, 0, 0, 4}, {0.3, 0, 0, 6}};
  const TallyResult r = measure(p, 200000);
  expect_near(r.transmittance, std::exp(-0.4 - 0.6));
  expect_near(r.absorbed[0], 1 - std::exp(-0.4));
  for (std::size_t k = 0; k < r.fluence_profile.size(); k += 7) {
    // Mean over the bin of e^{−τ}/(4π r²).
    const double a = r.radius[k], b = r.radius[k + 1], volume = (b * b * b - a * a * a) / 3;
    constexpr int steps = 1000;
    double sum = 0;
    for (int s = 0; s < steps; ++s) {
      const double x = a + (b - a) * (s + 0.5) / steps;
      sum += std::exp(-(x < 4 ? 0.1 * x : 0.4 + 0.3 * (x - 4))) * (b - a) / steps;
    }
    expect_near(r.fluence_profile[k], sum / (4 * std::numbers::pi * volume), 4);
  }
}

// Uniform light from all sides of a white body: the fluence inside is 4π η² times the radiance everywhere, whatever the
// shells. One unit of light is radiance 1/(π · 4πR²) here.
TEST(TallyShapes, WhiteFurnaceHasTheSameFluenceEverywhere) {
  TallyProblem p;
  p.shape = TallyShape::sphere;
  p.source = TallySource::diffuse;
  p.layers = {{0, 2, 0.5, 2}, {0, 0, 0, 3}, {0, 0.3, 0, 4}};
  p.ior = 1.5;
  p.bins = 8;
  const TallyResult r = measure(p, 100000);
  EXPECT_NEAR(r.diffuse_reflectance.value + r.specular_reflectance.value, 1, 1e-9);
  const double radiance = 1 / (std::numbers::pi * 4 * std::numbers::pi * 16);
  for (const Estimate& fluence : r.fluence_profile) expect_near(fluence, 4 * std::numbers::pi * 2.25 * radiance, 4);
}

TEST(TallyShapes, ProfilesAddUpToTheTotals) {
  TallyProblem p = slab({0.2, 3, 0.3}, 1, 1.4);
  p.extent = 1e4;
  p.bins = 20;
  const TallyResult r = measure(p, 20000);
  double reflected = 0, transmitted = 0;
  for (int k = 0; k < p.bins; ++k) {
    const double area = std::numbers::pi * (r.radius[k + 1] * r.radius[k + 1] - r.radius[k] * r.radius[k]);
    reflected += area * r.reflectance_profile[k].value;
    transmitted += area * r.transmittance_profile[k].value;
  }
  EXPECT_NEAR(reflected, r.diffuse_reflectance.value, 1e-12);
  EXPECT_NEAR(transmitted, r.transmittance.value, 1e-12);
}

// White matter without an end returns all light, after times whose mean is infinite.
TEST(TallyShapes, WhiteHalfSpaceReturnsEverything) {
  for (const double anisotropy : {0.0, 0.8, -0.4}) {
    TallyProblem p;
    p.shape = TallyShape::half_space;
    p.layers = {{0, 1, anisotropy}};
    p.ior = anisotropy == 0 ? 1.5 : 1;
    const TallyTransport transport(p);
    const PathKind kind = transport.kind();
    PathState state(kind.scalars, kind.field_size);
    PathLimits limits;
    limits.paths = 20000;
    follow_paths(kind, limits, state);
    const TallyResult r = transport.result(state);
    EXPECT_NEAR(r.diffuse_reflectance.value + r.specular_reflectance.value, 1, 1e-12);
    EXPECT_EQ(r.lost.value, 0);
    EXPECT_EQ(state.count(PathEvent::limit_roulette), 0u);
    EXPECT_GT(state.count(PathEvent::leaps), 0u);
  }
}

// What nearly white matter absorbs is H(1) √(1 − α), H(1) = 2.9078 of white matter.
TEST(TallyShapes, NearlyWhiteHalfSpaceOfChandrasekhar) {
  TallyProblem p;
  p.shape = TallyShape::half_space;
  p.layers = {{1e-8, 1 - 1e-8, 0}};
  const TallyResult r = measure(p, 40000);
  expect_near(r.absorbed[0], 2.90781e-4, 4);
  EXPECT_LT(r.absorbed[0].standard_error, 1e-4);
}

// A ball that light leaves after 1e8 collisions. Diffusion with the extrapolation of 0.7104 transport mean free paths
// is exact here.
TEST(TallyShapes, BallOfManyMeanFreePaths) {
  TallyProblem p;
  p.shape = TallyShape::sphere;
  p.source = TallySource::centre;
  p.layers = {{0, 1, 0.5, 2e4}};
  p.bins = 4;
  const TallyResult white = measure(p, 3000);
  EXPECT_NEAR(white.transmittance.value, 1, 1e-12);
  for (std::size_t k = 0; k < 4; ++k) {
    // ∫ 3σ' (1/r − 1/R) r² dr over the bin's volume.
    const double a = white.radius[k], b = white.radius[k + 1], radius = 2e4 + 2 * 0.7104;
    const double sum = 1.5 * (0.5 * (b * b - a * a) - (b * b * b - a * a * a) / (3 * radius));
    expect_near(white.fluence_profile[k], sum / (4 * std::numbers::pi / 3 * (b * b * b - a * a * a)), 4);
    EXPECT_LT(white.fluence_profile[k].standard_error, 0.05 * white.fluence_profile[k].value);
  }
  // κR = 2: x / sinh x leaves, x = κ (R + extrapolation).
  p.layers = {{2.0 * 2 / 1.5 / (2e4 * 2e4), 1, 0.5, 2e4}};
  const TallyResult grey = measure(p, 20000);
  const double x = 2.0 * (1 + 2 * 0.7104 / 2e4);
  expect_near(grey.transmittance, x / std::sinh(x), 4);
  expect_near(grey.absorbed[0], 1 - x / std::sinh(x), 4);
}

// Leaps against collisions one by one.
TEST(TallyShapes, LeapsChangeNothing) {
  for (const TallyLayer& layer : {TallyLayer{2e-4, 1, 0}, {1e-2, 3, 0.6}, {0, 0.7, -0.5}}) {
    TallyProblem p;
    p.shape = TallyShape::sphere;
    p.source = TallySource::centre;
    const double unit = 1 / (layer.scattering * (1 - std::max(0.0, layer.anisotropy)));
    p.layers = {{layer.absorption, layer.scattering, layer.anisotropy, 50 * unit}, {1e-3, 0.5 / unit, 0, 55 * unit}};
    p.bins = 11;
    p.ior = 1.3;
    const TallyResult with = measure(p, 20000);
    p.leaps = false;
    p.seed = 1;
    const TallyResult without = measure(p, 2000);
    const auto same = [&](const Estimate& a, const Estimate& b, const char* what) {
      EXPECT_NEAR(a.value, b.value, 4 * std::hypot(a.standard_error, b.standard_error)) << what;
    };
    same(with.transmittance, without.transmittance, "transmittance");
    for (std::size_t k = 0; k < 2; ++k) same(with.absorbed[k], without.absorbed[k], "absorbed");
    for (std::size_t k = 0; k < with.fluence_profile.size(); ++k)
      same(with.fluence_profile[k], without.fluence_profile[k], "fluence");
  }
}

TEST(TallyShapes, NonsenseIsRefused) {
  EXPECT_THROW(TallyTransport(slab({-1, 1, 0}, 1, 1)), InputError);
  EXPECT_THROW(TallyTransport(slab({1, 1, 1}, 1, 1)), InputError);
  EXPECT_THROW(TallyTransport(slab({1, 1, 0}, 0, 1)), InputError);
  EXPECT_THROW(TallyTransport(slab({1, 1, 0}, 1, 0.5)), InputError);
  EXPECT_THROW(TallyTransport(slab({std::numeric_limits<double>::quiet_NaN(), 1, 0}, 1, 1)), InputError);
  TallyProblem p;
  p.shape = TallyShape::sphere;
  p.layers = {{1, 1, 0, 2}, {1, 1, 0, 1}};
  EXPECT_THROW(TallyTransport{p}, InputError);
}

}  // namespace
}  // namespace shellgrid
