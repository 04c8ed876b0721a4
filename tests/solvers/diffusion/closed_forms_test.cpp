// SPDX-License-Identifier: AGPL-3.0-or-later
#include "solvers/diffusion/closed_forms.h"

#include <gtest/gtest.h>

#include <cmath>
#include <functional>
#include <numbers>

#include "solvers/scattering/fresnel.h"

namespace shellgrid {
namespace {

constexpr double pi = std::numbers::pi;
constexpr double ior = 1.4;

double slope(const std::function<double(double)>& f, double x, double step = 1e-4) {
  return (f(x + step) - f(x - step)) / (2 * step);
}

double integral(const std::function<double(double)>& f, double a, double b) {
  constexpr int n = 4000;
  double sum = f(a) + f(b);
  for (int i = 1; i < n; ++i) sum += (i % 2 ? 4 : 2) * f(a + (b - a) * i / n);
  return sum * (b - a) / (3 * n);
}

TEST(ClosedForms, SlabMeetsTheDiffusionEquationAndBothBoundaryConditions) {
  for (double absorption : {0.0, 0.003, 0.4}) {
    const DiffusionCoefficients material{absorption, 1.2};
    const double thickness = 5, d = material.diffusion();
    const SlabSolution slab(material, thickness, ior, 2.0, 0.5);
    const auto phi = [&](double z) { return slab.fluence(z); };
    const double curvature = (phi(2.01) - 2 * phi(2.0) + phi(1.99)) / 1e-4;
    EXPECT_NEAR(d * curvature, absorption * phi(2.0), 1e-4 * phi(2.0));
    const DiffuseFresnel f = diffuse_fresnel(ior);
    const double light = 4 / (1 - f.fluence_reflectance), c = f.boundary_factor;
    EXPECT_NEAR(phi(0) - 2 * c * d * slope(phi, 0), light * 2.0, 1e-5);
    EXPECT_NEAR(phi(thickness) + 2 * c * d * slope(phi, thickness), light * 0.5, 1e-5);
    const double absorbed = absorption * integral(phi, 0, thickness);
    EXPECT_NEAR(slab.exitance_at_zero + slab.exitance_at_thickness + absorbed, 2.5, 1e-9);
  }
}

TEST(ClosedForms, SphereConservesEnergyAndReturnsAllLightWhenWhite) {
  for (double absorption : {0.0, 1e-9, 0.003, 0.4, 20.0}) {
    const DiffusionCoefficients material{absorption, 1.2};
    const double radius = 6;
    const SphereSolution sphere(material, radius, ior, 1.0);
    const double absorbed =
        absorption * integral([&](double r) { return 4 * pi * r * r * sphere.fluence(r); }, 0, radius);
    EXPECT_NEAR(sphere.exitance + absorbed / (4 * pi * radius * radius), 1, 1e-6) << absorption;
    if (absorption == 0) {
      EXPECT_NEAR(sphere.exitance, 1, 1e-14);
    }
  }
}

TEST(ClosedForms, TwoLayerSphereIsContinuousInFluenceAndFlux) {
  const DiffusionCoefficients inner{0.002, 1.5}, outer{0.05, 0.5};
  const double a = 6, radius = 10;
  const TwoLayerSphereSolution sphere(inner, outer, a, radius, ior, 1.0);
  const auto phi = [&](double r) { return sphere.fluence(r); };
  EXPECT_NEAR(phi(a - 1e-9), phi(a + 1e-9), 1e-7);
  EXPECT_NEAR(inner.diffusion() * slope(phi, a - 1e-3), outer.diffusion() * slope(phi, a + 1e-3), 2e-4);
  const auto shell = [&](double r) { return 4 * pi * r * r * phi(r); };
  const double absorbed =
      inner.absorption * integral(shell, 0, a) + outer.absorption * integral(shell, a + 1e-12, radius);
  EXPECT_NEAR(sphere.exitance + absorbed / (4 * pi * radius * radius), 1, 1e-6);
}

TEST(ClosedForms, TwoLayersOfOneMaterialAreTheSphere) {
  const DiffusionCoefficients material{0.02, 0.9};
  const TwoLayerSphereSolution layered(material, material, 4, 9, ior, 1.0);
  const SphereSolution plain(material, 9, ior, 1.0);
  for (double r : {0.0, 1.0, 3.9, 4.1, 9.0}) EXPECT_NEAR(layered.fluence(r), plain.fluence(r), 1e-11) << r;
  EXPECT_NEAR(layered.exitance, plain.exitance, 1e-12);
}

TEST(ClosedForms, DipoleIntegratesToItsTotalReflectance) {
  const DiffusionCoefficients material{0.03, 1.0};
  const double albedo = material.reduced_scattering / (material.absorption + material.reduced_scattering);
  // r = e^u covers the peak and the tail.
  const double total = integral(
      [&](double u) {
        const double r = std::exp(u);
        return 2 * pi * r * r * dipole_reflectance(material, 1.3, r);
      },
      -12, 6);
  EXPECT_NEAR(total, dipole_total_reflectance(albedo, 1.3), 1e-4 * total);
}

}  // namespace
}  // namespace shellgrid
