// SPDX-License-Identifier: AGPL-3.0-or-later
#include "solvers/transport/light_tracing.h"

#include <gtest/gtest.h>

#include <array>
#include <cmath>
#include <memory>
#include <numbers>

#include "meshing/core/error.h"
#include "solvers/diffusion/boundary_irradiance.h"
#include "solvers/scattering/fresnel.h"
#include "solvers/transport/tally_shapes.h"
#include "tests/support/closed_shapes.h"

namespace shellgrid {
namespace {

constexpr double pi = std::numbers::pi;

EnvironmentLight even_sky(float radiance) {
  EnvironmentLight sky;
  sky.zenith = sky.horizon = sky.ground = Rgb::Constant(radiance);
  return sky;
}

struct Traced {
  PathState state;
  LightTracingResult result;
};

Traced trace(const TransportObject& object, const std::vector<Light>& lights, double paths,
             const LightTracingOptions& options = {}) {
  const LightTracing tracing(object, lights, options);
  const PathKind kind = tracing.kind();
  PathState state(kind.scalars, kind.field_size);
  PathLimits limits;
  limits.paths = paths;
  follow_paths(kind, limits, state);
  return {state, tracing.result(state)};
}

Material matter(const Rgb& absorption, const Rgb& scattering, const Rgb& anisotropy = Rgb::Zero()) {
  return Material::from_absorption_scattering(absorption, scattering, anisotropy);
}

// What comes in enters or is mirrored; what enters leaves, is absorbed, or is a roulette's. What moves between channels
// adds up to nothing, and in each channel it is chance.
void expect_balance(const LightTracingResult& r) {
  double exchanged = 0, total = 0;
  for (int c = 0; c < 3; ++c) {
    const double in = r.incoming.channel[c].value;
    EXPECT_GT(in, 0);
    EXPECT_NEAR(r.entering.channel[c].value + r.mirrored.channel[c].value, in, 1e-9 * in);
    const double defect = r.entering.channel[c].value + r.roulette.channel[c].value + r.exchange.channel[c].value -
                          r.leaving.channel[c].value - r.absorbed_core.channel[c].value -
                          r.absorbed_shell.channel[c].value - r.lost.channel[c].value;
    EXPECT_NEAR(defect, 0, 1e-9 * in);
    for (const Estimate& chance : {r.roulette.channel[c], r.exchange.channel[c]})
      EXPECT_LT(std::abs(chance.value), 4 * chance.standard_error + 1e-9 * in);
    exchanged += r.exchange.channel[c].value;
    total += in;
  }
  EXPECT_NEAR(exchanged, 0, 1e-9 * total);
}

double surface_mean(const TriangleMesh& mesh, const std::vector<Rgb>& values, int channel) {
  double sum = 0, area = 0;
  for (int f = 0; f < mesh.face_count(); ++f) {
    const Vec3 a = mesh.corner(f, 0);
    const double third = (mesh.corner(f, 1) - a).cross(mesh.corner(f, 2) - a).norm() / 6;
    for (int k = 0; k < 3; ++k) sum += third * values[mesh.faces(f, k)][channel], area += third;
  }
  return sum / area;
}

TEST(LightTracing, IncomingPowerIsThatOfTheLight) {
  const TriangleMesh ball = shapes::sphere(10, 5);
  const TransportObject object(ball, matter(Rgb(1, 1, 1), Rgb(1, 1, 1)), 1);
  const auto expect_incoming = [&](const Light& light, double power, double tolerance = 2e-3) {
    const Traced traced = trace(object, {light}, 40000);
    const Estimate& e = traced.result.incoming.channel[1];
    EXPECT_NEAR(e.value, power, 4 * e.standard_error + tolerance * power);
    expect_balance(traced.result);
  };
  expect_incoming(DirectionalLight{Vec3(1, 2, -2).normalized(), Rgb(1, 2, 3)}, 2 * pi * 100);
  expect_incoming(even_sky(3), 3 * pi * 4 * pi * 100);
  const double sine = 10.0 / 25;
  expect_incoming(PointLight{Vec3(0, 25, 0), Rgb::Constant(7)}, 7 * 2 * pi * (1 - std::sqrt(1 - sine * sine)));
  // A small rectangle far away: like a point.
  expect_incoming(AreaLight{Vec3(0, 500, 0), Vec3(0, -1, 0), Vec3(0, 0, 1), 2, 3, Rgb::Constant(1000)},
                  6000 * pi * 100 / (500.0 * 500.0), 4e-3);
  EnvironmentLight lamp;
  lamp.lamps.push_back({Vec3(0, 0, 1), 0.01, 0, Rgb::Constant(50)});
  expect_incoming(lamp, 50 * 2 * pi * (1 - std::cos(0.01)) * pi * 100);
}

// A large area light near an object, against the radiance's integral over the sphere: form factor of a ball seen from
// each place of the rectangle.
TEST(LightTracing, AreaLightsShineByTheCosine) {
  const TriangleMesh ball = shapes::sphere(1, 5);
  const TransportObject object(ball, matter(Rgb(1, 1, 1), Rgb(1, 1, 1)), 1);
  const AreaLight light{Vec3(0, 0, 3), Vec3(0, 0, -1), Vec3(0, 1, 0), 4, 6, Rgb::Constant(2)};
  double expected = 0;
  constexpr int steps = 200;
  for (int i = 0; i < steps; ++i)
    for (int j = 0; j < steps; ++j) {
      const double x = 4 * ((i + 0.5) / steps - 0.5), y = 6 * ((j + 0.5) / steps - 0.5), d = x * x + y * y + 9;
      expected += 2 * pi * (1 / d) * (3 / std::sqrt(d)) * 24.0 / (steps * steps);  // π sin² · cos
    }
  const Traced traced = trace(object, {light}, 60000);
  const Estimate& e = traced.result.incoming.channel[0];
  EXPECT_NEAR(e.value, expected, 4 * e.standard_error + 2e-3 * expected);
}

// The mesh engine against the analytic sphere: homogeneous, three materials in one path.
TEST(LightTracing, BallAgreesWithTheSphereOfShells) {
  const double radius = 2;
  const TriangleMesh ball = shapes::sphere(radius, 6);
  const Rgb absorption(0.01f, 0.1f, 0.5f), scattering(3, 1.5f, 0.7f), anisotropy(0, 0.5f, 0.85f);
  for (const double ior : {1.0, 1.4}) {
    const TransportObject object(ball, matter(absorption, scattering, anisotropy), ior);
    const Traced traced = trace(object, {DirectionalLight{Vec3(0.2, -1, 0.3).normalized(), Rgb::Ones()}}, 60000);
    expect_balance(traced.result);
    for (int c = 0; c < 3; ++c) {
      TallyProblem p;
      p.shape = TallyShape::sphere;
      p.source = TallySource::parallel;
      p.layers = {{absorption[c], scattering[c], anisotropy[c], radius}};
      p.ior = ior;
      p.bins = 1;
      const TallyTransport sphere(p);
      const PathKind kind = sphere.kind();
      PathState state(kind.scalars, kind.field_size);
      PathLimits limits;
      limits.paths = 60000;
      follow_paths(kind, limits, state);
      const TallyResult expected = sphere.result(state);
      const double power = pi * radius * radius;
      const auto compare = [&](const Estimate& found, const Estimate& share) {
        const double error = std::hypot(found.standard_error, power * share.standard_error);
        EXPECT_NEAR(found.value, power * share.value, 4 * error + 2e-3 * power * share.value) << c << " " << ior;
      };
      compare(traced.result.leaving.channel[c], expected.diffuse_reflectance);
      compare(traced.result.mirrored.channel[c], expected.specular_reflectance);
      compare(traced.result.absorbed_core.channel[c], expected.absorbed[0]);
    }
  }
}

// Uniform radiance 1 from everywhere about a white body: as much leaves as enters, everywhere: M = q = π · ∫ 2μ F_t dμ,
// whatever shape, index and matter.
TEST(LightTracing, WhiteFurnace) {
  const TriangleMesh ball = shapes::sphere(1, 3), ring = shapes::torus(2, 0.7, 40, 20),
                     cube = shapes::box(Vec3(1, 2, 3)), cone = shapes::double_cone(30, 1, 4, 0.2);
  for (const TriangleMesh* mesh : {&ball, &ring, &cube, &cone})
    for (const double ior : {1.0, 1.33, 2.4})
      for (const bool grey : {true, false}) {
        const TransportObject object(*mesh,
                                     grey ? matter(Rgb::Zero(), Rgb(2, 2, 2), Rgb(0.5f, 0.5f, 0.5f))
                                          : matter(Rgb::Zero(), Rgb(0.5f, 2, 8), Rgb(-0.3f, 0, 0.8f)),
                                     ior);
        const Traced traced = trace(object, {even_sky(1)}, 8000);
        expect_balance(traced.result);
        for (int c = 0; c < 3; ++c) {
          const double in = traced.result.incoming.channel[c].value;
          EXPECT_LE(traced.result.lost.channel[c].value, 1e-4 * in);
          const double entering = surface_mean(*mesh, traced.result.irradiance, c),
                       leaving = surface_mean(*mesh, traced.result.exitance, c);
          if (grey) {
            EXPECT_NEAR(leaving, entering, 1e-3 * pi);
          }
          EXPECT_NEAR(entering, pi * diffuse_fresnel(ior).exit_normalization, 0.04 * pi);
        }
        // Vertex by vertex, within the errors that are claimed, where each sees hundreds of paths.
        if (!grey || mesh->vertex_count() > 40) continue;
        double squares = 0;
        for (int v = 0; v < mesh->vertex_count(); ++v)
          squares += std::pow((traced.result.exitance[v][1] - pi * diffuse_fresnel(ior).exit_normalization) /
                                  traced.result.exitance_error[v][1],
                              2);
        EXPECT_LT(squares / mesh->vertex_count(), 1 + 4 * std::sqrt(2.0 / mesh->vertex_count()));
        EXPECT_GT(squares / mesh->vertex_count(), 0.1);
      }
}

// The light that enters is what the diffusion solver lets enter, in the same units, for every kind of light.
TEST(LightTracing, EnteringPowerIsTheDiffusionSolvers) {
  const TriangleMesh ball = shapes::sphere(3, 5);
  const SceneGeometry geometry(ball);
  const TransportObject object(ball, matter(Rgb::Ones(), Rgb::Zero()), 1.5);
  EnvironmentLight sky;
  sky.zenith = Rgb(1, 2, 3);
  sky.horizon = Rgb(0.5f, 0.2f, 0.1f);
  sky.lamps.push_back({Vec3(1, 1, 0).normalized(), 0.3, 0.5, Rgb(20, 10, 5)});
  EnvironmentLight picture;
  auto image = std::make_shared<Image>();
  image->width = 16;
  image->height = 8;
  image->channels.reserve(3);
  for (const char* name : {"R", "G", "B"}) {
    Image::Channel& channel = image->add(name);
    for (std::size_t i = 0; i < channel.values.size(); ++i) channel.values[i] = i % 37 == 5 ? 60.0f : 0.5f;
  }
  picture.image = image;
  picture.up = Vec3(0.3, 1, 0.2);
  for (const Light& light :
       {Light(DirectionalLight{Vec3(0.3, -1, 0.2).normalized(), Rgb(1, 2, 3)}),
        Light(PointLight{Vec3(4, 4, 0), Rgb(300, 200, 100)}),
        Light(AreaLight{Vec3(0, 5, 1), Vec3(0, -1, 0.2).normalized(), Vec3(0, 1, 1), 6, 2, Rgb(1, 2, 4)}), Light(sky),
        Light(picture)}) {
    const SurfaceIrradiance expected = surface_irradiance(ball, geometry, {light}, 1.5, 2048);
    const Traced traced = trace(object, {light}, 60000);
    for (int c = 0; c < 3; ++c) {
      const double power = surface_mean(ball, expected.values, c) * 4 * pi * 9;
      const Estimate& e = traced.result.entering.channel[c];
      EXPECT_NEAR(e.value, power, 4 * e.standard_error + 6e-3 * power) << light.index() << " " << c;
    }
  }
}

// Exitance of each vertex is what the density of light there says: a clear ball of index 1 lets light pass straight.
TEST(LightTracing, ClearMatterPassesLightToTheOtherSide) {
  const TriangleMesh ball = shapes::sphere(5, 4);
  const TransportObject object(ball, matter(Rgb(0.05f, 0.1f, 0.2f), Rgb::Zero()), 1);
  const Traced traced = trace(object, {DirectionalLight{Vec3(0, 0, -1), Rgb::Ones()}}, 200000);
  double squares = 0;
  int count = 0;
  for (int v = 0; v < ball.vertex_count(); ++v) {
    const double cosine = ball.vertex(v).z() / 5;
    for (int c = 0; c < 3; ++c) {
      const double sigma = c == 0 ? 0.05 : c == 1 ? 0.1 : 0.2;
      const double out = traced.result.exitance[v][c], in = traced.result.irradiance[v][c];
      if (cosine > 0.1) {
        EXPECT_EQ(out, 0);
      } else if (cosine < -0.3) {
        EXPECT_EQ(in, 0);
        const double expected = -cosine * std::exp(-sigma * 10 * -cosine);
        squares += std::pow((out - expected) / (traced.result.exitance_error[v][c] + 0.01 * expected), 2);
        ++count;
      }
    }
  }
  EXPECT_LT(squares / count, 1.5);
  EXPECT_GT(squares / count, 0.3);
}

TEST(LightTracing, SameBitsWhereverInterrupted) {
  const TriangleMesh ball = shapes::sphere(1, 3);
  const TransportObject object(ball, matter(Rgb(0.1f, 0.2f, 0.3f), Rgb(1, 2, 3), Rgb(0.1f, 0.2f, 0.3f)), 1.3);
  const LightTracing tracing(object, {even_sky(1)}, {});
  const PathKind kind = tracing.kind();
  PathState whole(kind.scalars, kind.field_size), parts = whole;
  PathLimits limits;
  limits.paths = 5000;
  follow_paths(kind, limits, whole);
  for (const double paths : {777.0, 3333.0, 5000.0}) {
    limits.paths = paths;
    follow_paths(kind, limits, parts);
  }
  EXPECT_EQ(whole.field_sum, parts.field_sum);
  EXPECT_EQ(whole.field_square, parts.field_square);
  EXPECT_EQ(whole.sum, parts.sum);
}

// The error of the exitance that is claimed is the one that is there, and falls with the square root of the paths.
TEST(LightTracing, StandardErrorsAreTrueAndFall) {
  const TriangleMesh ball = shapes::sphere(2, 3);
  const TransportObject object(ball, matter(Rgb(0.1f, 0.1f, 0.1f), Rgb(2, 2, 2)), 1.3);
  const std::vector<Light> sun = {DirectionalLight{Vec3(0, 0, -1), Rgb::Ones()}};
  LightTracingOptions other;
  other.seed = 1;
  const Traced few = trace(object, sun, 10000, other), many = trace(object, sun, 160000);
  EXPECT_NEAR(few.result.relative_error.value() / many.result.relative_error.value(), 4, 0.15);
  double squares = 0;
  int count = 0;
  for (int v = 0; v < ball.vertex_count(); ++v) {
    const double expected_error = std::hypot(4.0 * many.result.exitance_error[v][0], many.result.exitance_error[v][0]);
    if (!(expected_error > 0)) continue;
    squares += std::pow((few.result.exitance[v][0] - many.result.exitance[v][0]) / expected_error, 2);
    ++count;
  }
  EXPECT_NEAR(squares / count, 1, 4 * std::sqrt(2.0 / count) + 0.1);
}

// Light that dives deep into a thick body takes leaps there. A white one returns it all, and others absorb what the
// sphere of one layer does.
TEST(LightTracing, ThickBodiesAreLeaptThrough) {
  const double radius = 2;
  const TriangleMesh ball = shapes::sphere(radius, 5);
  const std::vector<Light> sun = {DirectionalLight{Vec3(0.6, 0, -0.8), Rgb::Ones()}};
  for (const float scattering : {1e3f, 1e5f}) {
    const Rgb absorption(0, 1e-6f * scattering, 1e-4f * scattering);
    const Material material = matter(absorption, Rgb::Constant(scattering), Rgb::Constant(0.3f));
    const Traced traced = trace(TransportObject(ball, material, 1.4), sun, 12000);
    expect_balance(traced.result);
    EXPECT_EQ(traced.state.count(PathEvent::limit_roulette), 0u);
    EXPECT_GT(traced.state.count(PathEvent::leaps), 0u);
    for (int c = 0; c < 3; ++c) {
      const double entering = traced.result.entering.channel[c].value;
      const Estimate& absorbed = traced.result.absorbed_core.channel[c];
      EXPECT_EQ(absorbed.value > 0, c > 0);
      TallyProblem p;
      p.shape = TallyShape::sphere;
      p.source = TallySource::parallel;
      p.layers = {{material.extinction[c] * (1 - double{material.albedo[c]}),
                   material.extinction[c] * double{material.albedo[c]}, 0.3, radius}};
      p.ior = 1.4;
      p.bins = 1;
      p.seed = 7;
      const TallyTransport sphere(p);
      const PathKind kind = sphere.kind();
      PathState state(kind.scalars, kind.field_size);
      PathLimits limits;
      limits.paths = 12000;
      follow_paths(kind, limits, state);
      const TallyResult expected = sphere.result(state);
      const double share = 1 - expected.specular_reflectance.value;
      EXPECT_NEAR(
          absorbed.value / entering, expected.absorbed[0].value / share,
          4 * std::hypot(absorbed.standard_error / entering, expected.absorbed[0].standard_error / share) + 1e-12)
          << "channel " << c << " at " << scattering;
    }
  }
}

TEST(LightTracing, WithoutInterreflectionLightThatLeavesIsGone) {
  const TriangleMesh ring = shapes::torus(2, 0.7, 40, 20);
  const TransportObject object(ring, matter(Rgb::Zero(), Rgb(4, 4, 4)), 1.4);
  LightTracingOptions options;
  options.interreflection = false;
  const Traced once = trace(object, {even_sky(1)}, 8000, options), again = trace(object, {even_sky(1)}, 8000);
  EXPECT_GT(again.result.incoming.channel[0].value, 1.05 * once.result.incoming.channel[0].value);
  EXPECT_LE(once.state.count(PathEvent::object_met), once.state.paths);
}

// The share of parallel light that passes a ball of index 1 is the mean of e^{−2 σ √(R² − b²)} over its disc.
TEST(LightTracing, ABallThatOnlyAbsorbsFollowsBeersLaw) {
  const TransportObject object(shapes::sphere(2, 5), matter(Rgb(0.1f, 0, 2), Rgb::Zero()), 1);
  const Traced traced = trace(object, {DirectionalLight{Vec3(0, 0.6, -0.8), Rgb::Ones()}}, 100000);
  for (int c = 0; c < 3; ++c) {
    const double depth = std::array{0.4, 0.0, 8.0}[static_cast<std::size_t>(c)];  // 2 σ R
    const double passed = depth > 0 ? 2 * (1 - (1 + depth) * std::exp(-depth)) / (depth * depth) : 1;
    const Estimate in = traced.result.entering.channel[c], out = traced.result.leaving.channel[c];
    EXPECT_NEAR(out.value / in.value, passed, 4 * out.standard_error / in.value + 2e-3) << c;
    EXPECT_NEAR(traced.result.absorbed_core.channel[c].value, in.value - out.value, 0.02 * in.value) << c;
  }
}

TEST(LightTracing, WithoutLightAllIsZero) {
  const TransportObject object(shapes::sphere(1, 2), matter(Rgb::Ones(), Rgb::Ones()), 1.3);
  for (const std::vector<Light>& dark :
       {std::vector<Light>{}, {even_sky(0)}, {DirectionalLight{}, PointLight{Vec3(3, 0, 0), Rgb::Zero()}}}) {
    const Traced traced = trace(object, dark, 1000);
    EXPECT_EQ(traced.state.paths, 1000u);
    EXPECT_EQ(traced.result.incoming.channel[0].value, 0);
    for (const Rgb& exitance : traced.result.exitance) EXPECT_TRUE((exitance == 0).all());
  }
}

TEST(LightTracing, NonsenseIsRefused) {
  const TriangleMesh ball = shapes::sphere(1, 2);
  const Material grey = matter(Rgb::Ones(), Rgb::Ones());
  EXPECT_THROW(TransportObject(ball, grey, 0.9), InputError);
  EXPECT_THROW(TransportObject(TriangleMesh(), grey, 1), InputError);
  EXPECT_THROW(TransportObject(ball, matter(-2 * Rgb::Ones(), Rgb::Ones()), 1), InputError);
  const TransportObject object(ball, grey, 1.3);
  EXPECT_THROW(LightTracing(object, {PointLight{Vec3(0.1, 0.2, 0), Rgb::Ones()}}, {}), InputError);
}

}  // namespace
}  // namespace shellgrid
