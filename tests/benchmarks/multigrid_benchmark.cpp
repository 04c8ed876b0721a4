// SPDX-License-Identifier: AGPL-3.0-or-later
// The diffusion solver on a polygrid file (or a ball of n³ cells): seconds and processor seconds of each step, and the
// exitance's error against the converged solution, beside the memory's speed in the same run.
//   multigrid_benchmark polygrid.hdf | n [--speed]
// --speed: without the converged solution.
#include <sys/resource.h>

#include <algorithm>
#include <cmath>
#include <cstdio>
#include <cstdlib>
#include <ctime>
#include <functional>
#include <memory>
#include <string>

#include "meshing/core/parallel.h"
#include "meshing/formats/vtkhdf_file.h"
#include "solvers/diffusion/diffusion_solver.h"
#include "tests/support/polygrid_shapes.h"
#include "tests/support/veined_marble.h"

using namespace shellgrid;

namespace {

double wall_seconds() {
  timespec t;
  clock_gettime(CLOCK_MONOTONIC, &t);
  return static_cast<double>(t.tv_sec) + 1e-9 * static_cast<double>(t.tv_nsec);
}
double processor_seconds() {
  timespec t;
  clock_gettime(CLOCK_PROCESS_CPUTIME_ID, &t);
  return static_cast<double>(t.tv_sec) + 1e-9 * static_cast<double>(t.tv_nsec);
}

double last_processor_seconds = 0;

// Prints and returns the least wall seconds; notes the least processor seconds, of all threads together.
template <class Work>
double report_time(const char* what, int repetitions, const Work& work) {
  double wall = 1e30, processor = 1e30;
  for (int k = 0; k < repetitions; ++k) {
    const double w = wall_seconds(), p = processor_seconds();
    work();
    wall = std::min(wall, wall_seconds() - w);
    processor = std::min(processor, processor_seconds() - p);
  }
  std::printf("%-40s %8.4f s wall, %8.4f s processor\n", what, wall, processor);
  std::fflush(stdout);
  last_processor_seconds = processor;
  return wall;
}

double exitance_error(const std::vector<double>& area, const std::vector<Double4>& a, const std::vector<Double4>& b) {
  double worst = 0;
  for (int c = 0; c < 3; ++c) {
    double error = 0, size = 0;
    for (std::size_t i = 0; i < a.size(); ++i) {
      error += area[i] * (a[i][c] - b[i][c]) * (a[i][c] - b[i][c]);
      size += area[i] * b[i][c] * b[i][c];
    }
    worst = std::max(worst, std::sqrt(error / size));
  }
  return worst;
}

}  // namespace

int main(int argc, char** argv) {
  if (argc < 2) return 2;
  const std::string name = argv[1];
  const bool exact_known = !(argc > 2 && std::string(argv[2]) == "--speed");
  Polygrid grid;
  if (name.size() > 4)
    grid = read_polygrid(name);
  else
    grid = test::ball_grid(std::atoi(name.c_str()), 40, 0.1);
  const double size = (grid.points.colwise().maxCoeff() - grid.points.colwise().minCoeff()).maxCoeff();
  const CellCoefficients coefficients = test::VeinedMarble{size}.of(grid);
  {
    const std::size_t n = 16 << 20;
    std::vector<float> a(n), b(n, 1.0f), c(n, 2.0f);
    const double triad = report_time("triad of 3 × 64 MiB on all threads", 5, [&] {
      parallel_chunks(n, 1 << 16, [&](std::size_t begin, std::size_t end) {
        for (std::size_t i = begin; i < end; ++i) a[i] = b[i] + 1.5f * c[i];
      });
    });
    std::printf("   %.1f GB/s, 12 bytes an entry counted\n", 12e-9 * static_cast<double>(n) / triad);
  }
  std::unique_ptr<DiffusionSolver> solver;
  report_time("levels, once a polygrid", 1, [&] { solver = std::make_unique<DiffusionSolver>(grid); });
  std::printf("levels:");
  for (std::size_t s : solver->level_sizes()) std::printf(" %zu", s);
  std::printf("\n");
  const auto lit = [&](double degrees) {
    const double angle = degrees * M_PI / 180;
    const Vec3 direction =
        std::cos(angle) * Vec3(0.5, 0.7, 0.4).normalized() + std::sin(angle) * Vec3(0.7, -0.5, 0).normalized();
    DiffusionLight light;
    for (std::int32_t p : solver->grid().outer_point) {
      const auto cosine = static_cast<float>(std::max(0.0, grid.point_normal.row(p).dot(direction.transpose())));
      light.irradiance.push_back(Float4{cosine, cosine, cosine, 0});
    }
    return light;
  };
  const DiffusionLight light = lit(0), turned = lit(5);
  std::vector<Double4> exact, exact_turned;
  SolveReport report;
  if (exact_known) {
    solver->set_material(coefficients, 1.5, 1e-9);
    solver->solve(turned, 1e-9);
    exact_turned = solver->exitance(turned);
    report_time("conjugate gradients to 1e-9", 1, [&] { report = solver->solve(light, 1e-9); });
    exact = solver->exitance(light);
    std::printf("   %d iterations; residuals:", report.iterations);
    for (double x : report.residual_history) std::printf(" %.1e", x);
    std::printf("\n");
  }
  report_time("set-up after a change of material", 3, [&] { solver->set_material(coefficients, 1.5, 0.005); });
  const auto tell = [&](const DiffusionLight& lamp, const std::vector<Double4>& truth, double seconds) {
    std::printf("   %d cycles, %d iterations, estimated %.2e", report.cycles, report.iterations,
                report.estimated_error);
    if (!truth.empty())
      std::printf(", true %.2e", exitance_error(solver->surface().area, solver->exitance(lamp), truth));
    std::printf("; energy defect %.1e; %.1f million unknowns (points × RGB) a processor second\n",
                solver->energy(lamp).relative_defect[1], 3e-6 * static_cast<double>(solver->size()) / seconds);
  };
  for (double tolerance : {0.05, 0.005, 1e-3}) {
    report_time(("cold to " + std::to_string(tolerance)).c_str(), 5, [&] { report = solver->solve(light, tolerance); });
    tell(light, exact, last_processor_seconds);
  }
  solver->solve(light, 0.005);
  {
    // There and back: each turn is a warm start.
    bool there = false;
    report_time("warm to 0.005, light turned by 5°", 5, [&] {
      there = !there;
      report = solver->solve(there ? turned : light, 0.005, true);
    });
    tell(turned, exact_turned, last_processor_seconds);
  }
  // The composite grid that the tolerance allows.
  for (int depth : {1, 2, 3}) {
    SolverParameters parameters;
    parameters.depth = depth;
    std::unique_ptr<DiffusionSolver> deep;
    report_time(("composite grid of depth " + std::to_string(depth) + ", once").c_str(), 1,
                [&] { deep = std::make_unique<DiffusionSolver>(grid, parameters); });
    std::printf("   %zu unknown points of %zu\n", deep->size(), solver->size());
    report_time("its set-up after a change of material", 2, [&] { deep->set_material(coefficients, 1.5, 0.005); });
    const auto tell_deep = [&](const DiffusionLight& lamp, const std::vector<Double4>& truth) {
      std::printf("   %d cycles, estimated %.2e, of it by depth %.2e", report.cycles, report.estimated_error,
                  report.deep_error);
      if (!truth.empty()) std::printf(", true %.2e", exitance_error(deep->surface().area, deep->exitance(lamp), truth));
      std::printf("\n");
    };
    for (double tolerance : {0.05, 0.005}) {
      report_time(("cold, adaptive, to " + std::to_string(tolerance)).c_str(), 5,
                  [&] { report = deep->solve(light, tolerance); });
      tell_deep(light, exact);
    }
    // There and back: each turn is a warm start.
    bool there = false;
    report_time("warm, adaptive, to 0.005, light turned by 5°", 6, [&] {
      there = !there;
      report = deep->solve(there ? turned : light, 0.005, true);
    });
    tell_deep(light, exact);
  }
  std::printf("sweep %.1f MB = %.1f bytes an unknown point; solver %.0f bytes an unknown point\n",
              1e-6 * static_cast<double>(solver->sweep_bytes()),
              static_cast<double>(solver->sweep_bytes()) / static_cast<double>(solver->size()),
              static_cast<double>(solver->memory_bytes()) / static_cast<double>(solver->size()));
  const CellCoefficients plain = homogeneous_coefficients(
      grid, Material::from_absorption_scattering(Rgb(0.0021f, 0.0041f, 0.0071f), Rgb(2.19f, 2.62f, 3.0f), Rgb::Zero()));
  report_time("set-up, one material", 1, [&] { solver->set_material(plain, 1.5, 0.005); });
  report_time("cold to 0.005, one material", 3, [&] { report = solver->solve(light, 0.005); });
  tell(light, {}, last_processor_seconds);
  std::printf("sweep %.1f bytes an unknown point\n",
              static_cast<double>(solver->sweep_bytes()) / static_cast<double>(solver->size()));
  rusage usage;
  getrusage(RUSAGE_SELF, &usage);
  std::printf("peak memory of the whole program %.2f GiB for %.2f million points\n",
              static_cast<double>(usage.ru_maxrss) / (1 << 20), 1e-6 * static_cast<double>(solver->size()));
}
