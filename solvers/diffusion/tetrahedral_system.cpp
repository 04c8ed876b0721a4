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

// Of each corner pair of a tetrahedron the coupling for D = 1: −∫ ∇h_a·∇h_b.
using EdgeTerms = std::array<double, 6>;

// Rows of the couplings' sums, each in the order of the tetrahedra.
void gather_rows(const TetrahedralMesh& mesh, const std::vector<EdgeTerms>& terms, const std::vector<Rgb>& extinction,
                 std::size_t size, CouplingOperator& matrix) {
  // Of each point the tetrahedra's edges that start there.
  struct Part {
    std::int32_t column, tetrahedron, edge;
    bool operator<(const Part& b) const {
      return std::tie(column, tetrahedron, edge) < std::tie(b.column, b.tetrahedron, b.edge);
    }
  };
  std::vector<std::int64_t> start(size + 1, 0);
  for (Eigen::Index t = 0; t < mesh.tetrahedra.rows(); ++t)
    for (int k = 0; k < 4; ++k) start[mesh.tetrahedra(t, k) + 1] += 3;
  for (std::size_t i = 0; i < size; ++i) start[i + 1] += start[i];
  std::vector<Part> parts(static_cast<std::size_t>(start[size]));
  std::vector<std::int64_t> next(start.begin(), start.end() - 1);
  for (Eigen::Index t = 0; t < mesh.tetrahedra.rows(); ++t)
    for (int e = 0; e < 6; ++e) {
      const std::int32_t a = mesh.tetrahedra(t, edges[e][0]), b = mesh.tetrahedra(t, edges[e][1]);
      parts[next[a]++] = {b, static_cast<std::int32_t>(t), e};
      parts[next[b]++] = {a, static_cast<std::int32_t>(t), e};
    }
  matrix.row_start.assign(size + 1, 0);
  for (std::size_t i = 0; i < size; ++i) {
    std::sort(parts.begin() + start[i], parts.begin() + start[i + 1]);
    for (std::int64_t k = start[i]; k < start[i + 1];) {
      const std::int32_t column = parts[k].column;
      Double4 sum{};
      for (; k < start[i + 1] && parts[k].column == column; ++k) {
        const std::int32_t t = parts[k].tetrahedron;
        sum += terms[t][parts[k].edge] * (1 / (3 * (to_double(to_lanes(extinction[t])) + Double4{0, 0, 0, 1})));
      }
      matrix.column.push_back(column);
      matrix.coupling.push_back(to_float(sum));
    }
    matrix.row_start[i + 1] = static_cast<std::int64_t>(matrix.column.size());
  }
}

void add_boundary_areas(const TetrahedralMesh& mesh, DiffusionSystem& system) {
  // Of each point the other two corners of the faces whose first one it is.
  const std::size_t size = system.boundary_area.size();
  std::vector<std::int64_t> start(size + 1, 0);
  const auto for_each_face = [&](const auto& act) {
    for (Eigen::Index t = 0; t < mesh.tetrahedra.rows(); ++t)
      for (const auto& face : faces) {
        std::array<std::int32_t, 3> corners;
        for (int k = 0; k < 3; ++k) corners[k] = mesh.tetrahedra(t, face[k]);
        std::sort(corners.begin(), corners.end());
        act(corners);
      }
  };
  for_each_face([&](const std::array<std::int32_t, 3>& corners) { ++start[corners[0] + 1]; });
  for (std::size_t i = 0; i < size; ++i) start[i + 1] += start[i];
  std::vector<std::array<std::int32_t, 2>> all(static_cast<std::size_t>(start[size]));
  std::vector<std::int64_t> next(start.begin(), start.end() - 1);
  for_each_face([&](const std::array<std::int32_t, 3>& corners) {
    all[next[corners[0]]++] = {corners[1], corners[2]};
  });
  for (std::size_t p = 0; p < size; ++p) {
    std::sort(all.begin() + start[p], all.begin() + start[p + 1]);
    for (std::int64_t i = start[p]; i < start[p + 1]; ++i) {
      if ((i > start[p] && all[i] == all[i - 1]) || (i + 1 < start[p + 1] && all[i] == all[i + 1])) continue;
      const Vec3 a = mesh.points.row(static_cast<Eigen::Index>(p)).transpose(),
                 b = mesh.points.row(all[i][0]).transpose(), c = mesh.points.row(all[i][1]).transpose();
      const double area = 0.5 * (b - a).cross(c - a).norm();
      system.boundary_area[p] += area / 3;
      for (std::int32_t other : all[i]) system.boundary_area[other] += area / 3;
      system.surface_area += area;
    }
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
  std::vector<EdgeTerms> terms(static_cast<std::size_t>(mesh.tetrahedra.rows()));
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
    for (int e = 0; e < 6; ++e) terms[i][e] = -normal[edges[e][0]].dot(normal[edges[e][1]]) / (36 * volume);
    for (int k = 0; k < 4; ++k)
      system.absorption[mesh.tetrahedra(t, k)] += volume / 4 * to_double(to_lanes(absorption[i]));
    system.volume += volume;
  }
  gather_rows(mesh, terms, reduced_extinction, size, system.matrix);
  add_boundary_areas(mesh, system);
  set_reaction(system);
  return system;
}

}  // namespace shellgrid
