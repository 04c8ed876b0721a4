// SPDX-License-Identifier: AGPL-3.0-or-later
#include "solvers/diffusion/tetrahedral_system.h"

#include <Eigen/Geometry>
#include <algorithm>
#include <array>
#include <string>
#include <tuple>

#include "meshing/core/error.h"
#include "solvers/scattering/fresnel.h"

namespace shellgrid {
namespace {

constexpr int edges[6][2] = {{0, 1}, {0, 2}, {0, 3}, {1, 2}, {1, 3}, {2, 3}};
// Face k lies opposite corner k.
constexpr int faces[4][3] = {{1, 2, 3}, {0, 2, 3}, {0, 1, 3}, {0, 1, 2}};

void check_mesh(const TetrahedralMesh& mesh, const std::vector<Rgb>& absorption,
                const std::vector<Rgb>& reduced_extinction) {
  const auto count = static_cast<std::size_t>(mesh.tetrahedra.rows());
  if (count == 0) throw InputError("tetrahedra: there are none");
  if ((mesh.tetrahedra.array() < 0).any() || (mesh.tetrahedra.array() >= mesh.points.rows()).any())
    throw InputError("tetrahedra: a point index is out of range");
  if (!mesh.points.allFinite()) throw InputError("tetrahedra: a coordinate is not finite");
  if (absorption.size() != count || reduced_extinction.size() != count)
    throw InputError("tetrahedra: the coefficients do not belong to them");
  for (std::size_t t = 0; t < count; ++t)
    if (!absorption[t].isFinite().all() || !(absorption[t] >= 0).all() || !reduced_extinction[t].isFinite().all() ||
        !(reduced_extinction[t] > 0).all())
      throw InputError("tetrahedra: a coefficient of number " + std::to_string(t) + " is not positive or not finite");
}

struct Coupling {
  std::int32_t row, column;
  std::size_t number;
  Double4 value;
};

// Rows of the couplings' sums; equal pairs are added in the order of their numbers.
void set_rows(std::vector<Coupling>& couplings, std::size_t size, CouplingOperator& matrix) {
  std::sort(couplings.begin(), couplings.end(), [](const Coupling& a, const Coupling& b) {
    return std::tie(a.row, a.column, a.number) < std::tie(b.row, b.column, b.number);
  });
  matrix.row_start.assign(size + 1, 0);
  for (std::size_t first = 0; first < couplings.size();) {
    std::size_t last = first;
    Double4 sum{};
    for (; last < couplings.size() && couplings[last].row == couplings[first].row &&
           couplings[last].column == couplings[first].column;
         ++last)
      sum += couplings[last].value;
    matrix.column.push_back(couplings[first].column);
    matrix.coupling.push_back(to_float(sum));
    ++matrix.row_start[couplings[first].row + 1];
    first = last;
  }
  for (std::size_t i = 0; i < size; ++i) matrix.row_start[i + 1] += matrix.row_start[i];
}

void add_boundary_areas(const TetrahedralMesh& mesh, DiffusionSystem& system) {
  std::vector<std::array<std::int32_t, 3>> all;
  for (Eigen::Index t = 0; t < mesh.tetrahedra.rows(); ++t)
    for (const auto& face : faces) {
      std::array<std::int32_t, 3> corners;
      for (int k = 0; k < 3; ++k) corners[k] = mesh.tetrahedra(t, face[k]);
      std::sort(corners.begin(), corners.end());
      all.push_back(corners);
    }
  std::sort(all.begin(), all.end());
  for (std::size_t i = 0; i < all.size(); ++i) {
    if ((i > 0 && all[i] == all[i - 1]) || (i + 1 < all.size() && all[i] == all[i + 1])) continue;
    const Vec3 a = mesh.points.row(all[i][0]).transpose(), b = mesh.points.row(all[i][1]).transpose(),
               c = mesh.points.row(all[i][2]).transpose();
    const double area = 0.5 * (b - a).cross(c - a).norm();
    for (std::int32_t p : all[i]) system.boundary_area[p] += area / 3;
    system.surface_area += area;
  }
}

}  // namespace

DiffusionSystem assemble_tetrahedral_system(const TetrahedralMesh& mesh, const std::vector<Rgb>& absorption,
                                            const std::vector<Rgb>& reduced_extinction, double ior) {
  check_mesh(mesh, absorption, reduced_extinction);
  const DiffuseFresnel fresnel = diffuse_fresnel(ior);
  const auto size = static_cast<std::size_t>(mesh.points.rows());
  DiffusionSystem system;
  system.boundary_factor = fresnel.boundary_factor;
  system.current_reflectance = fresnel.current_reflectance;
  system.absorption.assign(size, Double4{});
  system.boundary_area.assign(size, 0.0);
  std::vector<Coupling> couplings;
  couplings.reserve(12 * static_cast<std::size_t>(mesh.tetrahedra.rows()));
  for (Eigen::Index t = 0; t < mesh.tetrahedra.rows(); ++t) {
    Vec3 x[4], normal[4];
    for (int k = 0; k < 4; ++k) x[k] = mesh.points.row(mesh.tetrahedra(t, k)).transpose();
    const double volume = (x[1] - x[0]).cross(x[2] - x[0]).dot(x[3] - x[0]) / 6;
    if (!(volume > 0))
      throw InputError("tetrahedra: number " + std::to_string(t) + " is inverted or flat; fill the surface anew");
    // Gradients of the hat functions times 6 V.
    normal[0] = (x[3] - x[1]).cross(x[2] - x[1]);
    normal[1] = (x[2] - x[0]).cross(x[3] - x[0]);
    normal[2] = (x[3] - x[0]).cross(x[1] - x[0]);
    normal[3] = (x[1] - x[0]).cross(x[2] - x[0]);
    const auto i = static_cast<std::size_t>(t);
    const Double4 diffusion = 1 / (3 * (to_double(to_lanes(reduced_extinction[i])) + Double4{0, 0, 0, 1}));
    for (const auto& edge : edges) {
      const Double4 value = -normal[edge[0]].dot(normal[edge[1]]) / (36 * volume) * diffusion;
      couplings.push_back({mesh.tetrahedra(t, edge[0]), mesh.tetrahedra(t, edge[1]), couplings.size(), value});
      couplings.push_back({mesh.tetrahedra(t, edge[1]), mesh.tetrahedra(t, edge[0]), couplings.size(), value});
    }
    for (int k = 0; k < 4; ++k)
      system.absorption[mesh.tetrahedra(t, k)] += volume / 4 * to_double(to_lanes(absorption[i]));
    system.volume += volume;
  }
  set_rows(couplings, size, system.matrix);
  add_boundary_areas(mesh, system);
  set_reaction(system);
  return system;
}

}  // namespace shellgrid
