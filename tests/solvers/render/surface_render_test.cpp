// SPDX-License-Identifier: AGPL-3.0-or-later
#include "solvers/render/surface_render.h"

#include <gtest/gtest.h>
#include <oneapi/tbb/global_control.h>

#include <Eigen/Geometry>
#include <cmath>
#include <filesystem>
#include <numbers>

#include "meshing/core/error.h"
#include "meshing/formats/image_file.h"
#include "solvers/scattering/fresnel.h"

namespace shellgrid {
namespace {

constexpr double pi = std::numbers::pi;

// A sphere of `rings` by 2·`rings` quadrilaterals, moved by `displace`.
template <class Displace>
TriangleMesh sphere(int rings, double radius, const Displace& displace) {
  TriangleMesh mesh;
  const int around = 2 * rings;
  mesh.vertices.resize((rings - 1) * around + 2, 3);
  auto place = [&](int index, double polar, double azimuth) {
    const Vec3 unit(std::sin(polar) * std::cos(azimuth), std::sin(polar) * std::sin(azimuth), std::cos(polar));
    mesh.vertices.row(index) = (radius * displace(unit) * unit).transpose();
  };
  for (int i = 1; i < rings; ++i)
    for (int j = 0; j < around; ++j) place((i - 1) * around + j, pi * i / rings, 2 * pi * j / around);
  const int north = (rings - 1) * around, south = north + 1;
  place(north, 0, 0);
  place(south, pi, 0);
  std::vector<Eigen::RowVector3i> faces;
  for (int j = 0; j < around; ++j) {
    const int next = (j + 1) % around;
    faces.emplace_back(north, j, next);
    faces.emplace_back(south, (rings - 2) * around + next, (rings - 2) * around + j);
    for (int i = 0; i + 2 < rings; ++i) {
      const int a = i * around + j, b = i * around + next, c = a + around, d = b + around;
      faces.emplace_back(a, c, d);
      faces.emplace_back(a, d, b);
    }
  }
  mesh.faces.resize(static_cast<int>(faces.size()), 3);
  for (std::size_t f = 0; f < faces.size(); ++f) mesh.faces.row(static_cast<int>(f)) = faces[f];
  return mesh;
}

TriangleMesh sphere(int rings, double radius) {
  return sphere(rings, radius, [](const Vec3&) { return 1.0; });
}

EnvironmentLight uniform_sky(float value) {
  EnvironmentLight sky;
  sky.zenith = sky.horizon = sky.ground = Rgb::Constant(value);
  return sky;
}

Camera small_camera(double distance = 60) {
  Camera camera;
  camera.position = Vec3(0.2 * distance, 0.1 * distance, distance);
  camera.fov = 30;
  camera.width = 60;
  camera.height = 40;
  return camera;
}

const std::vector<float>& layer(const Image& image, const std::string& name) {
  const Image::Channel* channel = image.find(name);
  EXPECT_NE(channel, nullptr) << name;
  return channel->values;
}

TEST(SurfaceRender, WhiteFurnaceShowsRadianceOne) {
  // A white object under uniform radiance 1 gives back all that enters: M = π ∫ 2μ F_t dμ. Whatever its shape.
  const TriangleMesh mesh =
      sphere(48, 10, [](const Vec3& u) { return 1 + 0.3 * std::sin(5 * u.x()) * std::cos(4 * u.y() + u.z()); });
  for (const double ior : {1.0, 1.3, 1.5}) {
    const auto exitance = static_cast<float>(pi * diffuse_fresnel(ior).exit_normalization);
    const TranslucentSurface surface{std::vector<Rgb>(mesh.vertex_count(), Rgb::Constant(exitance)), ior};
    const RenderedImage picture = render_surface(mesh, surface, {uniform_sky(1)}, small_camera(), {});
    for (const char* name : {"R", "G", "B"})
      for (const float value : layer(picture.image, name)) EXPECT_NEAR(value, 1, 2e-5);
    double covered = 0;
    for (const float value : layer(picture.image, "A")) covered += value;
    EXPECT_GT(covered, 200);
  }
}

TEST(SurfaceRender, ConvexOpaqueWhiteFurnaceShowsRadianceOne) {
  RenderSettings settings;
  settings.environment_samples = 2048;
  const RenderedImage picture =
      render_surface(sphere(64, 10), OpaqueSurface{Rgb::Ones()}, {uniform_sky(1)}, small_camera(), settings);
  for (const float value : layer(picture.image, "G")) EXPECT_NEAR(value, 1, 0.01);
}

TEST(SurfaceRender, LayersAddUpToTheBeauty) {
  const TriangleMesh mesh = sphere(32, 10);
  TranslucentSurface surface;
  for (int v = 0; v < mesh.vertex_count(); ++v)
    surface.exitance.push_back(Rgb(0.3f, 0.5f, 0.9f) * static_cast<float>(1.2 + mesh.vertices(v, 1) / 10));
  EnvironmentLight sky = uniform_sky(0.4f);
  sky.lamps.push_back({Vec3(0.3, 0.5, 0.8).normalized(), 0.3, 0.2, Rgb(9, 8, 7)});
  RenderSettings settings;
  settings.background = Rgb(0.1f, 0.2f, 0.3f);
  const RenderedImage picture = render_surface(mesh, surface, {sky}, small_camera(), settings);
  const auto& alpha = layer(picture.image, "A");
  for (int k = 0; k < 3; ++k) {
    const std::string channel(1, "RGB"[k]);
    const auto &beauty = layer(picture.image, channel), &exitance = layer(picture.image, "exitance." + channel),
               &specular = layer(picture.image, "specular." + channel);
    for (std::size_t i = 0; i < beauty.size(); ++i)
      EXPECT_NEAR(beauty[i], exitance[i] + specular[i] + (1 - alpha[i]) * (*settings.background)[k], 1e-5);
  }
}

TEST(SurfaceRender, MirrorLightFollowsFresnel) {
  // Black inside, uniform sky: only F(θ) is seen.
  const TriangleMesh mesh = sphere(128, 10);
  const TranslucentSurface surface{std::vector<Rgb>(mesh.vertex_count(), Rgb::Zero()), 1.5};
  Camera camera = small_camera();
  camera.position = Vec3(0, 0, 60);
  camera.width = 480;
  camera.height = 320;
  const RenderedImage picture = render_surface(mesh, surface, {uniform_sky(1)}, camera, {});
  const auto &specular = layer(picture.image, "specular.G"), &nz = layer(picture.image, "normal.Z"),
             &exitance = layer(picture.image, "exitance.G"), &alpha = layer(picture.image, "A");
  const std::size_t centre = 160 * 480 + 240;
  EXPECT_NEAR(specular[centre], 0.04, 1e-3);
  for (std::size_t i = 0; i < specular.size(); ++i) {
    EXPECT_EQ(exitance[i], 0);
    if (alpha[i] < 1 || nz[i] < 0.5) continue;
    const CameraRays rays(camera);
    const Vec3 direction = rays.direction(static_cast<double>(i % 480) + 0.5, static_cast<double>(i / 480) + 0.5);
    const Vec3 normal(layer(picture.image, "normal.X")[i], layer(picture.image, "normal.Y")[i], nz[i]);
    EXPECT_NEAR(specular[i], fresnel_reflectance(-direction.dot(normal), 1.5), 0.004);
  }
}

TEST(SurfaceRender, LampIsMirroredAtTheHalfwayNormal) {
  const TriangleMesh mesh = sphere(128, 10);
  const TranslucentSurface surface{std::vector<Rgb>(mesh.vertex_count(), Rgb::Zero()), 1.5};
  EnvironmentLight sky;
  const Vec3 lamp = Vec3(0, 1, 1).normalized();
  sky.lamps.push_back({lamp, 0.05, 0.0, Rgb::Constant(100)});
  Camera camera = small_camera();
  camera.position = Vec3(0, 0, 600);
  camera.fov = 3;
  camera.width = 480;
  camera.height = 320;
  const RenderedImage picture = render_surface(mesh, surface, {sky}, camera, {});
  const auto& g = layer(picture.image, "G");
  const auto brightest = static_cast<std::size_t>(std::max_element(g.begin(), g.end()) - g.begin());
  const Vec3 normal(layer(picture.image, "normal.X")[brightest], layer(picture.image, "normal.Y")[brightest],
                    layer(picture.image, "normal.Z")[brightest]);
  EXPECT_GT(normal.dot((lamp + Vec3(0, 0, 1)).normalized()), 0.99);
  EXPECT_NEAR(g[brightest], 100 * fresnel_reflectance(std::cos(pi / 8), 1.5), 0.4);
}

TEST(SurfaceRender, ObjectSeesItselfInItsMirror) {
  // A bright plate of light below a dark sphere in one mesh: the sphere's underside mirrors the plate.
  TriangleMesh ball = sphere(48, 10), mesh;
  const int n = ball.vertex_count(), m = ball.face_count();
  mesh.vertices.resize(2 * n, 3);
  mesh.faces.resize(2 * m, 3);
  TranslucentSurface surface;
  surface.ior = 1.5;
  for (int v = 0; v < n; ++v) {
    mesh.vertices.row(v) = ball.vertices.row(v);
    mesh.vertices.row(n + v) = ball.vertices.row(v) + Eigen::RowVector3d(0, -22, 0);
  }
  mesh.faces.topRows(m) = ball.faces;
  mesh.faces.bottomRows(m) = (ball.faces.array() + n).matrix();
  surface.exitance.assign(2 * n, Rgb::Zero());
  for (int v = n; v < 2 * n; ++v) surface.exitance[v] = Rgb(1, 0, 0);
  Camera camera = small_camera();
  camera.position = Vec3(0, 0, 80);
  const RenderedImage picture = render_surface(mesh, surface, {}, camera, {});
  double mirrored = 0;
  for (std::size_t i = 0; i < 60 * 20; ++i) mirrored += layer(picture.image, "specular.R")[i];
  double lower_ball = 0;
  for (std::size_t i = 60 * 20; i < 60 * 30; ++i) lower_ball += layer(picture.image, "specular.R")[i];
  EXPECT_GT(lower_ball, 0.1);
  EXPECT_GT(lower_ball, mirrored);
  EXPECT_GT(picture.statistics.mirror_rays, 100);
}

TEST(SurfaceRender, DiffuseLightKeepsItsPower) {
  // The cosine-weighted integral of the exit law over the hemisphere is M: so is the flux through a distant
  // picture, over all views. For a sphere one view suffices: flux = ∫ L dA dω = L̄ · projected area.
  const double radius = 10;
  const TriangleMesh mesh = sphere(128, radius);
  const TranslucentSurface surface{std::vector<Rgb>(mesh.vertex_count(), Rgb::Ones()), 1.4};
  Camera camera;
  camera.position = Vec3(0, 0, 10000);
  camera.fov = 0.13;
  camera.width = camera.height = 96;
  RenderSettings settings;
  settings.background = Rgb::Zero();
  const RenderedImage picture = render_surface(mesh, surface, {}, camera, settings);
  const double pixel = 2 * 10000 * std::tan(0.5 * 0.13 * pi / 180) / 96;
  double sum = 0;
  for (const float value : layer(picture.image, "exitance.G")) sum += value * pixel * pixel;
  // Per steradian M·4πr²/(4π) = r² by symmetry.
  EXPECT_NEAR(sum, radius * radius, 0.005 * radius * radius);
}

TEST(SurfaceRender, DepthAgreesWithTheSphere) {
  const double radius = 10;
  Camera camera = small_camera();
  camera.width = 480;
  camera.height = 320;
  const RenderedImage picture = render_surface(sphere(160, radius), OpaqueSurface{}, {DirectionalLight{}}, camera, {});
  const CameraRays rays(camera);
  const auto &depth = layer(picture.image, "depth.Z"), &alpha = layer(picture.image, "A");
  int compared = 0;
  for (int y = 0; y < camera.height; ++y)
    for (int x = 0; x < camera.width; ++x) {
      const std::size_t i = static_cast<std::size_t>(y) * camera.width + x;
      if (alpha[i] == 0) {
        EXPECT_EQ(depth[i], 0);
      }
      const Vec3 direction = rays.direction(x + 0.5, y + 0.5);
      const double along = -rays.origin().dot(direction);
      const double miss2 = rays.origin().squaredNorm() - along * along;
      if (miss2 > 0.6 * radius * radius) continue;
      const double expected = (along - std::sqrt(radius * radius - miss2)) * direction.dot(rays.axis());
      EXPECT_NEAR(depth[i], expected, 0.04) << x << ' ' << y;  // a pixel covers 0.13 mm of a slope
      ++compared;
    }
  EXPECT_GT(compared, 4000);
}

TEST(SurfaceRender, OpaqueFollowsLambertAndShadows) {
  Camera camera = small_camera();
  camera.position = Vec3(0, 0, 60);
  camera.width = 361;
  camera.height = 241;
  const auto at_centre = [&](const Vec3& light_direction) {
    const RenderedImage picture =
        render_surface(sphere(128, 10), OpaqueSurface{Rgb(0.5f, 0.25f, 1)},
                       {DirectionalLight{light_direction, Rgb::Constant(static_cast<float>(pi))}}, camera, {});
    const std::size_t centre = static_cast<std::size_t>(camera.height / 2) * camera.width + camera.width / 2;
    return Rgb(layer(picture.image, "R")[centre], layer(picture.image, "G")[centre], layer(picture.image, "B")[centre]);
  };
  const Rgb facing = at_centre(Vec3(0, 0, -1)), slanted = at_centre(Vec3(0, -std::sqrt(0.75), -0.5)),
            behind = at_centre(Vec3(0, 0, 1));
  EXPECT_NEAR(facing[0], 0.5, 2e-3);
  EXPECT_NEAR(facing[1], 0.25, 1e-3);
  EXPECT_NEAR(slanted[2], 0.5, 0.005);
  EXPECT_EQ(behind.abs().sum(), 0);
}

TEST(SurfaceRender, SameBytesAtAnyThreadCount) {
  const TriangleMesh mesh = sphere(32, 10);
  const TranslucentSurface surface{std::vector<Rgb>(mesh.vertex_count(), Rgb(1, 2, 3)), 1.5};
  EnvironmentLight sky = uniform_sky(0.3f);
  sky.lamps.push_back({Vec3(0.3, 0.5, 0.8).normalized(), 0.3, 0.2, Rgb(9, 8, 7)});
  RenderSettings settings;
  settings.floor = Floor{Rgb::Constant(0.4f), 1.4, 2.5};
  settings.environment_samples = 64;
  std::vector<Image> pictures;
  std::vector<std::int64_t> rays;
  for (const int threads : {1, 2, 4}) {
    oneapi::tbb::global_control limit(oneapi::tbb::global_control::max_allowed_parallelism, threads);
    const RenderedImage picture = render_surface(mesh, surface, {sky}, small_camera(), settings);
    pictures.push_back(picture.image);
    rays.push_back(picture.statistics.mirror_rays);
  }
  for (std::size_t i = 1; i < pictures.size(); ++i) {
    EXPECT_EQ(rays[i], rays[0]);
    for (std::size_t c = 0; c < pictures[0].channels.size(); ++c)
      EXPECT_EQ(pictures[i].channels[c].values, pictures[0].channels[c].values) << pictures[0].channels[c].name;
  }
}

TEST(SurfaceRender, EveryLayerSurvivesOpenExr) {
  const TriangleMesh mesh = sphere(16, 10);
  const TranslucentSurface surface{std::vector<Rgb>(mesh.vertex_count(), Rgb(1, 2, 3)), 1.5};
  const Image picture = render_surface(mesh, surface, {uniform_sky(0.5f)}, small_camera(), {}).image;
  const std::string path = testing::TempDir() + "surface_render_test.exr";
  write_exr(path, picture);
  const Image back = read_exr(path);
  std::filesystem::remove(path);
  ASSERT_EQ(back.width, picture.width);
  ASSERT_EQ(back.height, picture.height);
  EXPECT_EQ(back.channels.size(), 14u);
  for (const Image::Channel& channel : picture.channels) EXPECT_EQ(layer(back, channel.name), channel.values);
}

TEST(SurfaceRender, RefusesACameraInsideOrWithoutAView) {
  const TriangleMesh mesh = sphere(16, 10);
  Camera camera = small_camera();
  camera.position = Vec3(1, 2, 3);
  EXPECT_THROW(render_surface(mesh, OpaqueSurface{}, {}, camera, {}), InputError);
  camera = small_camera();
  camera.look_at = camera.position;
  EXPECT_THROW(render_surface(mesh, OpaqueSurface{}, {}, camera, {}), InputError);
  camera = small_camera();
  camera.up = camera.look_at - camera.position;
  EXPECT_THROW(render_surface(mesh, OpaqueSurface{}, {}, camera, {}), InputError);
  EXPECT_THROW(render_surface(mesh, TranslucentSurface{{Rgb::Ones()}, 1.5}, {}, small_camera(), {}), InputError);
}

TEST(SurfaceRender, FloorIsDarkerUnderTheObject) {
  const TriangleMesh mesh = sphere(48, 10);
  RenderSettings settings;
  settings.floor = Floor{Rgb::Constant(0.5f), 1, 3};
  Camera camera = small_camera();
  camera.position = Vec3(0, 30, 60);
  const RenderedImage picture = render_surface(mesh, OpaqueSurface{}, {uniform_sky(1)}, camera, settings);
  // The contact point's pixel is hidden by the ball; just in front of it the floor is in half shadow.
  const SceneGeometry geometry(mesh);
  const LitFloor floor(*settings.floor, mesh, geometry, Vec3(0, 1, 0), {uniform_sky(1)}, 512,
                       [](const SceneGeometry::Hit&) -> Rgb { return Rgb::Zero(); });
  EXPECT_NEAR(floor.radiance(Vec3(30, -10, 0))[0], 0.5 * (1 - 0.03), 0.02);
  EXPECT_LT(floor.radiance(Vec3(2, -10, 0))[0], 0.1);
  EXPECT_EQ(floor.opacity(Vec3(70, -10, 0)), 0);
  EXPECT_EQ(floor.opacity(Vec3(5, -10, 0)), 1);
  EXPECT_GT(picture.statistics.shadow_rays_skipped, 0);
}

}  // namespace
}  // namespace shellgrid
