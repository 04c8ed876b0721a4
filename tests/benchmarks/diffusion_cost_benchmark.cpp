// SPDX-License-Identifier: AGPL-3.0-or-later
// What the diffusion solver costs a point, against the number of points: veined marble, red, green and blue.
//   diffusion_cost_benchmark FOLDER [SIZE …]
// FOLDER holds polygrid-SIZE.hdf (made by `make bench`); ball-N is a ball of N³ cells instead, made here. Without
// sizes: 1e5, 3e5, 1e6, ball-46, ball-100, with SG_LONG=1 also 3e6 and ball-215, which has 1e7 points. Nanoseconds of
// the processor, all threads together, for a point of the polygrid: its levels (once), set-up (for each material), one
// cold cycle of full multigrid, one warm one (the light turned by 5°), and the same on the composite grid of depth 2.
// `…_ratio`: over the first size's of the same object. Bytes a point: what one pass over the finest level's couplings
// and vectors moves, the same of all that the solver holds, and the ratio of a cold cycle to such a pass at the speed
// of the triad that was measured beside it. `set_MB`: the pass's bytes in all: less than the cache, and a small size
// is cheaper a point than the memory allows.
#include <unistd.h>

#include <cmath>
#include <cstdio>
#include <filesystem>
#include <memory>
#include <string>
#include <vector>

#include "meshing/formats/vtkhdf_file.h"
#include "solvers/diffusion/diffusion_solver.h"
#include "tests/benchmarks/diffusion_measure.h"
#include "tests/support/polygrid_shapes.h"
#include "tests/support/timing.h"
#include "tests/support/veined_marble.h"

using namespace shellgrid;
using namespace shellgrid::test;

namespace {

// Light from one side, without shadows: by the direction from an outer point's twin.
DiffusionLight lit(const Polygrid& grid, const DiffusionSolver& solver, double degrees) {
  const double angle = degrees * M_PI / 180;
  const Vec3 from =
      std::cos(angle) * Vec3(0.5, 0.7, 0.4).normalized() + std::sin(angle) * Vec3(0.7, -0.5, 0).normalized();
  DiffusionLight light;
  for (const std::int32_t p : solver.grid().outer_point) {
    const Vec3 outward = (grid.points.row(p) - grid.points.row(grid.outer_twin[p])).transpose();
    const auto cosine = static_cast<float>(std::max(0.0, outward.normalized().dot(from)));
    light.irradiance.push_back(Float4{cosine, cosine, cosine, 0});
  }
  return light;
}

// Processor seconds of each step.
struct Costs {
  double levels = 0, setup = 0, cold = 0, warm = 0;
  std::size_t unknowns = 0, points_of_levels = 0, sweep_bytes = 0, bytes = 0;
};

Costs costs_of(const Polygrid& grid, const CellCoefficients& coefficients, int depth) {
  SolverParameters parameters;
  parameters.depth = depth;
  constexpr double one_cycle = 0.4;  // a tolerance that the first cycle meets
  Costs costs;
  std::unique_ptr<DiffusionSolver> solver;
  costs.levels = time_of([&] { solver = std::make_unique<DiffusionSolver>(grid, parameters); }).processor;
  const DiffusionLight light = lit(grid, *solver, 0), turned = lit(grid, *solver, 5);
  // As often as a fifth of a second allows, so that small sizes are measured as well as large ones.
  const int repetitions = std::clamp(static_cast<int>(3e6 / static_cast<double>(grid.points.rows())), 3, 20);
  costs.setup =
      least_time_of(std::min(repetitions, 5), [&] { solver->set_material(coefficients, 1.5, 1e-3); }).processor;
  costs.cold = least_time_of(repetitions, [&] { solver->solve(light, one_cycle); }).processor;
  bool there = false;
  costs.warm = least_time_of(repetitions, [&] {
                 there = !there;
                 solver->solve(there ? turned : light, one_cycle, true);
               }).processor;
  costs.unknowns = solver->size();
  for (const std::size_t s : solver->level_sizes()) costs.points_of_levels += s;
  costs.sweep_bytes = solver->sweep_bytes();
  costs.bytes = solver->memory_bytes();
  return costs;
}

}  // namespace

int main(int argc, char** argv) {
  if (argc < 2) {
    std::fprintf(stderr, "diffusion_cost_benchmark FOLDER [SIZE …]\n");
    return 2;
  }
  const std::filesystem::path folder = argv[1];
  std::vector<std::string> sizes(argv + 2, argv + argc);
  if (sizes.empty()) {
    sizes = {"1e5", "3e5", "1e6", "ball-46", "ball-100"};
    if (long_form()) sizes = {"1e5", "3e5", "1e6", "3e6", "ball-46", "ball-100", "ball-215"};
  }
  std::printf(
      "size,points,levels_ns,setup_ns,cold_ns,warm_ns,adaptive_unknowns,adaptive_setup_ns,adaptive_ns,"
      "adaptive_warm_ns,setup_ratio,cold_ratio,warm_ratio,adaptive_setup_ratio,adaptive_ratio,adaptive_warm_ratio,"
      "points_of_levels,sweep_bytes,solver_bytes,set_MB,cache_MB,triad_GB_s,cold_floor_ratio\n");
  std::vector<double> firsts[2];
  for (const std::string& size : sizes) {
    const bool ball = size.starts_with("ball-");
    const Polygrid grid = ball ? ball_grid(std::atoi(size.c_str() + 5), 40, 0.1)
                               : read_polygrid((folder / ("polygrid-" + size + ".hdf")).string(), PolygridParts::cells);
    const auto points = static_cast<double>(grid.points.rows());
    CellCoefficients coefficients;
    {
      VeinedMarble marble;
      marble.size = (grid.points.colwise().maxCoeff() - grid.points.colwise().minCoeff()).maxCoeff();
      coefficients = marble.of(grid);
    }
    const double triad = triad_speed();
    const Costs whole = costs_of(grid, coefficients, 0), deep = costs_of(grid, coefficients, 2);
    const std::vector<double> costs = {whole.setup, whole.cold, whole.warm, deep.setup, deep.cold, deep.warm};
    const double ns = 1e9 / points;
    std::printf("%s,%.0f,%.1f,%.1f,%.1f,%.1f,%zu,%.1f,%.1f,%.1f", size.c_str(), points, ns * whole.levels,
                ns * whole.setup, ns * whole.cold, ns * whole.warm, deep.unknowns, ns * deep.setup, ns * deep.cold,
                ns * deep.warm);
    std::vector<double>& first = firsts[ball];
    if (first.empty())
      for (const double cost : costs) first.push_back(ns * cost);
    for (std::size_t k = 0; k < costs.size(); ++k) std::printf(",%.2f", ns * costs[k] / first[k]);
    std::printf(",%.3f,%.1f,%.1f,%.1f,%.1f,%.1f,%.1f\n",
                static_cast<double>(whole.points_of_levels) / static_cast<double>(whole.unknowns),
                static_cast<double>(whole.sweep_bytes) / points, static_cast<double>(whole.bytes) / points,
                1e-6 * static_cast<double>(whole.sweep_bytes),
                1e-6 * static_cast<double>(sysconf(_SC_LEVEL3_CACHE_SIZE)), 1e-9 * triad,
                whole.cold * triad / static_cast<double>(whole.sweep_bytes));
    std::fflush(stdout);
  }
}
