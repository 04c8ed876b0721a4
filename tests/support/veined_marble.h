// SPDX-License-Identifier: AGPL-3.0-or-later
// A marble with dark, dense veins as a function of space, so that any discretisation can take the same material.
#pragma once
#include <cmath>

#include "meshing/core/vec.h"
#include "solvers/diffusion/cell_coefficients.h"

namespace shellgrid::test {

struct VeinedMarble {
  double size = 80;  // of the object, mm; the veins keep their place in it

  struct Coefficients {
    Rgb absorption, reduced_extinction;  // mm⁻¹
  };
  Coefficients at(const Vec3& place) const {
    const Vec3 x = place * (12 / size);
    const double wave = std::sin(x.x() + 1.7 * std::sin(x.y()) + x.z()) * std::sin(1.3 * x.y() - 0.7 * x.z());
    const auto vein = static_cast<float>(std::exp(-20 * wave * wave));
    const Rgb scattering = Rgb(2.19f, 2.62f, 3.0f) * (1 + vein * Rgb(3.0f, 2.0f, 1.0f));
    const Rgb absorption = Rgb(0.0021f, 0.0041f, 0.0071f) * (1 + 20 * vein);
    return {absorption, absorption + scattering};
  }

  CellCoefficients of(const Polygrid& grid) const {
    const auto cells = static_cast<std::size_t>(grid.cells.rows());
    CellCoefficients c;
    c.absorption.resize(8 * cells);
    c.reduced_extinction.resize(8 * cells);
    for (std::size_t cell = 0; cell < cells; ++cell)
      for (int q = 0; q < 8; ++q) {
        const Coefficients here = at(gauss_point(grid, static_cast<int>(cell), q));
        c.absorption[8 * cell + q] = here.absorption;
        c.reduced_extinction[8 * cell + q] = here.reduced_extinction;
      }
    return c;
  }
};

}  // namespace shellgrid::test
