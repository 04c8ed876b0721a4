// SPDX-License-Identifier: AGPL-3.0-or-later
#include "solvers/scattering/fresnel.h"

#include <gtest/gtest.h>

#include <cmath>

#include "meshing/core/error.h"

namespace shellgrid {
namespace {

TEST(Fresnel, NormalIncidenceIsTheSquaredIndexContrast) {
  for (double ior : {1.0, 1.3, 1.5, 2.4}) {
    const double expected = std::pow((ior - 1) / (ior + 1), 2);
    EXPECT_NEAR(fresnel_reflectance(1, ior), expected, 1e-15);
    EXPECT_NEAR(fresnel_reflectance(1, 1 / ior), expected, 1e-15);
  }
}

TEST(Fresnel, ParallelLightVanishesAtBrewstersAngle) {
  const double ior = 1.5, c = std::cos(std::atan(ior));
  // Half of the perpendicular part remains: ((1 − η²)/(1 + η²))² / 2.
  EXPECT_NEAR(fresnel_reflectance(c, ior), 0.5 * std::pow((1 - ior * ior) / (1 + ior * ior), 2), 1e-14);
}

TEST(Fresnel, ReflectanceIsTheSameFromBothSidesOfTheSurface) {
  const double ior = 1.4;
  for (double outside : {0.05, 0.3, 0.7, 0.95}) {
    const double inside = std::sqrt(1 - (1 - outside * outside) / (ior * ior));
    EXPECT_NEAR(fresnel_reflectance(outside, ior), fresnel_reflectance(inside, 1 / ior), 1e-13);
  }
}

TEST(Fresnel, LightInsideIsTotallyReflectedBeyondTheCriticalAngle) {
  EXPECT_EQ(fresnel_reflectance(0.5, 1 / 1.5), 1);
  EXPECT_LT(fresnel_reflectance(0.76, 1 / 1.5), 1);
  EXPECT_EQ(fresnel_transmittance(-0.1, 1.5), 0);
  EXPECT_EQ(fresnel_transmittance(0, 1.5), 0);
}

TEST(Fresnel, BoundaryFactorHasThePublishedValues) {
  EXPECT_NEAR(diffuse_fresnel(1.3).boundary_factor, 2.3405, 5e-5);
  EXPECT_NEAR(diffuse_fresnel(1.37).boundary_factor, 2.7586, 5e-5);
  EXPECT_NEAR(diffuse_fresnel(1.5).boundary_factor, 3.6279, 5e-5);
}

TEST(Fresnel, AMatchedIndexReflectsNothing) {
  const DiffuseFresnel f = diffuse_fresnel(1);
  EXPECT_NEAR(f.fluence_reflectance, 0, 1e-14);
  EXPECT_NEAR(f.current_reflectance, 0, 1e-14);
  EXPECT_NEAR(f.boundary_factor, 1, 1e-13);
  EXPECT_NEAR(f.exit_normalization, 1, 1e-13);
}

TEST(Fresnel, EtendueLinksTheTransmissionOfBothSides) {
  for (double ior : {1.1, 1.3, 1.5, 2.0}) {
    const DiffuseFresnel f = diffuse_fresnel(ior);
    EXPECT_NEAR(f.exit_normalization, ior * ior * (1 - f.fluence_reflectance), 1e-11);
  }
}

TEST(Fresnel, PolynomialFactorIsAboutTenPercentHigh) {
  EXPECT_NEAR(polynomial_boundary_factor(1.3), 2.60, 0.01);
  EXPECT_NEAR(polynomial_boundary_factor(1.5), 3.96, 0.01);
}

TEST(Fresnel, RefusesAnIndexBelowOne) {
  EXPECT_THROW(diffuse_fresnel(0.9), InputError);
  EXPECT_THROW(diffuse_fresnel(std::nan("")), InputError);
}

}  // namespace
}  // namespace shellgrid
