// SPDX-License-Identifier: AGPL-3.0-or-later
#include "solvers/shell_texture/spread_light.h"

#include <gtest/gtest.h>

#include <cmath>
#include <numbers>

#include "meshing/core/error.h"
#include "meshing/surface/half_edges.h"
#include "solvers/shell_texture/irradiance_tracing.h"
#include "tests/support/base_volumes.h"
#include "tests/support/closed_shapes.h"

namespace shellgrid {
namespace {

constexpr double pi = std::numbers::pi;

double total(const IrradianceKernels& k, int kernel, int band, int channel) {
  double sum = 0;
  for (int r = 0; r < k.rings; ++r) {
    const double area = pi * k.ring * k.ring * (2 * r + 1);
    sum += area * static_cast<double>(k.values[(kernel * k.bands() + band) * k.rings + r][channel]);
  }
  return sum;
}

// Light that enters everywhere is light that enters at one place, seen from everywhere.
TEST(IrradianceKernels, AddUpToWhatEvenLightLeaves) {
  BaseVolume volume = test::layer({2, 3, 8}, Vec3f(1.5f, 2, 3), Vec3f(0.7f, 0.8f, 0.9f), 0, 1);
  IrradianceOptions traced;
  traced.paths = 30000;
  traced.directions = {24, 4};
  const ShellTexture t = trace_irradiance(volume, traced);
  KernelOptions options;
  options.paths = 4e5;
  const IrradianceKernels kernels = trace_kernels(volume, std::vector<std::uint8_t>(6, 0), options);
  ASSERT_TRUE(kernels.is_sound(volume.size));
  ASSERT_EQ(kernels.count(), 1);
  EXPECT_EQ(kernels.first_layer, (std::vector<int>{0, 1, 2, 4, 8}));
  for (int c = 0; c < 3; ++c) {
    for (int band = 0; band < kernels.bottom(); ++band) {
      double expected = 0;
      for (int z = kernels.first_layer[band]; z < kernels.first_layer[band + 1]; ++z)
        for (int l = 0; l < t.directions.count(); ++l) {
          const int ring = l / t.directions.turns;
          const double step = pi / (2 * t.directions.rings);
          const double solid_angle =
              2 * pi / t.directions.turns * (std::cos(ring * step) - std::cos((ring + 1) * step));
          for (std::size_t texel = 0; texel < 6; ++texel)
            expected +=
                volume.voxel * solid_angle / pi / 6 * static_cast<double>(t.multiple[t.at(l, 6 * z + texel)][c]);
        }
      EXPECT_NEAR(total(kernels, 0, band, c) / expected, 1, 0.03) << c << " " << band;
    }
  }
  // Deeper down it has gone farther, and farther than the tile is wide.
  EXPECT_GT(kernels.radius(0.97), 1.5 * 2 * volume.voxel);
  EXPECT_LT(kernels.value(0, 4, 0.2)[0] / kernels.value(0, 4, 2)[0],
            kernels.value(0, 0, 0.2)[0] / kernels.value(0, 0, 2)[0]);
}

TEST(IrradianceKernels, BelongToTheirPlaces) {
  // Two halves: a strong absorber, and what lets light through.
  BaseVolume volume = test::layer({16, 16, 6}, Vec3f::Constant(3), Vec3f::Constant(0.99f), 0, 1.3);
  for (std::size_t v = 0; v < volume.voxel_count(); ++v)
    if (v % 16 < 8) volume.albedo[v].setConstant(0.3f);
  const auto domains = kernel_domains(volume);
  ASSERT_EQ(domains.size(), 256u);
  EXPECT_NE(domains[4], domains[12]);
  EXPECT_EQ(domains[4], domains[4 + 16 * 7]);
  std::vector<std::uint8_t> of_texel(256);
  for (std::size_t t = 0; t < 256; ++t) of_texel[t] = t % 16 < 8 ? 0 : 1;
  const IrradianceKernels two = trace_kernels(volume, of_texel);
  ASSERT_EQ(two.count(), 2);
  EXPECT_GT(total(two, 1, 2, 0), 3 * total(two, 0, 2, 0));
  const IrradianceKernels one = two.merged();
  EXPECT_EQ(one.count(), 1);
  EXPECT_NEAR(total(one, 0, 2, 0), (total(two, 0, 2, 0) + total(two, 1, 2, 0)) / 2, 1e-4);
  EXPECT_THROW(trace_kernels(volume, std::vector<std::uint8_t>(255)), InputError);
}

TEST(IrradianceKernels, ServeOverhangsAndMatterWithHoles) {
  BaseVolume volume = test::layer({10, 10, 8}, Vec3f::Constant(2), Vec3f::Constant(0.9f), 0.5f, 1.4);
  test::cut_mushroom(volume);
  EXPECT_TRUE(trace_kernels(volume, std::vector<std::uint8_t>(100, 0)).is_sound(volume.size));
  for (int z = 0; z < 8; ++z) volume.free[volume.index(4, 4, z)] = 1;
  EXPECT_TRUE(trace_kernels(volume, std::vector<std::uint8_t>(100, 0)).is_sound(volume.size));
  const BaseVolume voxel = test::layer({1, 1, 1}, Vec3f::Constant(2), Vec3f::Constant(0.9f), 0, 1);
  EXPECT_TRUE(trace_kernels(voxel, {0}).is_sound(voxel.size));
}

// A flat plate, of which a screen far above covers the half x < 0.
struct HalfLit {
  TriangleMesh plate;
  VertexMatrix normals, directions;
  std::vector<Vec2f> coordinates;
  BaseVolume volume = test::layer({4, 4, 8}, Vec3f(1.5f, 2, 3), Vec3f(0.95f, 0.9f, 0.5f), 0, 1);
  IrradianceKernels kernels = trace_kernels(volume, std::vector<std::uint8_t>(16, 0));
  static constexpr int side = 121;
  static constexpr double spacing = 0.25;

  HalfLit() {
    std::vector<Vec3> vertices;
    std::vector<Eigen::Vector3i> faces;
    for (int j = 0; j < side; ++j)
      for (int i = 0; i < side; ++i) vertices.emplace_back((i - side / 2) * spacing, (j - side / 2) * spacing, 0);
    for (int j = 0; j + 1 < side; ++j)
      for (int i = 0; i + 1 < side; ++i) {
        const int a = j * side + i;
        faces.emplace_back(a, a + 1, a + side);
        faces.emplace_back(a + 1, a + side + 1, a + side);
      }
    plate = shapes::from_lists(vertices, faces);
    normals = VertexMatrix::Zero(side * side, 3);
    directions = normals;
    normals.col(2).setOnes();
    directions.col(0).setOnes();
    coordinates.assign(vertices.size(), Vec2f(1.5f, 2.5f));
  }
  int vertex(int i) const { return side / 2 * side + side / 2 + i; }
};

TEST(SpreadLight, CrossesShadowBordersAsItsKernelsDo) {
  const HalfLit scene;
  const TexturedFrames frames{scene.plate, scene.normals, scene.directions};
  // Its border between two rows of vertices.
  const TriangleMesh screen = shapes::moved(shapes::box(Vec3(100, 100, 1)), Vec3(-50 - scene.spacing / 2, 0, 20));
  const SceneGeometry geometry(shapes::joined(scene.plate, screen));
  const std::vector<Light> lights = {DirectionalLight{Vec3(0, 0, -1), Rgb(2, 3, 4)}};
  const LightDirections table;
  const IncidentLight light(frames, geometry, lights, table, 16);
  const SpreadLight spread(light, scene.kernels, scene.volume.size, scene.coordinates);
  const auto irradiance = [&](const std::vector<DirectionWeight>& list) {
    Vec3f sum = Vec3f::Zero();
    for (const DirectionWeight& one : list) sum += one.weight;
    return sum;
  };
  EXPECT_TRUE(spread.at(scene.vertex(-1)).empty());
  EXPECT_FLOAT_EQ(irradiance(spread.at(scene.vertex(0)))[1], 3);
  const int bands = scene.kernels.bands();
  // Of the light's direction, by the cosine: no responses are given.
  float overhead = 0;
  for (const DirectionWeight& one : blend_directions(table, Vec3(0, 0, 1)))
    overhead += one.weight[0] * static_cast<float>(table.direction(one.direction).z());
  const auto share = [&](int i, int band, int c) {
    if (band == scene.kernels.bottom())
      return static_cast<double>(irradiance(spread.at_bottom(scene.vertex(i)))[c]) / (2 + c);
    const SpreadLight::Bands found = spread.spread(scene.vertex(i));
    const Vec3f strength = found.strength.empty() ? found.own[band] : found.strength[band];
    // One direction's: a list is as strong as is said.
    if (!found.list.empty())
      EXPECT_LT((irradiance(found.list[band]) * overhead - strength).norm(), 1e-5) << band << " " << i;
    return static_cast<double>(strength[c] / overhead) / (2 + c);
  };
  double deepest_reach = 0;
  for (int band = 0; band < bands; ++band)
    for (int c = 0; c < 3; ++c)
      for (const int i : {-8, -4, -2, -1, 0, 1, 3, 7}) {
        // The kernel's share beyond a straight line at that distance, by quadrature.
        const double line = (-i - 0.5) * scene.spacing;
        double lit = 0, all = 0;
        const double step = 0.01;
        for (double r = step / 2; r < scene.kernels.rings * scene.kernels.ring; r += step) {
          const double light_there = r * static_cast<double>(scene.kernels.value(0, band, r)[c]);
          const double beyond = line >= r ? 0 : line <= -r ? 1 : std::acos(line / r) / pi;
          lit += light_there * beyond;
          all += light_there;
        }
        EXPECT_NEAR(share(i, band, c), lit / all, 0.02) << band << " " << c << " " << i;
        if (band == bands - 1 && c == 0 && i == -8) deepest_reach = lit / all;
      }
  EXPECT_GT(deepest_reach, 0.03);
  // What passes the bottom is of no other band.
  EXPECT_EQ(spread.spread(scene.vertex(-2)).list.size(), static_cast<std::size_t>(bands - 1));
  // Where there is little less or more of it the light itself serves, and the list is left out.
  const SpreadLight::Bands near = spread.spread(scene.vertex(10));
  EXPECT_FALSE(near.strength.empty());
  EXPECT_TRUE(near.list.empty());
  // Far from the border light stays as it is, without a list.
  EXPECT_TRUE(spread.spread(scene.vertex(45)).strength.empty());
  EXPECT_TRUE(spread.spread(scene.vertex(-45)).strength.empty());
  EXPECT_TRUE(spread.at_bottom(scene.vertex(-45)).empty());
  // Without kernels nothing spreads.
  const IrradianceKernels none;
  const SpreadLight sharp(light, none, scene.volume.size, scene.coordinates);
  EXPECT_TRUE(sharp.spread(scene.vertex(0)).strength.empty());
  EXPECT_TRUE(sharp.at_bottom(scene.vertex(-1)).empty());
}

// Lights of all kinds, summed one after the other.
TEST(IncidentLight, IsTheSumOfItsLights) {
  const HalfLit scene;
  const TexturedFrames frames{scene.plate, scene.normals, scene.directions};
  const TriangleMesh screen = shapes::moved(shapes::box(Vec3(100, 100, 1)), Vec3(-50.1, 0, 20));
  const SceneGeometry geometry(shapes::joined(scene.plate, screen));
  EnvironmentLight sky;
  sky.up = Vec3(0, 0, 1);
  sky.zenith = Rgb(0.9f, 1, 1.2f);
  sky.horizon = Rgb(0.5f, 0.4f, 0.3f);
  const std::vector<Light> lights = {sky, DirectionalLight{Vec3(-0.6, 0, -0.8), Rgb(2, 3, 4)},
                                     PointLight{Vec3(3, -2, 5), Rgb(7, 6, 5)}};
  const LightDirections table;
  const IncidentLight light(frames, geometry, lights, table, 100);
  for (const int i : {-40, -3, 0, 2, 40}) {
    const int vertex = scene.vertex(i);
    const Vec3 origin = scene.plate.vertex(vertex) + geometry.offset() * Vec3(0, 0, 1);
    std::vector<Vec3f> sums(table.count(), Vec3f::Zero());
    for (const SimpleLight& one : simple_lights(lights, 100)) {
      const IncidentBeam beam = incident_beam(one, origin);
      if (!(beam.direction.z() > 0) || geometry.occluded(origin, beam.direction, beam.distance)) continue;
      for (const DirectionWeight& part : blend_directions(table, beam.direction))
        sums[part.direction] += part.weight.cwiseProduct(beam.irradiance.matrix());
    }
    const std::vector<DirectionWeight> found = light.at(vertex);
    std::vector<Vec3f> listed(table.count(), Vec3f::Zero());
    for (std::size_t k = 0; k < found.size(); ++k) {
      listed[found[k].direction] = found[k].weight;
      if (k > 0) EXPECT_LT(found[k - 1].direction, found[k].direction);
    }
    EXPECT_GT(found.size(), 20u);
    for (int d = 0; d < table.count(); ++d) EXPECT_LT((listed[d] - sums[d]).norm(), 1e-5) << i << " " << d;
  }
}

// A ring's hole, its outer side and a screen's shadow on it: what few places see serves all.
TEST(IncidentLight, FaintLightsAreSeenByNeighbours) {
  const TriangleMesh ring = shapes::torus(10, 4, 240, 110);
  const VertexMatrix normals = vertex_normals(ring);
  VertexMatrix directions(normals.rows(), 3);
  for (Eigen::Index v = 0; v < normals.rows(); ++v) {
    const Vec3 normal = normals.row(v).transpose();
    directions.row(v) = normal.unitOrthogonal().transpose();
  }
  const TexturedFrames frames{ring, normals, directions};
  const SceneGeometry geometry(shapes::joined(ring, shapes::moved(shapes::box(Vec3(12, 3, 1)), Vec3(0, 0, 8))));
  EnvironmentLight sky;
  sky.up = Vec3(0, 0, 1);
  sky.zenith = Rgb(0.9f, 1, 1.2f);
  sky.horizon = Rgb(0.5f, 0.4f, 0.3f);
  sky.ground = Rgb(0.2f, 0.2f, 0.1f);
  const std::vector<Light> lights = {sky, DirectionalLight{Vec3(-0.6, 0, -0.8), Rgb(2, 3, 4)}};
  const LightDirections table;
  const IncidentLight exact(frames, geometry, lights, table, 400, false), shared(frames, geometry, lights, table, 400);
  double difference = 0, all = 0, worst = 0;
  const auto by_direction = [&](const IncidentLight& light, int vertex) {
    std::vector<Vec3f> sums(table.count(), Vec3f::Zero());
    for (const DirectionWeight& one : light.at(vertex)) sums[one.direction] = one.weight;
    return sums;
  };
  double brightest = 0;
  for (int v = 0; v < ring.vertex_count(); ++v) {
    const std::vector<Vec3f> a = by_direction(exact, v), b = by_direction(shared, v);
    double own = 0, light = 0;
    for (int d = 0; d < table.count(); ++d) {
      own += static_cast<double>((a[d] - b[d]).cwiseAbs().sum());
      light += static_cast<double>(a[d].sum());
    }
    difference += own;
    all += light;
    worst = std::max(worst, own);
    brightest = std::max(brightest, light);
  }
  EXPECT_LT(difference, 2e-4 * all);
  EXPECT_LT(worst, 0.01 * brightest);
  const IncidentLightStatistics now = shared.statistics(), before = exact.statistics();
  EXPECT_LT(now.shadow_rays, 0.3 * static_cast<double>(before.shadow_rays));
  EXPECT_GT(now.shadow_rays_shared, 0.7 * static_cast<double>(before.shadow_rays));
  EXPECT_EQ(before.shadow_rays_shared, 0);
}

TEST(SpreadLight, RefusesWhatDoesNotFit) {
  const HalfLit scene;
  const TexturedFrames frames{scene.plate, scene.normals, scene.directions};
  const SceneGeometry geometry(scene.plate);
  const IncidentLight light(frames, geometry, {}, {}, 16);
  EXPECT_THROW(SpreadLight(light, scene.kernels, scene.volume.size, std::vector<Vec2f>(3)), InputError);
  EXPECT_THROW(SpreadLight(light, scene.kernels, Vec3i(4, 5, 8), scene.coordinates), InputError);
}

}  // namespace
}  // namespace shellgrid
