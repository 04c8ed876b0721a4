// SPDX-License-Identifier: AGPL-3.0-or-later
// The paper's graph of small polygrids made in code, and its operator held against exact solutions.
#pragma once
#include <cmath>
#include <functional>
#include <map>
#include <tuple>

#include "meshing/polycube/laplacian_weights.h"
#include "solvers/diffusion/cell_coefficients.h"
#include "solvers/diffusion/paper_operator.h"
#include "solvers/scattering/fresnel.h"
#include "tests/support/diffusion_problem.h"

namespace shellgrid::test {

// Cell centres, boundary nodes in the middle of their quads, weights of appendix B. A side without a layer mirrors: its
// cells are linked to themselves, at the place opposite to the link on their other side.
inline void add_graph(Polygrid& grid) {
  PolygridGraph& graph = grid.graph;
  const Eigen::Index quads = grid.boundary_quads.rows(), cores = grid.cells.rows() - quads;
  const auto key = [](const Vec3i& at) { return std::tuple(at.z(), at.y(), at.x()); };
  std::map<std::tuple<int, int, int>, std::int32_t> cell_at;
  graph.interior.setZero(cores, 3);
  for (Eigen::Index i = 0; i < cores; ++i) {
    for (int a = 0; a < 8; ++a) graph.interior.row(i) += grid.points.row(grid.cells(i, a)) / 8;
    cell_at[key(grid.cell_lattice.row(i).transpose())] = static_cast<std::int32_t>(i);
  }
  graph.links.resize(cores, 6);
  for (Eigen::Index i = 0; i < cores; ++i)
    for (int side = 0; side < 6; ++side) {
      const Vec3i there = grid.cell_lattice.row(i).transpose() + (side % 2 ? 1 : -1) * Vec3i::Unit(side / 2);
      const auto found = cell_at.find(key(there));
      graph.links(i, side) = found == cell_at.end() ? static_cast<std::int32_t>(i) : found->second;
    }
  graph.boundary.setZero(quads, 3);
  for (Eigen::Index q = 0; q < quads; ++q) {
    for (int k = 0; k < 4; ++k) graph.boundary.row(q) += grid.points.row(grid.boundary_quads(q, k)) / 4;
    const std::int32_t owner = cell_at.at(key(grid.cell_lattice.row(cores + q).transpose()));
    // The side on which the layer cell stands: that of the quad's lattice face.
    Vec3 middle = Vec3::Zero();
    for (int k = 0; k < 4; ++k) middle += grid.point_lattice.row(grid.boundary_quads(q, k)).cast<double>() / 4;
    const Vec3 step = middle - grid.cell_lattice.row(owner).transpose().cast<double>() - Vec3::Constant(0.5);
    int axis;
    step.cwiseAbs().maxCoeff(&axis);
    graph.links(owner, 2 * axis + (step[axis] > 0 ? 1 : 0)) = static_cast<std::int32_t>(-1 - q);
    graph.boundary_owner.push_back(owner);
    graph.boundary_distance.push_back((graph.boundary.row(q) - graph.interior.row(owner)).norm());
  }
  graph.weights.resize(cores, 6);
  for (Eigen::Index i = 0; i < cores; ++i) {
    std::array<Vec3, 6> offsets;
    for (int side = 0; side < 6; ++side) {
      const std::int32_t link = graph.links(i, side);
      const auto place = link >= 0 ? graph.interior.row(link) : graph.boundary.row(-1 - link);
      offsets[side] = (place - graph.interior.row(i)).transpose();
    }
    for (int side = 0; side < 6; ++side)
      if (graph.links(i, side) == i) offsets[side] = -offsets[side ^ 1];
    const LaplacianWeights weights = laplacian_weights(offsets, grid.spacing);
    for (int side = 0; side < 6; ++side) graph.weights(i, side) = weights.weights[side];
  }
}

// A diffusion problem of which everything is known, of places.
struct ExactProblem {
  std::function<DiffusionCoefficients(const Vec3&)> material;
  std::function<double(const Vec3&)> irradiance, fluence, exitance;
};

// Relative L2 errors over the volume and over the surface.
struct SolutionErrors {
  double fluence = 0, exitance = 0;
};

// Of the paper's operator with the boundary condition D2, so that nothing but the operator differs.
inline SolutionErrors paper_errors(const Polygrid& grid, const ExactProblem& exact, double ior) {
  const PolygridGraph& graph = grid.graph;
  const DiffuseFresnel fresnel = diffuse_fresnel(ior);
  PaperProblem problem;
  problem.boundary_factor = fresnel.boundary_factor;
  problem.tolerance = 1e-8;
  const auto diffusion = [&](const Vec3& x) {
    return Rgb::Constant(static_cast<float>(exact.material(x).diffusion()));
  };
  for (Eigen::Index i = 0; i < graph.interior.rows(); ++i) {
    const Vec3 x = graph.interior.row(i).transpose();
    problem.diffusion.push_back(diffusion(x));
    problem.absorption.push_back(Rgb::Constant(static_cast<float>(exact.material(x).absorption)));
  }
  for (Eigen::Index b = 0; b < graph.boundary.rows(); ++b) {
    const Vec3 x = graph.boundary.row(b).transpose();
    problem.boundary_diffusion.push_back(diffusion(x));
    problem.boundary_light.push_back(
        Rgb(static_cast<float>(4 * exact.irradiance(x) / (1 - fresnel.fluence_reflectance)), 0, 0));
  }
  const PaperSolution solution = solve_paper_operator(graph, problem);
  double error = 0, size = 0;
  SolutionErrors errors;
  for (Eigen::Index i = 0; i < graph.interior.rows(); ++i) {
    const double expected = exact.fluence(graph.interior.row(i).transpose()), volume = cell_volume(grid, i);
    error += volume * std::pow(solution.interior[i][0] - expected, 2);
    size += volume * expected * expected;
  }
  errors.fluence = std::sqrt(error / size);
  error = size = 0;
  for (Eigen::Index b = 0; b < graph.boundary.rows(); ++b) {
    const Vec3 x = graph.boundary.row(b).transpose();
    const auto areas = quad_areas(grid, b);
    const double area = areas[0] + areas[1] + areas[2] + areas[3], expected = exact.exitance(x);
    const double slope =
        (solution.boundary[b][0] - solution.interior[graph.boundary_owner[b]][0]) / graph.boundary_distance[b];
    error += area * std::pow(exact.irradiance(x) - exact.material(x).diffusion() * slope - expected, 2);
    size += area * expected * expected;
  }
  errors.exitance = std::sqrt(error / size);
  return errors;
}

}  // namespace shellgrid::test
