// SPDX-License-Identifier: AGPL-3.0-or-later
#include "solvers/shell_texture/shell_texture_render.h"

#include <gtest/gtest.h>

#include <algorithm>
#include <cmath>
#include <memory>
#include <numbers>

#include "meshing/core/error.h"
#include "meshing/surface/half_edges.h"
#include "solvers/scattering/fresnel.h"
#include "solvers/shell_texture/core_light.h"
#include "tests/support/closed_shapes.h"
#include "tests/support/shell_shapes.h"

namespace shellgrid {
namespace {

constexpr double pi = std::numbers::pi;
constexpr double radius = 40, thickness = 4, voxel = 0.5, ior = 1.3, sigma = 0.05, albedo = 0.8;
// To the lower side of the deepest voxel that stands in the shell below the pole.
constexpr double seen_thickness = 4.22;
constexpr float single_value = 0.3f, multiple_value = 0.7f, back_value = 1.1f, below_value = 0.25f, returned = 0.4f;

// A ball whose shell texture function is the same everywhere.
struct Ball {
  TriangleMesh mesh = shapes::sphere(radius, 5);
  VertexMatrix normals = vertex_normals(mesh), directions;
  ShellVolume shell;
  std::unique_ptr<TransportObject> object;
  std::unique_ptr<ShellTextureLookup> texture;
  std::vector<Rgb> core;
  std::vector<Vec2f> coordinates;

  explicit Ball(float anisotropy = 0) {
    directions.resize(mesh.vertex_count(), 3);
    for (int v = 0; v < mesh.vertex_count(); ++v) {
      const Vec3 n = normals.row(v).transpose();
      directions.row(v) = n.unitOrthogonal().transpose();
    }
    Material material;
    material.extinction = Rgb::Constant(static_cast<float>(sigma));
    material.albedo = Rgb::Constant(static_cast<float>(albedo));
    material.anisotropy = Rgb::Constant(anisotropy);
    shell = test::shell_of([](const Vec3& p) { return p.norm() - radius; }, radius, voxel, thickness, material,
                           [&](const Vec3&, double) {
                             return test::ShellVoxel{material, 1};
                           });
    shell.ior = ior;
    object = std::make_unique<TransportObject>(TransportObject::of_surfaces(mesh, shell, ior));
    ShellTexture values;
    values.size = Vec3i(2, 2, 8);
    values.voxel = voxel;
    const std::size_t voxels = 32, count = values.directions.count();
    values.matter.assign(voxels, 1.0f);
    values.single.assign(voxels * count, Vec3f::Constant(single_value));
    values.multiple.assign(voxels * (count + 1), Vec3f::Constant(multiple_value));
    std::fill(values.multiple.begin() + static_cast<std::ptrdiff_t>(voxels * count), values.multiple.end(),
              Vec3f::Constant(back_value));
    values.error.assign(values.multiple.size(), -1.0f);
    values.below.assign(4 * (count + 1), Vec3f::Constant(below_value));
    std::fill(values.below.begin() + static_cast<std::ptrdiff_t>(4 * count), values.below.end(),
              Vec3f::Constant(returned));
    texture = look_up_as_it_is(values);
    coordinates.assign(static_cast<std::size_t>(mesh.vertex_count()), Vec2f(0.3f, 0.9f));
    core.assign(static_cast<std::size_t>(mesh.vertex_count()), Rgb(2, 3, 4));
  }

  TexturedFrames frames() const { return {mesh, normals, directions}; }
  RenderedImage picture(const ShellTextureSettings& settings, ShellTextureStatistics* statistics = nullptr) const {
    Camera camera;
    camera.position = Vec3(0, 0, 200);
    camera.fov = 2;
    camera.width = camera.height = 9;
    return render_shell_texture({*object, shell, frames(), *texture, coordinates, core}, lights, camera, settings,
                                statistics);
  }
  std::vector<Light> lights = {DirectionalLight{Vec3(0, 0, -1), Rgb(5, 6, 7)}};
};

double middle(const RenderedImage& picture, const std::string& layer) {
  return static_cast<double>(picture.image.find(layer)->values[40]);
}

// What leaves straight ahead: light that the shell scatters, and the core behind it.
double expected(int channel, bool outside, bool core, double phase = 1 / (4 * pi)) {
  const double light = 5 + channel, exitance = 2 + channel, through = std::exp(-sigma * seen_thickness);
  double radiance = 0;
  if (outside)
    radiance += albedo * (1 - through) * light *
                (static_cast<double>(multiple_value) / (4 * pi) + static_cast<double>(single_value) * phase);
  if (core)
    radiance +=
        albedo * (1 - through) * exitance * static_cast<double>(back_value) / (2 * pi) + through * exitance / pi;
  return radiance * fresnel_transmittance(1, ior) / (ior * ior);
}

TEST(ShellTextureRender, MarchesThroughLightAndCore) {
  const Ball ball;
  for (const bool outside : {false, true})
    for (const bool core : {false, true}) {
      ShellTextureSettings settings;
      settings.outside_light = outside;
      settings.core_light = core;
      ShellTextureStatistics statistics;
      const RenderedImage picture = ball.picture(settings, &statistics);
      const char* layers[] = {"exitance.R", "exitance.G", "exitance.B"};
      for (int c = 0; c < 3; ++c) {
        const double value = expected(c, outside, core);
        EXPECT_NEAR(middle(picture, layers[c]), value, 0.02 * value + 1e-9) << outside << core << c;
      }
      // Most of the shell is out of sight.
      EXPECT_GT(statistics.leaves_skipped, 20 * statistics.leaves_lit);
      EXPECT_GT(statistics.march_steps, 0);
    }
}

// Between vertices, the core's light is linear, not that of the nearest one.
TEST(ShellTextureRender, InterpolatesTheCoreBetweenVertices) {
  Ball ball;
  for (int v = 0; v < ball.mesh.vertex_count(); ++v) {
    const double x = ball.mesh.vertex(v).x();
    ball.core[v] = Rgb(1, static_cast<float>(std::max(0.0, 1 + 0.2 * x)), 1);
  }
  ShellTextureSettings settings;
  settings.outside_light = false;
  const RenderedImage picture = ball.picture(settings);
  const std::vector<float>&even = picture.image.find("exitance.R")->values,
        &rising = picture.image.find("exitance.G")->values;
  // The camera sees 5.6 mm of the ball across, x to the right; most of the light comes from the shell's bottom.
  for (int i = 0; i < 81; ++i) {
    const double x = ((i % 9 + 0.5) / 9 - 0.5) * 2 * 160 * std::tan(pi / 180);
    EXPECT_NEAR(static_cast<double>(rising[i] / even[i]), 1 + 0.2 * x * radius / (radius - thickness), 0.02) << i;
  }
}

TEST(ShellTextureRender, ScattersBeamsByTheirPhaseFunction) {
  const Ball ball(0.6f);
  ShellTextureSettings settings;
  settings.core_light = false;
  settings.similarity = false;
  // Straight back: the light comes along the ray of sight, to within the table's directions about the zenith.
  const double back = (1 - 0.36) / (4 * pi * std::pow(1 + 0.36 + 1.2, 1.5));
  EXPECT_NEAR(middle(ball.picture(settings), "exitance.G") / expected(1, true, false, back), 1, 0.03);
}

// As matter of reduced scattering that scatters evenly.
TEST(ShellTextureRender, TakesForwardScatteringForLess) {
  const Ball ball(0.6f);
  ShellTextureSettings settings;
  settings.core_light = false;
  const double scattering = sigma * albedo * 0.4, extinction = sigma * (1 - albedo) + scattering;
  const double fluence = 6 * static_cast<double>(multiple_value + single_value);
  const double seen = scattering / extinction * (1 - std::exp(-extinction * seen_thickness)) * fluence / (4 * pi) *
                      fresnel_transmittance(1, ior) / (ior * ior);
  EXPECT_NEAR(middle(ball.picture(settings), "exitance.G") / seen, 1, 0.02);
}

TEST(ShellTextureRender, LeavesOutWhatThePaperLeavesOut) {
  const Ball ball;
  ShellTextureSettings settings;
  settings.outside_light = false;
  settings.unscattered_core = false;
  const double seen = std::exp(-sigma * seen_thickness) * 3 / pi * fresnel_transmittance(1, ior) / (ior * ior);
  EXPECT_NEAR(middle(ball.picture(settings), "exitance.G") / (expected(1, false, true) - seen), 1, 0.02);
}

TEST(ShellTextureRender, RefusesCamerasInsideAndForeignCores) {
  Ball ball;
  Camera camera;
  camera.position = Vec3(1, 2, 3);
  EXPECT_THROW(
      render_shell_texture({*ball.object, ball.shell, ball.frames(), *ball.texture, ball.coordinates, ball.core},
                           ball.lights, camera, {}),
      InputError);
  ball.core.pop_back();
  EXPECT_THROW(ball.picture({}), InputError);
}

TEST(CoreLight, FallsOnTheCorePerArea) {
  const Ball ball;
  const SceneGeometry geometry(ball.mesh);
  const IncidentLight light(ball.frames(), geometry, ball.lights, ball.texture->directions(), 64);
  const SpreadLight spread(light, {}, ball.texture->size(), ball.coordinates);
  const CoreSurface core = core_surface(ball.frames(), spread, *ball.texture, ball.coordinates, thickness);
  double area = 0;
  for (int v = 0; v < ball.mesh.vertex_count(); ++v) {
    area += static_cast<double>(core.areas[v]);
    EXPECT_NEAR(static_cast<double>(core.points[v].norm()), radius - thickness, 1e-4);
    const double cosine = ball.normals(v, 2);
    EXPECT_NEAR(core.shell_reflection[v][0], returned, 1e-6);
    // Lit in front, in its own shadow behind; between the lowest ring and the horizon the table fades.
    if (cosine > 0.15) EXPECT_NEAR(core.power[v][1], 6 * below_value * core.areas[v], 1e-4 * core.areas[v]) << cosine;
    if (cosine < -0.01) EXPECT_EQ(core.power[v][1], 0) << cosine;
  }
  EXPECT_NEAR(area / (4 * pi * 36 * 36), 1, 0.01);
  // A shell as thick as the ball leaves no core.
  const CoreSurface none = core_surface(ball.frames(), spread, *ball.texture, ball.coordinates, 1.5 * radius);
  for (const float a : none.areas) EXPECT_EQ(a, 0);
}

// As much light and area in pieces as at the vertices, and values of pieces that bend gently come back at the vertices.
TEST(CoreLight, MayStandInPieces) {
  Ball ball;
  for (int v = 0; v < ball.mesh.vertex_count(); ++v) ball.coordinates[v] = Vec2f(0.37f * static_cast<float>(v), 0.9f);
  const SceneGeometry geometry(ball.mesh);
  const IncidentLight light(ball.frames(), geometry, ball.lights, ball.texture->directions(), 64);
  const SpreadLight spread(light, {}, ball.texture->size(), ball.coordinates);
  const VertexBuckets pieces(ball.frames(), vertex_areas(ball.mesh), 6.0);
  ASSERT_LT(3 * pieces.count(), ball.mesh.vertex_count());
  const CoreSurface fine = core_surface(ball.frames(), spread, *ball.texture, ball.coordinates, thickness),
                    core = core_surface(ball.frames(), spread, *ball.texture, ball.coordinates, thickness, &pieces);
  ASSERT_EQ(core.points.size(), static_cast<std::size_t>(pieces.count()));
  double areas[2] = {}, powers[2] = {};
  for (std::size_t v = 0; v < fine.areas.size(); ++v)
    areas[0] += static_cast<double>(fine.areas[v]), powers[0] += static_cast<double>(fine.power[v][1]);
  std::vector<Rgb> heights;
  for (int i = 0; i < pieces.count(); ++i) {
    areas[1] += static_cast<double>(core.areas[i]), powers[1] += static_cast<double>(core.power[i][1]);
    EXPECT_NEAR(core.shell_reflection[i][0], returned, 1e-6);
    for (const int v : pieces[i].members) EXPECT_EQ(pieces.of_vertex(v), i);
    heights.push_back(Rgb(1, static_cast<float>(pieces[i].middle.z()), 0));
  }
  EXPECT_NEAR(areas[1] / areas[0], 1, 1e-5);
  EXPECT_NEAR(powers[1] / powers[0], 1, 0.02);
  const std::vector<Rgb> values = at_vertices(ball.frames(), pieces, heights);
  for (int v = 0; v < ball.mesh.vertex_count(); ++v) {
    EXPECT_NEAR(values[v][0], 1, 1e-5);
    EXPECT_NEAR(values[v][1], ball.mesh.vertex(v).z(), 2);
  }
}

// What rays of sight meet is what light meets.
TEST(TransportObject, OfSurfacesHasTheSameFreeSpace) {
  const Ball ball;
  Material material;
  material.extinction = Rgb::Constant(0.5f);
  const ShellVolume shell =
      test::shell_of([](const Vec3& p) { return p.norm() - radius; }, radius, voxel, thickness, material,
                     [&](const Vec3& p, double depth) {
                       return test::ShellVoxel{material, depth < 1.2 && p.x() > 10 ? 0 : 1};
                     });
  const TransportObject whole(ball.mesh, shell, ior), seen = TransportObject::of_surfaces(ball.mesh, shell, ior);
  ASSERT_GT(whole.free_space().face_count(), 100);
  EXPECT_EQ(seen.free_space().vertices, whole.free_space().vertices);
  EXPECT_EQ(seen.free_space().faces, whole.free_space().faces);
  ShellVolume wrong = shell;
  for (int leaf = 0; leaf < wrong.albedo.leaf_count(); ++leaf)
    for (int k = 0; k < 512; ++k) wrong.albedo.leaf_values(leaf)[k] = Vec3f::Constant(2);
  EXPECT_THROW(TransportObject::of_surfaces(ball.mesh, wrong, ior), InputError);
}

// A fluence that falls along z, in one hexahedron about the ball: what goes outwards, and what comes in.
TEST(CoreLight, OfADiffusionGoesOutwards) {
  Ball ball;
  const SceneGeometry geometry(ball.mesh);
  const IncidentLight light(ball.frames(), geometry, ball.lights, ball.texture->directions(), 64);
  const SpreadLight spread(light, {}, ball.texture->size(), ball.coordinates);
  const CoreSurface core = core_surface(ball.frames(), spread, *ball.texture, ball.coordinates, thickness);
  VertexMatrix corners(8, 3);
  std::vector<Rgb> fluence;
  for (int a = 0; a < 8; ++a) {
    corners.row(a) << (a % 4 == 1 || a % 4 == 2 ? 50 : -50), (a % 4 > 1 ? 50 : -50), (a > 3 ? 50 : -50);
    fluence.push_back(Rgb::Constant(static_cast<float>(8 + 0.1 * corners(a, 2))));
  }
  const FluenceField field(corners, {0, 1, 2, 3, 4, 5, 6, 7}, fluence);
  const CoreDiffusion shine = core_from_fluence(ball.frames(), core, thickness, field, Rgb(0.2f, 1, 5));
  double down = 0, diffuse = 0;
  for (int v = 0; v < ball.mesh.vertex_count(); ++v) {
    const double phi = 8 + 0.1 * static_cast<double>(core.points[v].z()), slope = 0.1 * ball.normals(v, 2);
    EXPECT_NEAR(shine.exitance[v][1] / shine.scale[1], phi / 4 - slope / 2, 1e-4);
    EXPECT_NEAR(shine.irradiance[v][2] / shine.scale[2], phi / 4 + 5 * slope / 2, 1e-4);
    down += static_cast<double>(core.power[v][1]);
    diffuse += static_cast<double>(core.areas[v]) *
               (phi / 4 + slope / 2 - static_cast<double>(returned) * (phi / 4 - slope / 2));
  }
  EXPECT_NEAR(shine.scale[1], down / diffuse, 1e-3 * down / diffuse);
  EXPECT_THROW(core_from_fluence(ball.frames(), CoreSurface{}, thickness, field, Rgb::Ones()), InputError);
}

}  // namespace
}  // namespace shellgrid
