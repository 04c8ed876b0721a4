// SPDX-License-Identifier: AGPL-3.0-or-later
// Run time against error for every way of solving diffusion in one object: veined marble, red, green and blue, under a
// parallel light with shadows.
//   diffusion_benchmark FOLDER [SIZE …] [--no-paper]
// FOLDER holds surface.ply and for each SIZE polygrid-SIZE.hdf and, where tetrahedra are to be compared, tets-SIZE.hdf
// (made by `make bench`); the regular grid with an embedded boundary is made here. Without sizes: 1e5 and 3e5, with
// SG_LONG=1 also 1e6 and 3e6. --no-paper: without the paper's relaxations, which need their own exact solution.
// Each row: what one method took to bring the exitance's algebraic error, the greatest of the channels, against the
// exact solution of its own discretisation under one level. Seconds are the processor's, of all threads, beside those
// on the wall; libraries are given their matrix (assembly_s), this project's set-up makes its own. `ratio` is set-up
// and solve over this project's cold row of the same size and level, `solve_ratio` the solve alone. An application is
// one product with the method's matrices; the floor is its bytes at the speed of the triad. `discretisation_error`: of
// the exact exitance at the surface's vertices, against the finest polygrid in FOLDER; `soft_light_error` is the same
// under a light that varies slowly over the surface.
#include <Eigen/Geometry>
#include <algorithm>
#include <cmath>
#include <cstdio>
#include <filesystem>
#include <functional>
#include <memory>
#include <optional>
#include <string>

#include "meshing/formats/mesh_file.h"
#include "meshing/formats/vtkhdf_file.h"
#include "meshing/polycube/tetrahedralize.h"
#include "meshing/surface/closest_point.h"
#include "solvers/diffusion/boundary_irradiance.h"
#include "solvers/diffusion/diffusion_solver.h"
#include "solvers/diffusion/embedded_boundary.h"
#include "solvers/diffusion/paper_operator.h"
#include "solvers/diffusion/surface_transfer.h"
#include "solvers/diffusion/tetrahedral_system.h"
#include "solvers/scattering/fresnel.h"
#include "tests/benchmarks/diffusion_libraries.h"
#include "tests/support/timing.h"
#include "tests/support/veined_marble.h"

using namespace shellgrid;
using namespace shellgrid::test;

namespace {

constexpr double ior = 1.5;
// Set by hand for the paper's relaxation: the residual at which its coarse levels end (1e-2 and 1e-4 were no better),
// and about the least depth that reaches an error of 0.5 % on the bunny, mm.
constexpr double coarse_residual = 1e-3, paper_depth = 5.4;

// Root of the weighted sum of squares of a − b over that of b, the greatest of the channels.
template <class Value>
double difference(const std::vector<double>& weight, const std::vector<Value>& a, const std::vector<Value>& b) {
  double worst = 0;
  for (int c = 0; c < 3; ++c) {
    double error = 0, size = 0;
    for (std::size_t i = 0; i < weight.size(); ++i) {
      error += weight[i] * (a[i][c] - b[i][c]) * (a[i][c] - b[i][c]);
      size += weight[i] * b[i][c] * b[i][c];
    }
    worst = std::max(worst, std::sqrt(error / size));
  }
  return worst;
}

// The object, what lights it, and its exitance as far as it is known.
struct Scene {
  TriangleMesh surface;
  VeinedMarble marble;
  std::vector<double> vertex_area;
  std::vector<Rgb> irradiance, turned;  // at the vertices; of the light turned by 5°
  std::vector<Rgb> finest;              // exitance at the vertices, then that of the soft light
  Limits limits;

  explicit Scene(const std::string& path) : surface(read_mesh(path).mesh) {
    marble.size = (surface.vertices.colwise().maxCoeff() - surface.vertices.colwise().minCoeff()).maxCoeff();
    const SceneGeometry geometry(surface);
    const auto lit = [&](double degrees) {
      const double angle = degrees * M_PI / 180;
      const Vec3 direction =
          (std::cos(angle) * Vec3(0.6, 0, -0.6) + std::sin(angle) * Vec3(0.6, 0, 0.6) + Vec3(0, -0.5, 0)).normalized();
      const std::vector<Light> lights = {DirectionalLight{direction, Rgb::Constant(3)}};
      return surface_irradiance(surface, geometry, lights, ior, 1).values;
    };
    irradiance = lit(0);
    turned = lit(5);
    vertex_area.assign(irradiance.size(), 0.0);
    for (int f = 0; f < surface.face_count(); ++f) {
      const Vec3 a = surface.corner(f, 0), b = surface.corner(f, 1), c = surface.corner(f, 2);
      for (int k = 0; k < 3; ++k) vertex_area[surface.faces(f, k)] += (b - a).cross(c - a).norm() / 6;
    }
  }
  // Of the two exitances at the vertices, into a row or a problem; 0 where nothing finer is known.
  template <class Target>
  void judge(const std::vector<Rgb>& at_vertices, Target& target) const {
    if (finest.empty()) return;
    const auto half = static_cast<std::ptrdiff_t>(vertex_area.size());
    const auto part = [&](const std::vector<Rgb>& v, int k) {
      return std::vector<Rgb>(v.begin() + k * half, v.begin() + (k + 1) * half);
    };
    target.discretisation_error = difference(vertex_area, part(at_vertices, 0), part(finest, 0));
    target.soft_error = difference(vertex_area, part(at_vertices, 1), part(finest, 1));
  }
};

// A light that varies slowly from place to place.
Double4 soft_light(const Scene& scene, const Vec3& place) {
  const double q = 1 + 1.5 * place.dot(Vec3(0.6, 0.5, -0.6)) / scene.marble.size;
  return Double4{q, q, q, 0};
}

std::vector<Rgb> joined(std::vector<Rgb> a, const std::vector<Rgb>& b) {
  a.insert(a.end(), b.begin(), b.end());
  return a;
}

// This project's solver on a polygrid under a scene's two lights.
class OwnSolver {
 public:
  OwnSolver(const Polygrid& grid, const Scene& scene, const SolverParameters& parameters = {})
      : grid_(grid),
        scene_(scene),
        transfer_(grid, scene.surface),
        coefficients_(scene.marble.of(grid)),
        solver_(grid, parameters) {
    point_light_ = transfer_.to_points(scene.irradiance);
    light_.irradiance = solver_.to_outer(point_light_);
    turned_.irradiance = solver_.to_outer(transfer_.to_points(scene.turned));
  }
  void set_material(double tolerance) { solver_.set_material(coefficients_, ior, tolerance); }
  DiffusionSolver& solver() { return solver_; }
  const CellCoefficients& coefficients() const { return coefficients_; }
  const std::vector<Rgb>& point_light() const { return point_light_; }
  const DiffusionLight& light(bool turned) const { return turned ? turned_ : light_; }
  const SurfaceTransfer& transfer() const { return transfer_; }
  const PeakMemory& memory() const { return memory_; }  // of the solver alone

  // The exact exitance at the vertices: of the light, which is given, and of the soft one.
  std::vector<Rgb> at_vertices(const std::vector<Double4>& exitance) {
    DiffusionLight soft;
    for (std::int32_t point : solver_.grid().outer_point) soft.irradiance.push_back(to_float(soft_point_light(point)));
    solver_.solve(soft, 1e-9);
    return joined(to_vertices(exitance), to_vertices(solver_.exitance(soft)));
  }
  Double4 soft_point_light(Eigen::Index point) const { return soft_light(scene_, grid_.points.row(point).transpose()); }
  std::vector<Double4> exact(bool turned) {
    solver_.solve(light(turned), 1e-9);
    return solver_.exitance(light(turned));
  }

 private:
  std::vector<Rgb> to_vertices(const std::vector<Double4>& exitance) const {
    std::vector<Rgb> points(grid_.points.rows(), Rgb::Zero());
    for (std::size_t s = 0; s < exitance.size(); ++s) points[solver_.grid().outer_point[s]] = to_rgb(exitance[s]);
    return transfer_.to_vertices(points);
  }

  const Polygrid& grid_;
  const Scene& scene_;
  SurfaceTransfer transfer_;
  CellCoefficients coefficients_;
  PeakMemory memory_;
  DiffusionSolver solver_;
  std::vector<Rgb> point_light_;
  DiffusionLight light_, turned_;
};

// How this project's solver may be asked to solve: any of the parameters, whichever is quickest to a level.
struct Variant {
  std::string name;
  std::vector<SolverParameters> parameters;
  bool warm = false;
};

// A row for each tolerance that is asked for, all with their errors.
void run_own(const Row& blank, const Polygrid& grid, const Scene& scene, const SolverParameters& parameters, bool warm,
             const std::vector<Double4>& exact, std::vector<Row>& runs) {
  OwnSolver own(grid, scene, parameters);
  DiffusionSolver& solver = own.solver();
  const std::size_t first = runs.size();
  Seconds setup;
  bool single = false;
  for (double tolerance : {0.3, 0.05, 0.02, 0.01, 0.005, 0.002, 0.001, 3e-4}) {
    if (runs.size() == first || (tolerance < parameters.exact_below && !single)) {
      single = tolerance < parameters.exact_below;
      setup = least_time_of(3, [&] { own.set_material(single ? tolerance : parameters.exact_below); });
    }
    Row run = blank;
    run.unknowns = solver.size();
    run.setup = setup;
    run.solve = {1e300, 1e300};
    double spent = 0;
    for (int k = 0; k < 3 && spent < 2; ++k) {
      if (warm) solver.solve(own.light(false), tolerance);
      const Seconds s = time_of([&] { solver.solve(own.light(warm), tolerance, warm); });
      spent += s.processor;
      if (s.processor < run.solve.processor) run.solve = s;
      if (k > 0) continue;
      run.error = difference(solver.surface().area, solver.exitance(own.light(warm)), exact);
      if (runs.size() > first && run.error == runs.back().error) break;  // the same cycles as the tolerance before
    }
    if (runs.size() > first && run.error == runs.back().error) continue;
    runs.push_back(run);
  }
  const double bytes = own.memory().bytes();
  const RunLevel& level = solver.finest();
  LevelVector<float> x(level.inner_size(), level.size() - level.inner_size()),
      y(level.inner_size(), level.size() - level.inner_size());
  const double application = least_time_of(3, [&] { apply_level(level, x, y, true); }).processor;
  for (std::size_t k = first; k < runs.size(); ++k) {
    runs[k].bytes = bytes;
    runs[k].application = application;
    runs[k].floor = static_cast<double>(solver.sweep_bytes()) / scene.limits.triad;
  }
}

void run_own(const std::string& size, const Polygrid& grid, const Scene& scene, const Variant& variant,
             const std::vector<Double4>& exact, const DiscreteProblem& problem, Table& table) {
  Row blank;
  blank.size = size;
  blank.method = variant.name;
  blank.discretisation = "trilinear";
  blank.discretisation_error = problem.discretisation_error, blank.soft_error = problem.soft_error;
  std::vector<Row> runs;
  for (const SolverParameters& parameters : variant.parameters)
    run_own(blank, grid, scene, parameters, variant.warm, exact, runs);
  for (double level : error_levels) {
    Row best = blank;
    best.note = "not reached";
    for (const Row& run : runs)
      if (run.error <= level && (!best.note.empty() || run.setup.processor + run.solve.processor <
                                                           best.setup.processor + best.solve.processor))
        best = run;
    best.level = level;
    table.add(best);
  }
}

// The paper's operator under D2's boundary condition, so that its exitance is D3's.
struct PaperCase {
  PaperProblem problem;
  std::vector<double> area;
  double reflected = 0;

  PaperCase(const Polygrid& grid, const CellCoefficients& coefficients, const std::vector<Rgb>& light)
      : problem(paper_problem(grid, coefficients, light)) {
    const DiffuseFresnel fresnel = diffuse_fresnel(ior);
    problem.boundary_factor = fresnel.boundary_factor;
    reflected = (1 - fresnel.current_reflectance) / (1 + fresnel.current_reflectance);
    for (Rgb& value : problem.boundary_light) value *= static_cast<float>(4 / (1 - fresnel.fluence_reflectance));
    for (Eigen::Index k = 0; k < grid.boundary_quads.rows(); ++k) {
      double sum = 0;
      for (double a : quad_areas(grid, k)) sum += a;
      area.push_back(sum);
    }
    scale = (1 - fresnel.fluence_reflectance) / 4;
  }
  double scale;
  double exitance(std::size_t k, int c, double fluence) const {
    return fluence / (2 * problem.boundary_factor) - reflected * scale * problem.boundary_light[k][c];
  }
  // Exitance of the exact solution at the boundary nodes.
  std::vector<Double4> solve(const Polygrid& grid) const {
    const PaperSolution exact = solve_paper_operator(grid.graph, problem, grid.hierarchy);
    std::vector<Double4> result(area.size(), Double4{});
    for (std::size_t k = 0; k < area.size(); ++k)
      for (int c = 0; c < 3; ++c) result[k][c] = exitance(k, c, exact.boundary[k][c]);
    return result;
  }
  // [Diffusion eq. 9], second line.
  double boundary_fluence(const PolygridGraph& graph, std::size_t k, int c, const Eigen::VectorXd& psi) const {
    const std::int32_t owner = graph.boundary_owner[k];
    const double slope = 2 * problem.boundary_factor * problem.boundary_diffusion[k][c] / graph.boundary_distance[k];
    return (problem.boundary_light[k][c] + slope * psi[owner] / problem.diffusion[owner][c]) / (1 + slope);
  }
};

void run_paper(const std::string& size, const Polygrid& grid, const Scene& scene, OwnSolver& own, Table& table) {
  PaperCase paper(grid, own.coefficients(), own.point_light());
  const PolygridGraph& graph = grid.graph;
  const std::size_t quads = paper.area.size();
  paper.problem.tolerance = 1e-8;
  const auto at_vertices = [&](const PaperCase& some, const std::vector<Double4>& values) {
    std::vector<Rgb> points(grid.points.rows(), Rgb::Zero());
    std::vector<float> count(grid.points.rows(), 0.0f);
    for (std::size_t k = 0; k < some.area.size(); ++k)
      for (int a = 0; a < 4; ++a) {
        points[grid.boundary_quads(k, a)] += to_rgb(values[k]);
        ++count[grid.boundary_quads(k, a)];
      }
    for (std::size_t p = 0; p < points.size(); ++p)
      if (count[p] > 0) points[p] /= count[p];
    return own.transfer().to_vertices(points);
  };
  const std::vector<Double4> exitance = paper.solve(grid);
  Double4 norm{};
  for (std::size_t k = 0; k < quads; ++k) norm += paper.area[k] * exitance[k] * exitance[k];
  Row judged;
  {
    std::vector<Rgb> light;
    for (Eigen::Index p = 0; p < grid.points.rows(); ++p) light.push_back(to_rgb(own.soft_point_light(p)));
    PaperCase soft(grid, own.coefficients(), light);
    soft.problem.tolerance = 1e-5;
    scene.judge(joined(at_vertices(paper, exitance), at_vertices(soft, soft.solve(grid))), judged);
  }

  const int depth = static_cast<int>(std::ceil(paper_depth / grid.spacing));
  struct Variant {
    const char* name;
    bool levels;
    int depth;
  };
  for (const Variant& variant : {Variant{"paper: Jacobi", false, 0}, Variant{"paper: hierarchical", true, 0},
                                 Variant{"paper: hierarchical adaptive", true, depth}}) {
    PaperProblem problem = paper.problem;
    problem.method = PaperMethod::relaxation;
    problem.tolerance = 1e-9;
    problem.most_iterations = 1000000;
    if (variant.depth > 0) problem.depths.assign(grid.hierarchy.size(), variant.depth);
    // Each channel has a thread of its own, whose clock stands still while its exitance is looked at.
    struct Watched {
      double since = 0, spent = 0, looking = 0, finest = 0;
      int passes = 0;
      std::array<double, error_levels.size()> seconds, error{};
      Watched() { seconds.fill(-1); }
    };
    std::array<Watched, 3> watched;
    problem.watch = [&](const PaperPass& pass) {
      Watched& own_watch = watched[pass.channel];
      const double now = clock_seconds(CLOCK_THREAD_CPUTIME_ID);
      if (pass.passes > 0) {
        own_watch.spent += now - own_watch.since;
        if (pass.level == 0) own_watch.finest += now - own_watch.since, ++own_watch.passes;
      }
      bool done = own_watch.spent > scene.limits.seconds || (pass.level > 0 && pass.residual < coarse_residual);
      if (pass.level == 0) {
        double sum = 0;
        const int c = pass.channel;
        for (std::size_t k = 0; k < quads; ++k) {
          const double off = paper.exitance(k, c, paper.boundary_fluence(graph, k, c, pass.psi)) - exitance[k][c];
          sum += paper.area[k] * off * off;
        }
        const double error = std::sqrt(sum / norm[c]);
        for (std::size_t l = 0; l < error_levels.size(); ++l)
          if (own_watch.seconds[l] < 0 && error <= error_levels[l])
            own_watch.seconds[l] = own_watch.spent, own_watch.error[l] = error;
        done |= own_watch.seconds.back() >= 0;
      }
      own_watch.since = clock_seconds(CLOCK_THREAD_CPUTIME_ID);
      own_watch.looking += own_watch.since - now;
      return done;
    };
    const PeakMemory memory;
    Row row;
    row.size = size, row.method = variant.name, row.discretisation = "paper";
    row.unknowns = static_cast<std::size_t>(graph.interior.rows());
    Seconds whole;
    try {
      whole = time_of([&] {
        solve_paper_operator(graph, problem, variant.levels ? grid.hierarchy : std::vector<PolygridLevel>{});
      });
    } catch (const std::exception& e) {
      row.note = e.what();
    }
    row.bytes = memory.bytes();
    row.discretisation_error = judged.discretisation_error, row.soft_error = judged.soft_error;
    double others = 0;
    row.application = 0;
    for (const Watched& w : watched) {
      others += w.spent + w.looking;
      if (w.passes > 0) row.application += w.finest / w.passes;
    }
    // Of each channel and node: seven coefficients with their columns, the light, the diagonal, the change, twice κφ.
    row.floor = 3 * (7 * 12 + 5 * 8) * static_cast<double>(row.unknowns) / scene.limits.triad;
    row.setup = {std::max(0.0, whole.processor - others), std::max(0.0, whole.processor - others)};
    for (std::size_t l = 0; l < error_levels.size(); ++l) {
      row.level = error_levels[l];
      row.solve = {};
      row.error = 0;
      bool reached = true;
      for (const Watched& w : watched) {
        reached &= w.seconds[l] >= 0;
        row.solve = row.solve + Seconds{w.seconds[l], w.seconds[l]};
        row.error = std::max(row.error, w.error[l]);
      }
      if (!reached && row.note.empty())
        row.note = variant.depth > 0
                       ? "not reached: its deep nodes stay as they are"
                       : "not reached in " + std::to_string(static_cast<int>(scene.limits.seconds)) + " s a channel";
      table.add(row);
    }
  }
}

DiscreteProblem named(const std::string& size, const char* discretisation) {
  DiscreteProblem problem;
  problem.size = size;
  problem.discretisation = discretisation;
  return problem;
}

// Outlets of a system whose surface has unknowns of its own.
void take_system(DiffusionSystem& system, const std::vector<Double4>& irradiance, std::vector<Double4> fluence,
                 DiscreteProblem& problem) {
  problem.source = boundary_source(system, irradiance);
  problem.fluence = std::move(fluence);
  const std::vector<Double4> exitance = boundary_exitance(system, problem.fluence, irradiance);
  const double factor = 1 / (2 * system.boundary_factor);
  for (std::size_t i = 0; i < exitance.size(); ++i)
    if (system.boundary_area[i] > 0)
      problem.outlets.push_back({static_cast<std::int32_t>(i), system.boundary_area[i],
                                 Double4{factor, factor, factor, factor}, exitance[i]});
  problem.matrix = std::move(system.matrix);
}

// What a polygrid's discretisation tends to.
struct ExactSolution {
  std::vector<Double4> exitance, turned;  // at the outer unknowns; the latter of the turned light
  std::vector<Double4> fluence;           // at the grid's points
  std::vector<Rgb> at_vertices;           // exitance there, then that of the soft light

  ExactSolution(const Polygrid& grid, const Scene& scene, bool with_turned) {
    OwnSolver own(grid, scene);
    own.set_material(1e-9);
    if (with_turned) turned = own.exact(true);
    exitance = own.exact(false);
    fluence = own.solver().fluence();
    at_vertices = own.at_vertices(exitance);
  }
};

// `exact`: where it is known already.
void run_polygrid(const std::string& size, const std::string& path, const Scene& scene,
                  std::optional<ExactSolution>& exact, bool with_paper, Table& table) {
  const Polygrid grid = read_polygrid(path);
  DiscreteProblem problem = named(size, "trilinear");
  if (!exact) exact.emplace(grid, scene, true);
  {
    scene.judge(exact->at_vertices, problem);
    std::vector<SolverParameters> composite(3);  // as deep as 5, 0.5 and 0.1 % want
    for (int k = 0; k < 3; ++k) composite[k].depth = k + 1;
    run_own(size, grid, scene, {"shellgrid cold", {{}}, false}, exact->exitance, problem, table);
    run_own(size, grid, scene, {"shellgrid adaptive", composite, false}, exact->exitance, problem, table);
    run_own(size, grid, scene, {"shellgrid warm", {{}}, true}, exact->turned, problem, table);
    run_own(size, grid, scene, {"shellgrid adaptive warm", composite, true}, exact->turned, problem, table);
  }
  {
    OwnSolver own(grid, scene);
    if (with_paper) run_paper(size, grid, scene, own, table);
    PolygridSystem system;
    problem.assembly = time_of([&] { system = assemble_polygrid_system(grid, own.coefficients(), ior); }).processor;
    std::vector<Double4> irradiance, by_unknown;
    for (const std::int32_t point : system.point_of_unknown) {
      irradiance.push_back(to_double(to_lanes(own.point_light()[point])));
      by_unknown.push_back(exact->fluence[point]);
    }
    take_system(system, irradiance, std::move(by_unknown), problem);
  }
  run_libraries(problem, scene.limits, table);
}

// The light on the surface at the place nearest to another.
Double4 light_near(const Scene& scene, const ClosestPointQuery& query, const Vec3& place) {
  const SurfacePoint at = query.nearest(place);
  Double4 light{};
  for (int k = 0; k < 3; ++k)
    light += at.barycentric[k] * to_double(to_lanes(scene.irradiance[scene.surface.faces(at.face_index, k)]));
  return light;
}

void run_tetrahedra(const std::string& size, const std::string& path, const Scene& scene, Table& table) {
  const TetrahedralMesh mesh = read_tetrahedra(path);
  std::vector<Rgb> absorption, extinction;
  for (Eigen::Index t = 0; t < mesh.tetrahedra.rows(); ++t) {
    Vec3 centre = Vec3::Zero();
    for (int k = 0; k < 4; ++k) centre += mesh.points.row(mesh.tetrahedra(t, k)).transpose() / 4;
    const VeinedMarble::Coefficients here = scene.marble.at(centre);
    absorption.push_back(here.absorption);
    extinction.push_back(here.reduced_extinction);
  }
  DiscreteProblem problem = named(size, "tetrahedra");
  DiffusionSystem system;
  problem.assembly =
      time_of([&] { system = assemble_tetrahedral_system(mesh, absorption, extinction, ior); }).processor;
  std::vector<Double4> irradiance(mesh.points.rows(), Double4{});
  const ClosestPointQuery query(scene.surface);
  for (Eigen::Index p = 0; p < mesh.points.rows(); ++p)
    if (system.boundary_area[p] > 0) irradiance[p] = light_near(scene, query, mesh.points.row(p).transpose());
  std::vector<Double4> soft_irradiance(mesh.points.rows());
  for (Eigen::Index p = 0; p < mesh.points.rows(); ++p)
    soft_irradiance[p] = soft_light(scene, mesh.points.row(p).transpose());
  std::vector<std::vector<Double4>> fluence =
      solve_exactly(system.matrix, {boundary_source(system, irradiance), boundary_source(system, soft_irradiance)});
  const std::vector<Double4> soft_exitance = boundary_exitance(system, fluence[1], soft_irradiance);
  take_system(system, irradiance, std::move(fluence[0]), problem);
  std::vector<Rgb> exitance, soft;
  for (const DiscreteProblem::Outlet& o : problem.outlets) {
    exitance.push_back(to_rgb(o.exitance));
    soft.push_back(to_rgb(soft_exitance[o.unknown]));
  }
  // The boundary's vertices are the outlets, in their order.
  const TriangleMesh boundary = boundary_of(mesh);
  const ClosestPointQuery boundary_query(boundary);
  std::vector<SurfacePoint> places;
  for (int v = 0; v < scene.surface.vertex_count(); ++v)
    places.push_back(boundary_query.nearest(scene.surface.vertex(v)));
  const auto carry = [&](const std::vector<Rgb>& values) {
    std::vector<Rgb> result;
    for (const SurfacePoint& at : places) {
      Rgb sum = Rgb::Zero();
      for (int k = 0; k < 3; ++k)
        sum += static_cast<float>(at.barycentric[k]) * values[boundary.faces(at.face_index, k)];
      result.push_back(sum);
    }
    return result;
  };
  scene.judge(joined(carry(exitance), carry(soft)), problem);
  run_libraries(problem, scene.limits, table);
}

void run_embedded(const std::string& size, const Scene& scene, Table& table) {
  double volume = 0;
  for (int f = 0; f < scene.surface.face_count(); ++f)
    volume += scene.surface.corner(f, 0).dot(scene.surface.corner(f, 1).cross(scene.surface.corner(f, 2))) / 6;
  double area = 0;
  for (double a : scene.vertex_area) area += a;
  // Of the cells that have a part inside, half of those that the surface cuts are surplus.
  const double wanted = std::atof(size.c_str());
  double spacing = std::cbrt(volume / wanted);
  for (int k = 0; k < 20; ++k) spacing = std::cbrt((volume + 0.75 * area * spacing) / wanted);
  DiscreteProblem problem = named(size, "embedded");
  EmbeddedGrid grid;
  EmbeddedSystem system;
  problem.assembly = time_of([&] {
                       grid = embed_surface(scene.surface, spacing);
                       std::vector<Rgb> absorption, extinction;
                       for (std::size_t i = 0; i < grid.cells.size(); ++i) {
                         const VeinedMarble::Coefficients here = scene.marble.at(grid.centre(i));
                         absorption.push_back(here.absorption);
                         extinction.push_back(here.reduced_extinction);
                       }
                       system = assemble_embedded_system(grid, absorption, extinction, ior);
                     }).processor;
  const ClosestPointQuery query(scene.surface);
  std::vector<Double4> irradiance, soft_irradiance;
  for (const EmbeddedGrid::Piece& piece : grid.pieces) {
    irradiance.push_back(light_near(scene, query, piece.centre));
    soft_irradiance.push_back(soft_light(scene, piece.centre));
  }
  problem.source = boundary_source(system, irradiance);
  std::vector<std::vector<Double4>> fluence =
      solve_exactly(system.matrix, {problem.source, boundary_source(system, soft_irradiance)});
  problem.fluence = std::move(fluence[0]);
  const std::vector<Double4> exact = boundary_exitance(system, problem.fluence, irradiance);
  const std::vector<Double4> soft_exact = boundary_exitance(system, fluence[1], soft_irradiance);
  std::vector<Rgb> exitance, soft;
  for (std::size_t k = 0; k < exact.size(); ++k) {
    const EmbeddedSystem::Outlet& o = system.outlets[k];
    problem.outlets.push_back({o.cell, o.area, o.factor, exact[k]});
    exitance.push_back(to_rgb(exact[k]));
    soft.push_back(to_rgb(soft_exact[k]));
  }
  problem.matrix = std::move(system.matrix);
  const auto carry = [&](const std::vector<Rgb>& values) { return pieces_to_vertices(grid, scene.surface, values); };
  scene.judge(joined(carry(exitance), carry(soft)), problem);
  run_libraries(problem, scene.limits, table);
}

}  // namespace

int main(int argc, char** argv) {
  if (argc < 2) {
    std::fprintf(stderr, "diffusion_benchmark FOLDER [SIZE …] [--no-paper]\n");
    return 2;
  }
  const std::filesystem::path folder = argv[1];
  std::vector<std::string> sizes(argv + 2, argv + argc);
  const bool with_paper = std::erase(sizes, "--no-paper") == 0;
  if (sizes.empty())
    sizes = long_form() ? std::vector<std::string>{"1e5", "3e5", "1e6", "3e6"} : std::vector<std::string>{"1e5", "3e5"};
  Scene scene((folder / "surface.ply").string());
  scene.limits.triad = triad_speed();
  if (long_form()) scene.limits.seconds = 60;
  const auto file = [&](const char* kind, const std::string& size) {
    return (folder / (std::string(kind) + "-" + size + ".hdf")).string();
  };
  std::string finest;
  std::optional<ExactSolution> exact_finest;
  for (const char* size : {"3e6", "1e6"}) {
    if (!std::filesystem::exists(file("polygrid", size))) continue;
    finest = size;
    const Polygrid grid = read_polygrid(file("polygrid", size), PolygridParts::cells);
    const bool is_asked = std::find(sizes.begin(), sizes.end(), finest) != sizes.end();
    exact_finest.emplace(grid, scene, is_asked);
    scene.finest = exact_finest->at_vertices;
    if (!is_asked) exact_finest.reset();
    break;
  }
  Table table;
  for (const std::string& size : sizes) {
    std::optional<ExactSolution> exact;
    if (size == finest) exact = std::move(exact_finest);
    run_polygrid(size, file("polygrid", size), scene, exact, with_paper, table);
    exact.reset();
    if (std::filesystem::exists(file("tets", size))) run_tetrahedra(size, file("tets", size), scene, table);
    run_embedded(size, scene, table);
  }
}
