// SPDX-License-Identifier: AGPL-3.0-or-later
#include "solvers/dipole/dipole.h"

#include <gtest/gtest.h>

#include <cmath>
#include <numbers>

#include "meshing/core/error.h"
#include "solvers/diffusion/closed_forms.h"

namespace shellgrid {
namespace {

// ∫ 2π r f(r) dr in steps that grow with r.
template <class F>
double plane_integral(const F& f, double width, double reach) {
  double sum = 0;
  for (double r = 0; r < reach;) {
    const double next = r + 0.02 * std::max(width, r), middle = (r + next) / 2;
    sum += (next - r) * 2 * std::numbers::pi / 6 * (r * f(r) + 4 * middle * f(middle) + next * f(next));
    r = next;
  }
  return sum;
}

TEST(Dipole, IsJensensWithItsPolynomialAndBeam) {
  const DiffusionCoefficients marble{0.0041, 2.62};
  const Dipole dipole(marble.absorption, marble.reduced_scattering, 1.5, DipoleEntry::beam, DipoleBoundary::polynomial);
  for (const double r : {0.0, 0.1, 1.0, 10.0})
    EXPECT_NEAR(dipole.reflectance(r) / dipole_reflectance(marble, 1.5, r), 1, 1e-12);
  EXPECT_NEAR(dipole.total() / dipole_total_reflectance(2.62 / 2.6241, 1.5), 1, 1e-12);
}

TEST(Dipole, IntegratesToItsTotal) {
  for (const DipoleEntry entry : {DipoleEntry::beam, DipoleEntry::diffuse})
    for (const double absorption : {0.001, 0.3, 4.0}) {
      const Dipole dipole(absorption, 1.2, 1.3, entry);
      const double integral = plane_integral([&](double r) { return dipole.reflectance(r); }, dipole.real_depth, 400);
      EXPECT_NEAR(integral / dipole.total(), 1, 1e-4) << absorption;
    }
}

TEST(Dipole, ReturnsAllLightOfWhiteMatter) {
  EXPECT_NEAR(Dipole(0, 2, 1.0, DipoleEntry::diffuse).total(), 1, 1e-12);
  EXPECT_NEAR(Dipole(0, 2, 1.5).total(), 1, 1e-12);
  EXPECT_EQ(Dipole(2, 0, 1.5).total(), 0);
}

TEST(Dipole, RefusesMatterThatIsNone) {
  EXPECT_THROW(Dipole(0, 0, 1.3), InputError);
  EXPECT_THROW(Dipole(-1, 2, 1.3), InputError);
  EXPECT_THROW(Dipole(1, std::nan(""), 1.3), InputError);
  EXPECT_THROW(Dipole(1, 1, 0.5), InputError);
}

TEST(RadialProfile, AnswersWithinAThousandthOfItsFunction) {
  const Material skin = Material::from_absorption_scattering({0.032f, 0.17f, 0.48f}, {0.74f, 0.88f, 1.01f}, {0, 0, 0});
  const auto channels = dipoles(skin, 1.4);
  const RadialProfile profile = dipole_profile(channels);
  for (double r = 1e-4; r < 40; r *= 1.0137) {
    const Rgb value = profile.at(r);
    for (int c = 0; c < 3; ++c)
      if (const double exact = channels[c].reflectance(r); exact > 1e-19 * channels[c].reflectance(0))
        EXPECT_NEAR(value[c] / exact, 1, 1e-3) << r << " " << c;
  }
  EXPECT_TRUE((profile.at(profile.reach() * 2) == 0).all());
  EXPECT_LT(profile.bytes(), 1u << 20);
}

TEST(RadialProfile, AveragesOverDiscsWithoutLossOfLight) {
  for (const double radius : {0.2, 1.0, 8.0})
    for (const double absorption : {0.002, 0.8}) {
      std::array<Dipole, 3> channels;
      channels.fill(Dipole(absorption, 1.5, 1.3));
      const RadialProfile profile = dipole_profile(channels, radius);
      const double integral =
          plane_integral([&](double r) { return static_cast<double>(profile.at(r)[1]); }, std::min(radius, 0.4), 300);
      EXPECT_NEAR(integral / channels[1].total(), 1, 3e-3) << radius << " " << absorption;
    }
  // In the middle of a disc much wider than the function there is as much light as under a plane of it.
  std::array<Dipole, 3> channels;
  channels.fill(Dipole(0.5, 2, 1.3));
  const double area = std::numbers::pi * 40 * 40;
  EXPECT_NEAR(static_cast<double>(dipole_profile(channels, 40).at(0)[0]) * area / channels[0].total(), 1, 1e-3);
}

TEST(RadialProfile, OfNothingIsNothing) {
  std::array<Dipole, 3> channels;
  channels.fill(Dipole(1, 0, 1.3));
  const RadialProfile profile = dipole_profile(channels);
  EXPECT_TRUE((profile.at(0) == 0).all());
  EXPECT_TRUE((profile.at(5) == 0).all());
}

}  // namespace
}  // namespace shellgrid
