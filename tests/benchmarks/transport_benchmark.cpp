// SPDX-License-Identifier: AGPL-3.0-or-later
// Light paths a second through a ball with a veined shell of ten voxels, one thread: delta tracking below one majorant
// for the object, below one a leaf, from voxel to voxel, and the method chosen leaf by leaf; with the mean power that
// leaves, which must agree. Then homogeneous balls and slabs.
#include <oneapi/tbb/global_control.h>

#include <cmath>
#include <cstdio>

#include "solvers/transport/light_emission.h"
#include "solvers/transport/tally_shapes.h"
#include "solvers/transport/transport_object.h"
#include "tests/support/closed_shapes.h"
#include "tests/support/global_majorant.h"
#include "tests/support/shell_shapes.h"
#include "tests/support/timing.h"

using namespace shellgrid;

namespace {

constexpr double radius = 10, voxel = 0.4;

struct Leaving {
  void incoming(const LightPath&) {}
  void entered(const LightPath& path, const Crossing&) { in += lane_sum(path.weight); }
  void left(const LightPath& path, const Crossing&) { out += lane_sum(path.weight); }
  void mirrored(const LightPath&) {}
  void outside(const LightPath&, double) {}
  void absorbed(Double4, int) {}
  void chance(Double4) {}
  void lost(Double4) {}
  static constexpr bool again = false;
  double in = 0, out = 0;
};

struct Speed {
  double paths_per_second, reflectance;
};

template <class Medium>
Speed measure(const TransportObject& object, const LightEmission& emission, const Medium& medium) {
  const TransportBody body = object.body();
  ChunkTally tally;
  Leaving visitor;
  double paths = 0, seconds = 0;
  const double enough = test::long_form() ? 5 : 0.4;
  for (std::uint64_t index = 0; seconds < enough;) {
    seconds += test::seconds_of([&] {
      for (const std::uint64_t end = index + 500; index < end; ++index) {
        LightPath path{PathRandom(0, index)};
        const EmittedRay ray = emission.emit(path.random);
        path.point = ray.origin;
        path.direction = ray.direction;
        path.weight = ray.power / lane_sum(ray.power);
        BodyWalk<Medium, Leaving>(body, medium, visitor, tally).follow(path);
        ++paths;
      }
    });
    tally.clear();
  }
  return {paths / seconds, visitor.out / visitor.in};
}

Material veined(const Vec3& p, double extinction, double contrast, float anisotropy) {
  const double vein = std::sin(1.7 * p.x() + std::sin(0.9 * p.y())) + std::sin(1.3 * p.z() + std::sin(1.1 * p.x()));
  const auto sigma = static_cast<float>(extinction * (vein > 1.6 ? contrast : 1 + 0.2 * std::sin(5 * p.y())));
  Material m;
  m.extinction = sigma * Rgb(1, 0.9f, 0.8f);
  m.albedo = Rgb(0.998f, 0.995f, 0.99f);
  m.anisotropy = Rgb::Constant(anisotropy);
  return m;
}

}  // namespace

int main() {
  const oneapi::tbb::global_control one(oneapi::tbb::global_control::max_allowed_parallelism, 1);
  const TriangleMesh ball = shapes::sphere(radius, 6);
  EnvironmentLight sky;
  sky.zenith = sky.horizon = sky.ground = Rgb::Ones();
  std::printf(
      "extinction_per_voxel,anisotropy,contrast,method,paths_per_second,ratio_to_global_majorant,reflectance\n");
  const auto row = [](double extinction, double anisotropy, double contrast, const char* method, const Speed& speed,
                      double reference) {
    std::printf("%g,%g,%g,%s,%.0f,%.2f,%.4f\n", extinction, anisotropy, contrast, method, speed.paths_per_second,
                reference > 0 ? speed.paths_per_second / reference : 1, speed.reflectance);
    std::fflush(stdout);
  };
  for (const auto& [extinction, anisotropy] : {std::pair{0.04, 0.0}, {0.4, 0.0}, {4.0, 0.9}})
    for (const double contrast : {1.5, 50.0}) {
      const auto matter = [&](const Vec3& p) {
        return veined(p, extinction / voxel, contrast, static_cast<float>(anisotropy));
      };
      const ShellVolume shell =
          test::shell_of([](const Vec3& p) { return p.norm() - radius; }, radius, voxel, 10 * voxel,
                         veined(Vec3(0, 0.1, 0), extinction / voxel, 1, static_cast<float>(anisotropy)),
                         [&](const Vec3& p, double) { return test::ShellVoxel{matter(p)}; });
      const LeafMethod voxels = LeafMethod::voxels, delta = LeafMethod::delta;
      const TransportObject chosen(ball, shell, 1.4), by_voxel(ball, shell, 1.4, &voxels),
          by_leaf(ball, shell, 1.4, &delta);
      const LightEmission emission({sky}, ball, chosen.surface().centre(), chosen.surface().radius());
      const auto medium = [](const TransportObject& object) -> const ShellMedium& {
        return std::get<ShellMedium>(object.medium());
      };
      const Speed global = measure(chosen, emission, test::GlobalMajorantMedium(shell));
      row(extinction, anisotropy, contrast, "global majorant", global, 0);
      row(extinction, anisotropy, contrast, "leaf majorant", measure(by_leaf, emission, medium(by_leaf)),
          global.paths_per_second);
      row(extinction, anisotropy, contrast, "voxels", measure(by_voxel, emission, medium(by_voxel)),
          global.paths_per_second);
      row(extinction, anisotropy, contrast, "chosen by leaf", measure(chosen, emission, medium(chosen)),
          global.paths_per_second);
    }
  for (const bool grey : {true, false}) {
    const Material matter =
        grey ? veined(Vec3(0, 0.1, 0), 1, 1, 0)
             : Material::from_absorption_scattering(Rgb(0.002f, 0.005f, 0.01f), Rgb(1, 0.9f, 0.8f), Rgb::Zero());
    Material even = matter;
    if (grey) even.extinction = Rgb::Ones();
    const TransportObject object(ball, even, 1.4);
    const LightEmission emission({sky}, ball, object.surface().centre(), object.surface().radius());
    row(0.4, 0, 1, grey ? "homogeneous, one extinction" : "homogeneous, three extinctions",
        measure(object, emission, std::get<HomogeneousMedium>(object.medium())), 0);
  }
  TallyProblem slab;
  slab.layers = {{1, 9, 0.75}};
  slab.thickness = 0.2;
  const TallyTransport transport(slab);
  const PathKind kind = transport.kind();
  PathState state(kind.scalars, kind.field_size);
  PathLimits limits;
  limits.paths = test::long_form() ? 1e7 : 1e6;
  const double seconds = test::seconds_of([&] { follow_paths(kind, limits, state); });
  row(9 * 0.2, 0.75, 1, "slab of van de Hulst",
      {limits.paths / seconds, transport.result(state).diffuse_reflectance.value}, 0);
}
