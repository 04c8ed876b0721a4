// SPDX-License-Identifier: AGPL-3.0-or-later
#include "solvers/shell_texture/shell_curvature.h"

#include <gtest/gtest.h>

#include <cmath>
#include <numbers>

#include "meshing/core/error.h"
#include "meshing/surface/half_edges.h"
#include "solvers/dipole/dipole.h"
#include "solvers/scattering/fresnel.h"
#include "solvers/shell_texture/core_light.h"
#include "tests/support/closed_shapes.h"

namespace shellgrid {
namespace {

std::vector<ShellLayer> layers(int count, float scattering, float absorption) {
  ShellLayer layer;
  layer.extinction = layer.reduced = Rgb::Constant(scattering + absorption);
  layer.absorption = Rgb::Constant(absorption);
  return std::vector<ShellLayer>(static_cast<std::size_t>(count), layer);
}

TEST(BentShell, IsTheFlatOneWithoutBend) {
  const BentShell shell(layers(6, 2, 0.1f), 0.5, 1.4, 0);
  for (const BentShell::Ratios& ratios : shell.layers())
    for (int c = 0; c < 3; ++c) {
      EXPECT_NEAR(ratios.single[c], 1, 1e-5);
      EXPECT_NEAR(ratios.multiple[c], 1, 1e-5);
      EXPECT_NEAR(ratios.back[c], 1, 1e-5);
    }
  EXPECT_NEAR(shell.below()[0], 1, 1e-5);
  EXPECT_NEAR(shell.loss()[0], 1, 1e-5);
}

// In a ball r φ obeys the plane's equation.
TEST(BentShell, OfDenseMatterFollowsTheBallsSolution) {
  constexpr int count = 20;
  constexpr double voxel = 0.5, thickness = count * voxel;
  for (const float absorption : {0.0f, 2e-4f, 0.02f}) {
    for (const double bend : {-1.0, -0.3, 0.3, 0.6}) {
      const BentShell shell(layers(count, 40, absorption), voxel, 1.3, bend);
      const double first = bend * 0.5 * voxel / thickness;
      for (int i = 1; i < count - 1; ++i) {
        const double part = (i + 0.5) / count, expected = (1 - first) / (1 - bend * part);
        const BentShell::Ratios& one = shell.layers()[i];
        EXPECT_NEAR(one.multiple[0] / shell.layers()[0].multiple[0] / expected, 1, 0.01) << bend << " " << i;
        EXPECT_NEAR(one.back[1] * (1 - bend * part) / (1 - bend), 1, 0.02) << bend << " " << i;
      }
      if (absorption == 0) {
        // 1/(1 − r) and T both grow by r_above/r_below: a core in even light stays as bright.
        EXPECT_NEAR(shell.loss()[2] * (1 - bend), 1, 0.02) << bend;
        EXPECT_NEAR(shell.below()[2] / shell.loss()[2], 1, 1e-4) << bend;
      }
    }
  }
}

// Beams of matter that neither scatters nor absorbs: those of even light, whose cone widens between spheres.
TEST(BentShell, WidensTheConeOfBeams) {
  constexpr double voxel = 0.1, ior = 1.5;
  for (const double bend : {-0.5, 0.2}) {
    const BentShell shell(layers(10, 1e-6f, 1e-6f), voxel, ior, bend);
    for (int i = 0; i < 10; ++i) {
      // ∫ of the beams' radiance, T(θ) of the side it came through, over solid angle.
      const auto fluence = [&](double ratio) {
        double sum = 0;
        constexpr int steps = 4000;
        for (int k = 0; k < steps; ++k) {
          const double outer = (k + 0.5) / steps;  // sin² outside
          const double sine = std::sqrt(outer) / ior / ratio;
          if (sine >= 1) continue;
          sum += fresnel_transmittance(std::sqrt(1 - outer), ior) / (std::sqrt(1 - sine * sine) * ratio * ratio);
        }
        return sum;
      };
      const double expected = fluence(1 - bend * (i + 0.5) / 10) / fluence(1);
      EXPECT_NEAR(shell.layers()[i].single[0] / expected, 1, 0.01) << bend << " " << i;
    }
  }
}

TEST(BentShell, RefusesWhatIsNoShell) {
  EXPECT_THROW(BentShell({}, 0.5, 1.3, 0), InputError);
  EXPECT_THROW(BentShell(layers(3, 1, 0), 0.5, 1.3, 1), InputError);
  EXPECT_THROW(BentShell(layers(3, 1, 0), 0, 1.3, 0), InputError);
}

// Where it is only told of clear and opaque matter, ratios stay numbers within their bounds.
TEST(BentShell, StaysFiniteAtTheEnds) {
  for (const float scattering : {0.0f, 1e-6f, 1.0f, 1e5f})
    for (const float absorption : {0.0f, 1e-6f, 1.0f, 1e5f})
      for (const double bend : {-1.0, 0.75}) {
        const BentShell shell(layers(4, scattering, absorption), 0.5, 1.0, bend);
        for (const BentShell::Ratios& one : shell.layers())
          for (const Rgb& value : {one.single, one.multiple, one.back, shell.below(), shell.loss()}) {
            EXPECT_TRUE(value.isFinite().all() && (value > 0.2f).all() && (value < 5).all())
                << scattering << " " << absorption << " " << bend;
          }
      }
}

struct Shape {
  TriangleMesh mesh;
  VertexMatrix normals = vertex_normals(mesh), directions = normals;
  TexturedFrames frames() const { return {mesh, normals, directions}; }
};

TEST(MeanCurvature, IsThatOfBallsAndTori) {
  const Shape ball{shapes::sphere(7, 5)};
  for (const float h : mean_curvatures(ball.frames(), 2, 1)) EXPECT_NEAR(h * 7, 1, 0.02);
  constexpr double major = 20, minor = 6;
  const Shape torus{shapes::torus(major, minor, 200, 60)};
  const std::vector<float> curvatures = mean_curvatures(torus.frames(), 1, 0.7);
  for (int v = 0; v < torus.mesh.vertex_count(); v += 7) {
    const Vec3 p = torus.mesh.vertex(v);
    const Vec3 n = torus.normals.row(v).transpose();
    // The circle about the axis bends by the normal's part across it.
    double expected = 0;
    for (int axis = 0; axis < 3; ++axis) {
      Vec3 flat = p;
      flat[axis] = 0;
      if (std::abs(std::hypot(flat.norm() - major, p[axis]) - minor) > 0.05) continue;
      expected = (1 / minor + n.dot(flat) / flat.squaredNorm()) / 2;
    }
    ASSERT_NE(expected, 0);
    EXPECT_NEAR(curvatures[v], expected, 0.008) << v;
  }
}

TEST(BodyReturn, GoesFromTheHalfSpaceToAll) {
  const Dipole dipole(0.01, 2, 1, DipoleEntry::diffuse), white(0, 2, 1, DipoleEntry::diffuse);
  EXPECT_NEAR(body_return(dipole, 1e4), 1, 1e-3);
  EXPECT_EQ(body_return(white, 3), 1);
  // Ball: −D φ' = j, φ = sinh(σ_tr r)/r; what it returns of an incoming partial current.
  const double radius = 5, d = 1 / (3 * 2.01), x = dipole.decay * radius;
  const double slope = (x / std::tanh(x) - 1) / radius;
  const double returned = (1 - 2 * d * slope) / (1 + 2 * d * slope);
  const double half_space = (1 - 2 * d * dipole.decay) / (1 + 2 * d * dipole.decay);
  EXPECT_NEAR(body_return(dipole, radius), returned / half_space, 1e-9);
  EXPECT_GT(body_return(dipole, 1e-6) * half_space, 0.9999);
  EXPECT_THROW(body_return(dipole, 0), InputError);
}

}  // namespace
}  // namespace shellgrid
