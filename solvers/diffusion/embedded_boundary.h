// SPDX-License-Identifier: AGPL-3.0-or-later
// The diffusion equation on a regular grid whose cells the object's surface cuts: what the polygrid is compared with.
#pragma once
#include <cstdint>
#include <vector>

#include "meshing/core/grid_frame.h"
#include "meshing/core/triangle_mesh.h"
#include "solvers/diffusion/diffusion_system.h"

namespace shellgrid {

// What of a regular grid's cells lies inside an object. Source: [Haber2005].
// Deviates: one spacing everywhere, no octree.
struct EmbeddedGrid {
  // The part of a face between two cells through which they exchange light.
  struct Face {
    std::int32_t lower, upper;  // cells; `upper` lies towards + of one axis
    double area;                // mm²
  };
  // The surface within one cell.
  struct Piece {
    std::int32_t cell;
    double area;          // mm²
    Vec3 centre, normal;  // mm; unit, outward
  };
  GridFrame frame;             // cell (i, j, k) reaches from grid point (i, j, k) to (i + 1, j + 1, k + 1)
  std::vector<Vec3i> cells;    // n, ascending in (z, y, x)
  std::vector<double> volume;  // n: inside, mm³
  std::vector<Face> faces;
  std::vector<Piece> pieces;  // ascending by cell

  Vec3 centre(std::size_t cell) const { return frame.to_world(cells[cell]) + Vec3::Constant(0.5 * frame.voxel); }
};

// Cuts the cells by the zero level of signed distances (mm, negative inside) at `counts` grid points, x fastest. Each
// cell is six tetrahedra about its diagonal, in which the distance is linear: so the parts of volumes, faces and
// surface belong together to rounding. Distances below 1e-4 of the spacing are raised to it. Throws: InputError where
// the sizes disagree, a distance is not finite, the object reaches the grid's rim, or nothing lies inside.
EmbeddedGrid embed_level_set(const GridFrame& frame, const Vec3i& counts, const std::vector<float>& distance);

// The same for a closed surface, on grid points spacing·(i, j, k). Throws: InputError for a surface that is open, or
// more than 1e9 cells about it.
EmbeddedGrid embed_surface(const TriangleMesh& surface, double spacing);

// Finite volumes: unknowns are the fluences at the cells' centres, also where these lie outside.
struct EmbeddedSystem {
  // Where a piece of the surface takes its light from and to.
  struct Outlet {
    std::int32_t cell;  // own or a deeper neighbour
    double area;        // mm²
    Double4 factor;     // of channel c: −D ∂φ/∂n = factor (φ_cell − 4 q / (1 − R_φ))
  };
  CouplingOperator matrix;
  std::vector<Double4> absorption;  // n: ∫ σ_a dV, mm²
  std::vector<Outlet> outlets;      // one a piece
  double light_factor = 4;          // 4 / (1 − R_φ)
};

// Assembles D1 and D2 in conservative form: ∫ over a cell's part of its faces of D ∂φ/∂n by differences of centres (the
// harmonic mean of the cells' D), over its piece of the surface by D2, with φ there continued along the normal from the
// centre. Where that centre lies too far outside for the material (beyond C D), the nearest centre below the piece
// stands for it: so cells cut to slivers lose nothing but their own sharpness, and the matrix is an M-matrix.
// σ_a and σ_t', mm⁻¹, one a cell. `ior` ≥ 1. Throws: InputError for coefficients that are not one a cell, not finite or
// not positive.
EmbeddedSystem assemble_embedded_system(const EmbeddedGrid& grid, const std::vector<Rgb>& absorption,
                                        const std::vector<Rgb>& reduced_extinction, double ior);

// Right-hand side for the irradiance q of each piece, W mm⁻².
std::vector<Double4> boundary_source(const EmbeddedSystem& system, const std::vector<Double4>& irradiance);

// M of D3 at each piece.
std::vector<Double4> boundary_exitance(const EmbeddedSystem& system, const std::vector<Double4>& fluence,
                                       const std::vector<Double4>& irradiance);

// The terms of D4.
EnergyBalance energy_balance(const EmbeddedSystem& system, const std::vector<Double4>& fluence,
                             const std::vector<Double4>& irradiance);

// Values of the pieces at a surface's vertices: by linear least squares over the pieces in the 3×3×3 cells about each,
// weighted by area and nearness; the nearest piece's where there are too few. Throws: InputError where the values are
// not one a piece.
std::vector<Rgb> pieces_to_vertices(const EmbeddedGrid& grid, const TriangleMesh& surface,
                                    const std::vector<Rgb>& values);

}  // namespace shellgrid
