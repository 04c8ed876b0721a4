// SPDX-License-Identifier: AGPL-3.0-or-later
// Order of convergence of the polygrid solver over three refinements, against closed forms and manufactured solutions,
// with the paper's operator beside it on the same grids. SG_LONG takes finer ones.
#include <gtest/gtest.h>

#include <Eigen/Geometry>
#include <cmath>
#include <cstdio>
#include <cstdlib>
#include <functional>
#include <numbers>
#include <vector>

#include "tests/support/paper_graph.h"

namespace shellgrid {
namespace {

using test::ExactProblem;
using test::SolutionErrors;

constexpr double ior = 1.4;
constexpr int grids = 4;

// Across a grid; multiples of four.
int cells_of(int k) {
  static constexpr int usual[grids] = {16, 20, 28, 40}, fine[grids] = {20, 28, 40, 56};
  return (std::getenv("SG_LONG") ? fine : usual)[k];
}

// Errors of both operators on each grid.
struct Convergence {
  std::vector<SolutionErrors> elements, paper;

  double order(double SolutionErrors::*error, int k) const {
    return std::log(elements[k].*error / (elements[k + 1].*error)) / std::log(1.0 * cells_of(k + 1) / cells_of(k));
  }
  // Of the last refinement, and from the first grid to the last.
  void expect_second_order() const {
    for (auto error : {&SolutionErrors::fluence, &SolutionErrors::exitance}) {
      double sum = 0, weights = 0;
      for (int k = 0; k + 1 < grids; ++k) {
        const double step = std::log(1.0 * cells_of(k + 1) / cells_of(k));
        sum += step * order(error, k);
        weights += step;
      }
      EXPECT_GE(order(error, grids - 2), 1.9);
      EXPECT_GE(sum / weights, 1.9);
    }
  }
  // The last refinement takes less than a tenth off the paper's error in the fluence, which is at least `least` times
  // that of elements.
  void expect_plateau(double least) const {
    EXPECT_GT(paper[grids - 1].fluence, 0.9 * paper[grids - 2].fluence);
    EXPECT_GT(paper[grids - 1].fluence, least * elements[grids - 1].fluence);
  }
};

CellCoefficients coefficients_of(const Polygrid& grid, const ExactProblem& exact) {
  CellCoefficients coefficients = homogeneous_coefficients(grid, test::grey_material({0, 1}));
  for (int cell = 0; cell < grid.cells.rows(); ++cell)
    for (int corner = 0; corner < 8; ++corner) {
      const DiffusionCoefficients c = exact.material(gauss_point(grid, cell, corner));
      coefficients.absorption[8 * cell + corner] = Rgb::Constant(static_cast<float>(c.absorption));
      coefficients.reduced_extinction[8 * cell + corner] = Rgb::Constant(static_cast<float>(1 / (3 * c.diffusion())));
    }
  return coefficients;
}

Convergence measure(const char* what, const std::function<std::pair<Polygrid, ExactProblem>(int cells)>& problem) {
  Convergence result;
  std::printf("%s\n  cells  elements: fluence (order)  exitance (order)   paper's operator: fluence  exitance\n", what);
  for (int k = 0; k < grids; ++k) {
    auto [grid, exact] = problem(cells_of(k));
    test::add_graph(grid);
    result.paper.push_back(test::paper_errors(grid, exact, ior));
    const CellCoefficients coefficients = coefficients_of(grid, exact);
    const auto solved = test::solve_problem(std::move(grid), coefficients, ior, [&](const Vec3& x) {
      return Double4{exact.irradiance(x), 0, 0, 0};
    });
    result.elements.push_back(
        {test::fluence_error(solved, exact.fluence), test::exitance_error(solved, exact.exitance)});
    std::printf("  %5d", cells_of(k));
    for (auto error : {&SolutionErrors::fluence, &SolutionErrors::exitance}) {
      std::printf("  %9.3e ", result.elements[k].*error);
      if (k > 0)
        std::printf("(%.2f)", result.order(error, k - 1));
      else
        std::printf("      ");
    }
    std::printf("   %20.3e  %.3e\n", result.paper[k].fluence, result.paper[k].exitance);
    std::fflush(stdout);
  }
  return result;
}

TEST(DiffusionConvergence, Slab) {
  const DiffusionCoefficients material{0.05, 1.0};
  const double thickness = 8;
  const SlabSolution exact(material, thickness, ior, 1, 0);
  const auto at_light = [](const Vec3& x) { return x.z() < 1e-9; };
  const ExactProblem problem{
      [=](const Vec3&) { return material; }, [=](const Vec3& x) { return at_light(x) ? 1.0 : 0.0; },
      [=](const Vec3& x) { return exact.fluence(x.z()); },
      [=](const Vec3& x) { return at_light(x) ? exact.exitance_at_zero : exact.exitance_at_thickness; }};
  for (const double layer : {1.0, 0.1, 0.01})
    measure(("slab, layer of " + std::to_string(layer).substr(0, 4) + " cells").c_str(), [&](int cells) {
      return std::pair(test::slab_grid(2 * cells, 2, thickness, layer), problem);
    }).expect_second_order();
}

TEST(DiffusionConvergence, Ball) {
  for (const double absorption : {0.0008, 0.002}) {
    const DiffusionCoefficients material{absorption, 1.0};
    const SphereSolution exact(material, 10, ior, 1);
    measure(("ball, absorption " + std::to_string(absorption)).c_str(), [&](int cells) {
      return std::pair(test::ball_grid(cells, 10, 0.1),
                       ExactProblem{[=](const Vec3&) { return material; }, [](const Vec3&) { return 1.0; },
                                    [=](const Vec3& x) { return exact.fluence(x.norm()); },
                                    [=](const Vec3&) { return exact.exitance; }});
    }).expect_second_order();
  }
}

TEST(DiffusionConvergence, BallOfTwoLayers) {
  const DiffusionCoefficients inner{0.002, 1.5}, outer{0.05, 0.5};
  const double radius = 10, interface = 5, layer = 0.1;
  const Convergence c = measure("ball of two layers", [&](int cells) {
    const double h = 2 * radius / cells;
    const TwoLayerSphereSolution exact(inner, outer, interface, radius + layer * h, ior, 1);
    // The interface follows faces of cells.
    return std::pair(
        test::ball_grid(cells, radius, layer, true),
        ExactProblem{[=](const Vec3& x) { return x.norm() < interface ? inner : outer; },
                     [](const Vec3&) { return 1.0; }, [=](const Vec3& x) { return exact.fluence(x.norm()); },
                     [=](const Vec3&) { return exact.exitance; }});
  });
  c.expect_second_order();
}

// Values that differ between the faces of a box that meet in a place are averaged.
double over_faces(const Vec3& x, double edge, const std::function<double(const Vec3& normal)>& value) {
  double sum = 0;
  int faces = 0;
  for (int axis = 0; axis < 3; ++axis)
    for (const double side : {-1.0, 1.0})
      if (std::abs(x[axis] - (side > 0 ? edge : 0)) < 1e-9 * edge) {
        sum += value(side * Vec3::Unit(axis));
        ++faces;
      }
  return faces > 0 ? sum / faces : 0;
}

// A solution made up: of its fluence and gradient the light follows by D2, the exitance by D3.
ExactProblem made_up(double edge, const std::function<DiffusionCoefficients(const Vec3&)>& material,
                     const std::function<double(const Vec3&)>& fluence,
                     const std::function<Vec3(const Vec3&)>& gradient) {
  const DiffuseFresnel fresnel = diffuse_fresnel(ior);
  const auto irradiance = [=](const Vec3& x) {
    return over_faces(x, edge, [&](const Vec3& normal) {
      const double slope = material(x).diffusion() * gradient(x).dot(normal);
      return (1 - fresnel.fluence_reflectance) / 4 * (fluence(x) + 2 * fresnel.boundary_factor * slope);
    });
  };
  return {material, irradiance, fluence, [=](const Vec3& x) {
            return irradiance(x) - over_faces(x, edge, [&](const Vec3& normal) {
                     return material(x).diffusion() * gradient(x).dot(normal);
                   });
          }};
}

// D = e^s/3 and φ = e^s of a harmonic s between −1 and 1, so that σ_a = 2 D |∇s|² is no source.
TEST(DiffusionConvergence, DiffusionThatVariesSmoothly) {
  const double edge = 10, k = std::numbers::pi / edge, scale = 1 / std::sinh(std::numbers::pi / 2);
  const auto s = [=](const Vec3& x) { return scale * std::cos(k * x.x()) * std::sinh(k * (x.y() - edge / 2)); };
  const auto slope = [=](const Vec3& x) -> Vec3 {
    return k * scale *
           Vec3(-std::sin(k * x.x()) * std::sinh(k * (x.y() - edge / 2)),
                std::cos(k * x.x()) * std::cosh(k * (x.y() - edge / 2)), 0);
  };
  const auto material = [=](const Vec3& x) {
    const double d = std::exp(s(x)) / 3, absorption = 2 * d * slope(x).squaredNorm();
    return DiffusionCoefficients{absorption, 1 / (3 * d) - absorption};
  };
  const ExactProblem problem = made_up(
      edge, material, [=](const Vec3& x) { return std::exp(s(x)); },
      [=](const Vec3& x) -> Vec3 { return std::exp(s(x)) * slope(x); });
  const Convergence c = measure("cube, diffusion varies by e^±1",
                                [&](int cells) { return std::pair(test::cube_grid(cells, edge, 0.1), problem); });
  c.expect_second_order();
  c.expect_plateau(50);
}

// Cells sheared by up to 15 % of the edge, not at the edges and not along the links.
TEST(DiffusionConvergence, ShearedCells) {
  const double edge = 10;
  const DiffusionCoefficients material{0.03, 1};
  const Vec3 decay = material.decay() * Vec3(1, 1, 1).normalized();
  const ExactProblem problem = made_up(
      edge, [=](const Vec3&) { return material; }, [=](const Vec3& x) { return std::exp(decay.dot(x)); },
      [=](const Vec3& x) -> Vec3 { return std::exp(decay.dot(x)) * decay; });
  const Convergence c = measure("cube, cells sheared by 15 % of the edge", [&](int cells) {
    Polygrid grid = test::cube_grid(cells, edge, 0.1);
    for (Eigen::Index p = 0; p < grid.points.rows(); ++p) {
      const Vec3 u = std::numbers::pi / edge * grid.points.row(p).transpose();
      grid.points(p, 0) += 0.15 * edge * std::pow(std::sin(u.x()) * std::sin(u.y()), 2) * std::cos(u.z());
    }
    return std::pair(std::move(grid), problem);
  });
  c.expect_second_order();
  c.expect_plateau(20);
}

// Shells turned against each other: links to the surface lean by half a radian.
TEST(DiffusionConvergence, TwistedBall) {
  const DiffusionCoefficients material{0.002, 1.0};
  const double radius = 10;
  const SphereSolution exact(material, radius, ior, 1);
  const Convergence c = measure("ball, twisted", [&](int cells) {
    Polygrid grid = test::ball_grid(cells, radius, 0.1);
    for (Eigen::Index p = 0; p < grid.points.rows(); ++p) {
      const Vec3 x = grid.points.row(p).transpose();
      grid.points.row(p) = Eigen::AngleAxisd(0.5 * x.norm() / radius, Vec3::UnitZ()) * x;
    }
    return std::pair(std::move(grid),
                     ExactProblem{[=](const Vec3&) { return material; }, [](const Vec3&) { return 1.0; },
                                  [=](const Vec3& x) { return exact.fluence(x.norm()); },
                                  [=](const Vec3&) { return exact.exitance; }});
  });
  c.expect_second_order();
}

}  // namespace
}  // namespace shellgrid
