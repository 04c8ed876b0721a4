// SPDX-License-Identifier: AGPL-3.0-or-later
#include "solvers/shell_texture/layered_diffusion.h"

#include <gtest/gtest.h>

#include <Eigen/Geometry>
#include <algorithm>
#include <cmath>
#include <map>
#include <utility>

#include "meshing/core/error.h"
#include "solvers/scattering/fresnel.h"
#include "tests/support/closed_shapes.h"

namespace shellgrid {
namespace {

ShellLayer layer(float scattering, const Rgb& absorption) {
  ShellLayer one;
  one.reduced = one.extinction = scattering + absorption;
  one.absorption = absorption;
  return one;
}

LayeredMatter homogeneous(float scattering, const Rgb& absorption, double ior = 1.4) {
  const ShellLayer one = layer(scattering, absorption);
  return {std::vector<ShellLayer>(4, one), 0.3, one, ior};
}

LayeredDiffusion::Flow flow_of_all(const LayeredDiffusion& body, const TriangleMesh& mesh) {
  return body.flow(std::vector<int>(static_cast<std::size_t>(mesh.vertex_count()), 0), {Rgb::Ones()});
}

// Each triangle in four.
TriangleMesh finer(const TriangleMesh& mesh) {
  std::vector<Vec3> vertices;
  for (int v = 0; v < mesh.vertex_count(); ++v) vertices.push_back(mesh.vertex(v));
  std::map<std::pair<int, int>, int> middles;
  std::vector<Eigen::Vector3i> faces;
  for (int f = 0; f < mesh.face_count(); ++f) {
    int middle[3];
    for (int k = 0; k < 3; ++k) {
      const auto [a, b] = std::minmax(mesh.faces(f, k), mesh.faces(f, (k + 1) % 3));
      const auto found = middles.try_emplace({a, b}, static_cast<int>(vertices.size()));
      if (found.second) vertices.push_back((mesh.vertex(a) + mesh.vertex(b)) / 2);
      middle[k] = found.first->second;
    }
    for (int k = 0; k < 3; ++k) faces.emplace_back(mesh.faces(f, k), middle[k], middle[(k + 2) % 3]);
    faces.emplace_back(middle[0], middle[1], middle[2]);
  }
  return shapes::from_lists(vertices, faces);
}

// φ = A sinh(κ r)/r within a ball.
TEST(LayeredDiffusion, OfABallIsItsClosedForm) {
  const double radius = 6;
  const TriangleMesh ball = shapes::sphere(radius, 5);
  for (const double ior : {1.0, 1.5}) {
    const Rgb absorption(0.002f, 0.03f, 0.1f);
    const LayeredDiffusion body(ball, homogeneous(2, absorption, ior), 0.45);
    const LayeredDiffusion::Flow flow = flow_of_all(body, ball);
    for (int c = 0; c < 3; ++c) {
      const double reduced = 2 + static_cast<double>(absorption[c]), diffusion = 1 / (3 * reduced);
      const double kappa = std::sqrt(static_cast<double>(absorption[c]) / diffusion), x = kappa * radius;
      const double slope = diffusion * (x / std::tanh(x) - 1) / radius;  // J of φ = 1 at the surface
      const double expected = slope / (1 + 2 * diffuse_fresnel(ior).boundary_factor * slope);
      EXPECT_NEAR(flow.inward[0][c] / expected, 1, 0.015) << ior << " " << c;
    }
  }
}

TEST(LayeredDiffusion, KnowsThePlanesOfABoxHoweverTheyLie) {
  const TriangleMesh straight = shapes::box(Vec3(12, 9, 10));
  const LayeredMatter matter = homogeneous(1.5, Rgb(0.02f, 0.08f, 0.3f));
  const double area = 2 * (12 * 9 + 9 * 10 + 12 * 10);
  Rgb first = Rgb::Zero();
  for (const TriangleMesh& mesh : {straight, shapes::rotated(straight, 3)})
    for (const double spacing : {0.4, 0.31, 0.25}) {
      const LayeredDiffusion::Flow flow = flow_of_all(LayeredDiffusion(mesh, matter, spacing), mesh);
      EXPECT_NEAR(static_cast<double>(flow.areas[0]) / area, 1, 0.06) << spacing;
      if (!(first > 0).all()) first = flow.inward[0];
      for (int c = 0; c < 3; ++c) EXPECT_NEAR(flow.inward[0][c] / first[c], 1, 0.05) << spacing << " " << c;
    }
}

// In the middle of a face far from edges light flows in as into a half-space, by layers too.
TEST(LayeredDiffusion, FarFromEdgesIsAPlane) {
  LayeredMatter matter = homogeneous(2, Rgb(0.1f, 0.3f, 0.6f), 1.3);
  matter.layers[0] = layer(5, Rgb(0.5f, 0.1f, 0.02f));
  matter.layers[2] = layer(1, Rgb(0.02f, 0.6f, 0.1f));
  const TriangleMesh mesh = finer(finer(finer(finer(shapes::box(Vec3(16, 16, 16))))));
  std::vector<int> pieces(static_cast<std::size_t>(mesh.vertex_count()), 0);
  for (int v = 0; v < mesh.vertex_count(); ++v) {
    Vec3 off = mesh.vertex(v).cwiseAbs();
    std::sort(off.data(), off.data() + 3);
    pieces[v] = off[1] < 2 ? 1 : 0;
  }
  Rgb exact = Rgb::Zero();
  for (int c = 0; c < 3; ++c) {
    const ShellColumn::Light light = ShellColumn(matter.layers, c, matter.layer_thickness, matter.ior).light(0);
    const double slope = 2 * std::sqrt(static_cast<double>(matter.core.absorption[c] / (3 * matter.core.reduced[c])));
    const double half_space = (1 - slope) / (1 + slope);
    exact[c] = static_cast<float>(light.entering -
                                  light.rising * light.through * half_space / (1 - half_space * (1 - light.lost)));
  }
  for (const double spacing : {0.5, 0.37, 0.2}) {
    const LayeredDiffusion::Flow flow =
        LayeredDiffusion(mesh, matter, spacing).flow(pieces, {Rgb::Ones(), Rgb::Ones()});
    for (int c = 0; c < 3; ++c) EXPECT_NEAR(flow.inward[1][c] / exact[c], 1, 0.02) << spacing << " " << c;
  }
}

TEST(LayeredDiffusion, OfWhiteMatterKeepsAllLight) {
  const TriangleMesh mesh = shapes::rotated(shapes::box(Vec3(6, 4, 5)), 5);
  const LayeredDiffusion body(mesh, homogeneous(3, Rgb::Zero()), 0.25);
  EXPECT_LT(flow_of_all(body, mesh).inward[0].abs().maxCoeff(), 1e-4f);
  // Lit from one side what comes in there goes out elsewhere.
  std::vector<int> pieces;
  for (int v = 0; v < mesh.vertex_count(); ++v) pieces.push_back(mesh.vertices(v, 0) > 0 ? 1 : 0);
  const LayeredDiffusion::Flow flow = body.flow(pieces, {Rgb::Zero(), Rgb(1, 2, 0.5f)}, 1e-5);
  const Rgb in = flow.areas[1] * flow.inward[1], out = flow.areas[0] * flow.inward[0];
  EXPECT_GT(in[1], 0.02f * flow.areas[1]);
  for (int c = 0; c < 3; ++c) EXPECT_NEAR(out[c] / in[c], -1, 0.01);
  EXPECT_NEAR(in[1] / in[2], 4, 1e-3);
}

TEST(LayeredDiffusion, RefusesWhatIsNone) {
  const TriangleMesh mesh = shapes::box(Vec3(1, 1, 1));
  EXPECT_THROW(LayeredDiffusion(mesh, homogeneous(1, Rgb::Zero()), 0), InputError);
  EXPECT_THROW(LayeredDiffusion(mesh, LayeredMatter{}, 0.1), InputError);
}

}  // namespace
}  // namespace shellgrid
