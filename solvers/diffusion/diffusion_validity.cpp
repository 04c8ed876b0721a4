// SPDX-License-Identifier: AGPL-3.0-or-later
#include "solvers/diffusion/diffusion_validity.h"

#include <fmt/format.h>

#include <algorithm>
#include <array>
#include <cmath>

#include "meshing/core/parallel.h"
#include "solvers/diffusion/polygrid_system.h"
#include "solvers/diffusion/trilinear_cell.h"

namespace shellgrid {
namespace {

constexpr std::array albedos = {0.5, 0.8, 0.95, 0.99, 0.999, 0.9999};
constexpr std::array thicknesses = {1.0, 3.0, 10.0, 30.0, 100.0};
using ErrorTable = std::array<std::array<double, thicknesses.size()>, albedos.size()>;

// Percent; 100 where sg-diffuse refuses.
constexpr ErrorTable boundary_errors = {{{98, 88, 100, 100, 100},
                                         {96, 44, 26, 29, 63},
                                         {92, 27, 13, 8.5, 10},
                                         {91, 22, 10, 6.5, 5.8},
                                         {91, 21, 8.9, 5.3, 4.3},
                                         {91, 21, 8.8, 5.1, 3.9}}};
constexpr ErrorTable first_collision_errors = {{{98, 80, 61, 27, 18},
                                                {95, 52, 28, 16, 13},
                                                {92, 31, 13, 7.1, 8.3},
                                                {90, 25, 8.2, 3.8, 5.1},
                                                {90, 24, 7, 3.1, 4},
                                                {90, 24, 6.9, 3.1, 3.8}}};

// The place of a value between the entries of a growing list.
struct Between {
  std::size_t low;
  double share;
};

template <std::size_t n>
Between find(const std::array<double, n>& list, double value) {
  const auto above = std::upper_bound(list.begin() + 1, list.end() - 1, value);
  const auto low = static_cast<std::size_t>(above - list.begin()) - 1;
  return {low, std::clamp((value - list[low]) / (list[low + 1] - list[low]), 0.0, 1.0)};
}

double expected_error(double albedo, double thickness, const ErrorTable& table) {
  static const auto logarithms = [](auto list, const auto& function) {
    for (double& value : list) value = std::log(function(value));
    return list;
  };
  static const auto log_thicknesses = logarithms(thicknesses, [](double t) { return t; });
  static const auto log_albedos = logarithms(albedos, [](double a) { return 1 / (1 - a); });
  const Between row = find(log_albedos, -std::log(std::max(1 - albedo, 1e-30)));
  const Between column = find(log_thicknesses, std::log(std::max(thickness, 1e-30)));
  double sum = 0;
  for (std::size_t i = 0; i < 2; ++i)
    for (std::size_t j = 0; j < 2; ++j)
      sum += (i == 1 ? row.share : 1 - row.share) * (j == 1 ? column.share : 1 - column.share) *
             std::log(table[row.low + i][column.low + j]);
  return std::exp(sum) / 100;
}

}  // namespace

DiffusionRegime diffusion_regime(const Polygrid& polygrid, const CellCoefficients& coefficients,
                                 const std::vector<Rgb>& fluence) {
  struct Sums {
    double volume = 0;
    Eigen::Array3d extinction = Eigen::Array3d::Zero();
    Eigen::Array3d met = Eigen::Array3d::Zero(), absorbed = Eigen::Array3d::Zero();  // times the fluence
    Sums operator+(const Sums& b) const {
      return {volume + b.volume, extinction + b.extinction, met + b.met, absorbed + b.absorbed};
    }
  };
  static const TrilinearShape middle(Vec3::Constant(0.5));
  const auto cells = static_cast<std::size_t>(polygrid.cells.rows());
  const Sums sums = parallel_sum(
      cells, Sums{},
      [&](std::size_t cell) {
        Sums s;
        s.volume = jacobian(cell_corners(polygrid, static_cast<int>(cell)), middle).determinant();
        Rgb extinction = Rgb::Zero(), absorption = Rgb::Zero(), light = Rgb::Zero();
        for (int k = 0; k < 8; ++k) {
          extinction += coefficients.reduced_extinction[8 * cell + k] / 8;
          absorption += coefficients.absorption[8 * cell + k] / 8;
          light += fluence[polygrid.cells(static_cast<Eigen::Index>(cell), k)].max(0.0f) / 8;
        }
        s.extinction = s.volume * extinction.cast<double>();
        s.met = s.volume * (extinction * light).cast<double>();
        s.absorbed = s.volume * (absorption * light).cast<double>();
        return s;
      },
      4096);
  double area = 0;
  for (Eigen::Index q = 0; q < polygrid.boundary_quads.rows(); ++q)
    for (const double part : quad_areas(polygrid, q)) area += part;
  DiffusionRegime regime;
  regime.thickness = (4 * sums.extinction / area).cast<float>();
  regime.reduced_albedo =
      (sums.met > 0).select(1 - sums.absorbed / sums.met.max(1e-300), Eigen::Array3d::Ones()).cast<float>();
  return regime;
}

Rgb expected_diffusion_error(const DiffusionRegime& regime, bool first_collision) {
  Rgb error;
  for (int c = 0; c < 3; ++c)
    error[c] = static_cast<float>(expected_error(regime.reduced_albedo[c], regime.thickness[c],
                                                 first_collision ? first_collision_errors : boundary_errors));
  return error;
}

std::string diffusion_warning(const DiffusionRegime& regime, bool first_collision,
                              const Eigen::Array<bool, 3, 1>& lit) {
  static const char* const colour[] = {"red", "green", "blue"};
  const Rgb error = expected_diffusion_error(regime, first_collision);
  const Rgb other = expected_diffusion_error(regime, !first_collision);
  int worst = -1;
  for (int c = 0; c < 3; ++c)
    if (lit[c] && (worst < 0 || error[c] > error[worst])) worst = c;
  if (worst < 0 || error[worst] <= tolerable_diffusion_error) return "";
  const bool grey = (regime.reduced_albedo == regime.reduced_albedo[0]).all() &&
                    (regime.thickness == regime.thickness[0]).all() && lit.all();
  const bool helps = other[worst] < 0.7f * error[worst];
  return fmt::format(
      "diffusion is outside its range: expect the exitance to be about {:.0f} % off{}, where the reduced albedo is "
      "{:.3g} and the object {:.2g} mean free paths thick{}; sg-reference is right there",
      100 * error[worst], grey ? "" : fmt::format(" in {}", colour[worst]), regime.reduced_albedo[worst],
      regime.thickness[worst],
      helps ? fmt::format(" (with method.source {}: {:.0f} %)", first_collision ? "boundary" : "first-collision",
                          100 * other[worst])
            : "");
}

}  // namespace shellgrid
