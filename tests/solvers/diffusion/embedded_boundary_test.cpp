// SPDX-License-Identifier: AGPL-3.0-or-later
#include "solvers/diffusion/embedded_boundary.h"

#include <gtest/gtest.h>

#include <cmath>
#include <functional>

#include "meshing/core/error.h"
#include "solvers/diffusion/closed_forms.h"
#include "tests/support/closed_shapes.h"
#include "tests/support/coupling_solution.h"

namespace shellgrid {
namespace {

constexpr double ior = 1.4;

// A shape about the origin given by its signed distance, on a grid whose points are shifted from it.
EmbeddedGrid embed(double reach, double spacing, const Vec3& shift,
                   const std::function<double(const Vec3&)>& distance) {
  GridFrame frame;
  frame.voxel = spacing;
  const int half = static_cast<int>(std::ceil(reach / spacing)) + 3;
  frame.origin = shift - Vec3::Constant(half * spacing);
  const Vec3i counts = Vec3i::Constant(2 * half + 1);
  std::vector<float> values;
  for (int z = 0; z < counts.z(); ++z)
    for (int y = 0; y < counts.y(); ++y)
      for (int x = 0; x < counts.x(); ++x) values.push_back(static_cast<float>(distance(frame.to_world({x, y, z}))));
  return embed_level_set(frame, counts, values);
}
EmbeddedGrid ball(double radius, double spacing, const Vec3& shift) {
  return embed(radius, spacing, shift, [&](const Vec3& x) { return x.norm() - radius; });
}

EmbeddedSystem assemble(const EmbeddedGrid& grid, const DiffusionCoefficients& material) {
  return assemble_embedded_system(
      grid, std::vector<Rgb>(grid.cells.size(), Rgb::Constant(static_cast<float>(material.absorption))),
      std::vector<Rgb>(grid.cells.size(),
                       Rgb::Constant(static_cast<float>(material.absorption + material.reduced_scattering))),
      ior);
}

test::CouplingSolution solve(const EmbeddedSystem& system, const std::vector<Double4>& irradiance) {
  return test::solve_coupling(system.matrix, boundary_source(system, irradiance));
}

std::vector<Double4> uniform(const EmbeddedGrid& grid) {
  return std::vector<Double4>(grid.pieces.size(), Double4{1, 1, 1, 0});
}

TEST(EmbeddedBoundary, VolumeAndSurfaceComeOutAtSecondOrder) {
  double volume[2], area[2];
  for (int k = 0; k < 2; ++k) {
    const EmbeddedGrid grid = ball(1, 0.2 / (1 << k), {0.013, 0.027, 0.041});
    double v = 0, a = 0;
    for (double part : grid.volume) v += part;
    for (const auto& piece : grid.pieces) a += piece.area;
    volume[k] = std::abs(v / (4 * M_PI / 3) - 1);
    area[k] = std::abs(a / (4 * M_PI) - 1);
  }
  EXPECT_LT(volume[1], 0.006);
  EXPECT_GT(volume[0] / volume[1], 3.2);
  EXPECT_LT(area[1], 0.005);
  EXPECT_GT(area[0] / area[1], 3.2);
}

TEST(EmbeddedBoundary, TheOpenPartsOfACellsFacesAndItsSurfaceClose) {
  // ∫ n dA over the whole rim of a cell's part is 0; a plane's pieces have one normal each.
  const Vec3 normal = Vec3(0.3, -0.5, 0.8).normalized();
  const double half = 1;
  const EmbeddedGrid grid = embed(2, 0.25, {0.03, 0.01, 0.02}, [&](const Vec3& x) {
    return std::max({std::abs(x.x()) - half, std::abs(x.y()) - half, std::abs(x.z()) - half, x.dot(normal) - 0.3});
  });
  std::vector<Vec3> sum(grid.cells.size(), Vec3::Zero());
  for (const auto& face : grid.faces) {
    const Vec3 step = (grid.cells[face.upper] - grid.cells[face.lower]).cast<double>();
    sum[face.lower] += face.area * step;
    sum[face.upper] -= face.area * step;
  }
  int checked = 0;
  for (const auto& piece : grid.pieces) {
    if (piece.normal.dot(normal) < 1 - 1e-9) continue;
    EXPECT_LT((sum[piece.cell] + piece.area * piece.normal).norm(), 2e-6);
    ++checked;
  }
  EXPECT_GT(checked, 20);
}

TEST(EmbeddedBoundary, WhiteObjectUnderUniformLightIsEvenAndReturnsAll) {
  const EmbeddedGrid grid = ball(5, 0.7, {0.1, 0.2, 0.05});
  const EmbeddedSystem system = assemble(grid, {0, 1});
  const std::vector<Double4> light = uniform(grid);
  const test::CouplingSolution solved = solve(system, light);
  for (const Double4& f : solved.values) EXPECT_NEAR(f[0], system.light_factor, 1e-8 * system.light_factor);
  for (const Double4& m : boundary_exitance(system, solved.values, light)) EXPECT_NEAR(m[0], 1, 1e-8);
}

TEST(EmbeddedBoundary, ConservesEnergyUnderLightFromOneSide) {
  const EmbeddedGrid grid = ball(5, 0.6, {0.1, 0.2, 0.05});
  const EmbeddedSystem system = assemble(grid, {0.2, 1});
  std::vector<Double4> light(grid.pieces.size(), Double4{});
  for (std::size_t k = 0; k < light.size(); ++k)
    if (grid.pieces[k].normal.z() > 0.5) light[k] = Double4{1, 0, 0, 0};
  const EnergyBalance balance = energy_balance(system, solve(system, light).values, light);
  EXPECT_GT(balance.absorbed[0], 0.1 * balance.entering[0]);
  EXPECT_LT(balance.relative_defect[0], 1e-9);
}

TEST(EmbeddedBoundary, BallsExitanceConvergesAtSecondOrder) {
  for (const DiffusionCoefficients& material : {DiffusionCoefficients{0.002, 1}, DiffusionCoefficients{0.05, 2}}) {
    const SphereSolution exact(material, 10, ior, 1);
    double error[3];
    for (int k = 0; k < 3; ++k) {
      const EmbeddedGrid grid = ball(10, 1.6 / (1 << k), {0.13, 0.27, 0.41});
      const EmbeddedSystem system = assemble(grid, material);
      const std::vector<Double4> light = uniform(grid);
      const std::vector<Double4> exitance = boundary_exitance(system, solve(system, light).values, light);
      double sum = 0, size = 0;
      for (std::size_t p = 0; p < exitance.size(); ++p) {
        sum += grid.pieces[p].area * std::pow(exitance[p][0] - exact.exitance, 2);
        size += grid.pieces[p].area * exact.exitance * exact.exitance;
      }
      error[k] = std::sqrt(sum / size);
    }
    EXPECT_LT(error[2], 0.01);
    EXPECT_GT(std::log2(error[0] / error[2]) / 2, 1.7) << error[0] << " " << error[1] << " " << error[2];
  }
}

TEST(EmbeddedBoundary, SliversDoNotBreakIt) {
  // The surface passes through grid points, and 1e-3 … 1e-7 of the spacing beside them.
  const DiffusionCoefficients material{0.01, 1};
  const SphereSolution exact(material, 5, ior, 1);
  int least = 1 << 30, most = 0;
  for (double shift : {0.23, 0.0, 1e-3, -1e-3, 1e-5, -1e-5, 1e-7}) {
    const EmbeddedGrid grid = ball(5, 0.5, Vec3::Constant(0.5 * shift));
    const EmbeddedSystem system = assemble(grid, material);
    const std::vector<Double4> light = uniform(grid);
    const test::CouplingSolution solved = solve(system, light);
    least = std::min(least, solved.iterations);
    most = std::max(most, solved.iterations);
    for (const Double4& f : solved.values) EXPECT_GT(f[0], 0);
    double sum = 0, area = 0;
    const std::vector<Double4> exitance = boundary_exitance(system, solved.values, light);
    for (std::size_t p = 0; p < exitance.size(); ++p) {
      sum += grid.pieces[p].area * exitance[p][0];
      area += grid.pieces[p].area;
    }
    EXPECT_NEAR(sum / area, exact.exitance, 0.01 * exact.exitance) << shift;
    EXPECT_LT(energy_balance(system, solved.values, light).relative_defect[0], 1e-8);
  }
  EXPECT_LT(most, 2 * least);
}

TEST(EmbeddedBoundary, KeepsItsHeadInDarkMaterialOnACoarseGrid) {
  // C D is a twentieth of the spacing: most centres beyond the surface are out of its reach.
  const EmbeddedGrid grid = ball(5, 0.8, {0.1, 0.2, 0.05});
  const EmbeddedSystem system = assemble(grid, {1, 20});
  for (const auto& outlet : system.outlets) EXPECT_GT(outlet.factor[0], 0);
  const std::vector<Double4> light = uniform(grid);
  const test::CouplingSolution solved = solve(system, light);
  for (const Double4& f : solved.values) EXPECT_GE(f[0], -1e-12);
  EXPECT_LT(energy_balance(system, solved.values, light).relative_defect[0], 1e-9);
}

TEST(EmbeddedBoundary, AMeshAndItsLevelSetGiveTheSameGrid) {
  const TriangleMesh mesh = shapes::sphere(3.0, 5);
  const EmbeddedGrid of_mesh = embed_surface(mesh, 0.4);
  double volume = 0;
  for (double v : of_mesh.volume) volume += v;
  EXPECT_NEAR(volume, 36 * M_PI, 0.02 * 36 * M_PI);
  std::vector<Rgb> values;
  for (const auto& piece : of_mesh.pieces) values.push_back(Rgb::Constant(static_cast<float>(5 + piece.centre.x())));
  const std::vector<Rgb> carried = pieces_to_vertices(of_mesh, mesh, values);
  for (int v = 0; v < mesh.vertex_count(); ++v) EXPECT_NEAR(carried[v][1], 5 + mesh.vertex(v).x(), 0.05);
}

TEST(EmbeddedBoundary, RefusesWhatIsWrong) {
  const EmbeddedGrid grid = ball(1, 0.3, Vec3::Zero());
  const std::vector<Rgb> good(grid.cells.size(), Rgb::Ones());
  EXPECT_THROW(assemble_embedded_system(grid, {}, good, ior), InputError);
  EXPECT_THROW(assemble_embedded_system(grid, good, std::vector<Rgb>(grid.cells.size(), Rgb::Zero()), ior), InputError);
  EXPECT_THROW(pieces_to_vertices(grid, shapes::sphere(1.0, 1), {}), InputError);
  GridFrame frame;
  EXPECT_THROW(embed_level_set(frame, {3, 3, 3}, std::vector<float>(26, 1.0f)), InputError);
  EXPECT_THROW(embed_level_set(frame, {3, 3, 3}, std::vector<float>(27, 1.0f)), InputError);
  EXPECT_THROW(embed_level_set(frame, {3, 3, 3}, std::vector<float>(27, -1.0f)), InputError);
  EXPECT_THROW(embed_level_set(frame, {3, 3, 3}, std::vector<float>(27, std::nanf(""))), InputError);
  EXPECT_THROW(embed_surface(shapes::sphere(1.0, 1), 0), InputError);
  EXPECT_THROW(embed_surface(shapes::sphere(1.0, 1), 1e-4), InputError);
  EXPECT_THROW(embed_surface(shapes::moved(shapes::sphere(1.0, 1), {3, 3, 3}), 10), InputError);
}

}  // namespace
}  // namespace shellgrid
