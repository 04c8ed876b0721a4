// SPDX-License-Identifier: AGPL-3.0-or-later
// Colour to albedo: the exact reflectance of half-spaces against Monte Carlo, published values and the dipole's
// formula.
#include "synthesis/half_space_reflectance.h"

#include <gtest/gtest.h>

#include <cmath>

#include "meshing/core/error.h"
#include "synthesis/albedo.h"

namespace shellgrid {
namespace {

TEST(HalfSpaceReflectance, AgreesWithMonteCarlo) {
  const struct {
    double albedo, ior, reflectance, standard_error;
  } rows[] = {
#include "tests/synthesis/half_space_table.inc"
  };
  for (const auto& row : rows)
    EXPECT_NEAR(half_space_reflectance(row.albedo, row.ior), row.reflectance, 4.5 * row.standard_error + 1e-5)
        << row.albedo << " " << row.ior;
}

TEST(HalfSpaceReflectance, HasTheLimitsOfTheHFunction) {
  // Without a boundary the share that comes back is 1 − 2 √(1 − α) ∫ H μ dμ, and the integral is 2/√3 where nothing is
  // absorbed [Chandrasekhar1960 §38].
  EXPECT_EQ(half_space_reflectance(1, 1), 1);
  EXPECT_EQ(half_space_reflectance(0, 1.3), 0);
  EXPECT_NEAR((1 - half_space_reflectance(1 - 1e-6, 1)) / (2 * 1e-3), 1.1547, 0.005);
}

TEST(HalfSpaceReflectance, RisesWithAlbedoAndFallsWithTheIndex) {
  double last = 0;
  for (double albedo = 0.05; albedo < 1; albedo += 0.05) {
    const double open = half_space_reflectance(albedo, 1), closed = half_space_reflectance(albedo, 1.4);
    EXPECT_GT(open, last);
    EXPECT_LT(closed, open);
    last = open;
  }
}

TEST(ReflectanceInversion, GivesBackEveryAlbedo) {
  for (const ReflectanceModel model : {ReflectanceModel::dipole, ReflectanceModel::transport})
    for (const double ior : {1.0, 1.3, 1.5}) {
      const ReflectanceInversion inversion(model, ior);
      for (const double albedo : {0.02, 0.3, 0.6, 0.8, 0.9, 0.95, 0.99, 0.999, 0.9999}) {
        const double reflectance =
            model == ReflectanceModel::dipole ? diffuse_reflectance(albedo, ior) : half_space_reflectance(albedo, ior);
        EXPECT_NEAR(inversion.reduced_albedo(reflectance), albedo, 2e-5) << ior;
      }
      EXPECT_NEAR(inversion.reduced_albedo(0.0), 0, 1e-8);
      EXPECT_NEAR(inversion.reduced_albedo(1.0), 1, 1e-8);
    }
}

TEST(ReflectanceInversion, TheDipoleErrsBelowAnAlbedoOf95Percent) {
  // What the exact way is for: relative error of the dipole's reflectance.
  const auto error = [](double albedo) {
    return diffuse_reflectance(albedo, 1.5) / half_space_reflectance(albedo, 1.5) - 1;
  };
  EXPECT_LT(std::abs(error(0.999)), 0.06);
  EXPECT_GT(std::abs(error(0.7)), 0.3);
}

TEST(HalfSpaceReflectance, RefusesWhatIsOutOfRange) {
  EXPECT_THROW(half_space_reflectance(1.1, 1.3), InputError);
  EXPECT_THROW(half_space_reflectance(0.5, 0.9), InputError);
}

}  // namespace
}  // namespace shellgrid
