// SPDX-License-Identifier: AGPL-3.0-or-later
// Rendering: seconds against error, adaptive sampling against the same number of samples everywhere.
#include <cmath>
#include <cstdio>
#include <numbers>

#include "solvers/render/surface_render.h"
#include "tests/support/timing.h"

using namespace shellgrid;

namespace {

// A bumpy ball of about `quads`² faces.
TriangleMesh bumpy_ball(int quads) {
  constexpr double pi = std::numbers::pi;
  TriangleMesh mesh;
  mesh.vertices.resize((quads + 1) * quads, 3);
  for (int i = 0; i <= quads; ++i)
    for (int j = 0; j < quads; ++j) {
      const double polar = pi * (i + 1e-3) / (quads + 2e-3), azimuth = 2 * pi * j / quads;
      const Vec3 unit(std::sin(polar) * std::cos(azimuth), std::sin(polar) * std::sin(azimuth), std::cos(polar));
      const double radius = 30 * (1 + 0.08 * std::sin(9 * unit.x()) * std::sin(8 * unit.y()) * std::sin(7 * unit.z()));
      mesh.vertices.row(i * quads + j) = (radius * unit).transpose();
    }
  mesh.faces.resize(2 * quads * quads, 3);
  for (int i = 0; i < quads; ++i)
    for (int j = 0; j < quads; ++j) {
      const int a = i * quads + j, b = i * quads + (j + 1) % quads, c = a + quads, d = b + quads;
      mesh.faces.row(2 * (i * quads + j)) << a, c, d;
      mesh.faces.row(2 * (i * quads + j) + 1) << a, d, b;
    }
  return mesh;
}

}  // namespace

int main() {
  const TriangleMesh mesh = bumpy_ball(300);
  TranslucentSurface surface;
  for (int v = 0; v < mesh.vertex_count(); ++v)
    surface.exitance.push_back(Rgb::Constant(static_cast<float>(1 + 0.5 * std::sin(0.8 * mesh.vertices(v, 0)))));
  EnvironmentLight sky;
  sky.zenith = Rgb::Constant(0.3f);
  sky.lamps.push_back({Vec3(-0.6, 0.6, 0.5).normalized(), 0.3, 0.1, Rgb::Constant(6)});
  Camera camera;
  camera.fov = 22;
  camera.width = 360;
  camera.height = 243;
  auto render = [&](int samples, double contrast, std::uint64_t seed) {
    RenderSettings settings;
    settings.film = {samples, contrast, seed};
    return render_surface(mesh, surface, {sky}, camera, settings);
  };
  const Image reference = render(256, 0, 1).image;
  std::printf("sampling,samples_per_pixel,seconds,camera_rays,rmse\n");
  for (const double contrast : {0.0, 0.03})
    for (const int samples : {4, 8, 16, 32, 64}) {
      RenderedImage picture;
      const double seconds = test::seconds_of([&] { picture = render(samples, contrast, 0); });
      double sum = 0;
      const auto &found = picture.image.find("G")->values, &expected = reference.find("G")->values;
      for (std::size_t i = 0; i < found.size(); ++i) sum += std::pow(found[i] - expected[i], 2);
      std::printf("%s,%d,%.3f,%lld,%.6f\n", contrast > 0 ? "adaptive" : "everywhere", samples, seconds,
                  static_cast<long long>(picture.statistics.film.samples), std::sqrt(sum / found.size()));
      std::fflush(stdout);
    }
}
