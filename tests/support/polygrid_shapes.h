// SPDX-License-Identifier: AGPL-3.0-or-later
// Small polygrids made in code, for tests: a box and a ball, each with its thin boundary layer.
#pragma once
#include <array>
#include <cmath>
#include <functional>
#include <map>
#include <vector>

#include "meshing/polycube/polygrid.h"

namespace shellgrid::test {

// Which sides of a lattice box carry the thin layer: −x +x −y +y −z +z.
using Sides = std::array<bool, 6>;
inline constexpr Sides all_sides = {true, true, true, true, true, true};

// A box of nx×ny×nz core cells. `inner` maps a lattice point into the object; `outer` gives the surface point above
// an inner point of a layered side. Sides without a layer are impermeable.
inline Polygrid mapped_box(const Vec3i& cells, const Sides& sides, const std::function<Vec3(const Vec3&)>& inner,
                           const std::function<Vec3(const Vec3&)>& outer, double spacing) {
  Polygrid grid;
  grid.spacing = spacing;
  const Vec3i counts = cells + Vec3i::Ones();
  auto index = [&](int x, int y, int z) { return (z * counts.y() + y) * counts.x() + x; };
  const int inner_count = counts.prod();
  std::vector<Vec3> points;
  std::vector<Vec3i> lattice;
  for (int z = 0; z < counts.z(); ++z)
    for (int y = 0; y < counts.y(); ++y)
      for (int x = 0; x < counts.x(); ++x) {
        points.push_back(inner(Vec3(x, y, z)));
        lattice.push_back({x, y, z});
      }
  std::vector<int> twin(inner_count, -1);
  std::vector<std::array<int, 8>> hexes;
  std::vector<Vec3i> hex_lattice;
  static const int corner[8][3] = {{0, 0, 0}, {1, 0, 0}, {1, 1, 0}, {0, 1, 0},
                                   {0, 0, 1}, {1, 0, 1}, {1, 1, 1}, {0, 1, 1}};
  for (int z = 0; z < cells.z(); ++z)
    for (int y = 0; y < cells.y(); ++y)
      for (int x = 0; x < cells.x(); ++x) {
        std::array<int, 8> hex;
        for (int a = 0; a < 8; ++a) hex[a] = index(x + corner[a][0], y + corner[a][1], z + corner[a][2]);
        hexes.push_back(hex);
        hex_lattice.push_back({x, y, z});
      }
  const std::size_t core = hexes.size();
  // A side's corners counter-clockwise seen from outside.
  static const int face[6][4] = {{0, 4, 7, 3}, {1, 2, 6, 5}, {0, 1, 5, 4}, {3, 7, 6, 2}, {0, 3, 2, 1}, {4, 5, 6, 7}};
  std::map<int, int> outer_of;
  std::vector<std::array<int, 4>> quads;
  for (std::size_t h = 0; h < core; ++h)
    for (int side = 0; side < 6; ++side) {
      const int axis = side / 2;
      if (!sides[side] || hex_lattice[h][axis] != (side % 2 ? cells[axis] - 1 : 0)) continue;
      std::array<int, 4> base, top;
      for (int k = 0; k < 4; ++k) {
        base[k] = hexes[h][face[side][k]];
        auto found = outer_of.find(base[k]);
        if (found == outer_of.end()) {
          found = outer_of.emplace(base[k], static_cast<int>(points.size())).first;
          points.push_back(outer(lattice[base[k]].cast<double>()));
          lattice.push_back(lattice[base[k]]);
          twin.push_back(base[k]);
        }
        top[k] = found->second;
      }
      quads.push_back(top);
      hexes.push_back({base[0], base[1], base[2], base[3], top[0], top[1], top[2], top[3]});
      hex_lattice.push_back(hex_lattice[h]);
    }
  const auto n = static_cast<Eigen::Index>(points.size()), m = static_cast<Eigen::Index>(hexes.size());
  grid.points.resize(n, 3);
  grid.point_lattice.resize(n, 3);
  grid.point_normal = VertexMatrix::Zero(n, 3);
  grid.outer_twin.assign(twin.begin(), twin.end());
  for (Eigen::Index i = 0; i < n; ++i) {
    grid.points.row(i) = points[i].transpose();
    grid.point_lattice.row(i) = lattice[i].transpose();
    if (twin[i] >= 0) grid.point_normal.row(i) = (points[i] - points[twin[i]]).normalized().transpose();
  }
  grid.cells.resize(m, 8);
  grid.cell_lattice.resize(m, 3);
  for (Eigen::Index h = 0; h < m; ++h) {
    for (int a = 0; a < 8; ++a) grid.cells(h, a) = hexes[h][a];
    grid.cell_lattice.row(h) = hex_lattice[h].transpose();
    grid.cell_layer.push_back(h < static_cast<Eigen::Index>(core) ? 0 : 1);
  }
  grid.boundary_quads.resize(quads.size(), 4);
  for (std::size_t q = 0; q < quads.size(); ++q)
    for (int k = 0; k < 4; ++k) grid.boundary_quads(q, k) = quads[q][k];
  return grid;
}

// The plane-parallel slab 0 ≤ z ≤ thickness, n cells of equal size across, `across`² of them along; light meets
// both faces, the four sides are impermeable. `layer` is the thin layer's share of a cell.
inline Polygrid slab_grid(int n, int across, double thickness, double layer) {
  const double h = thickness / (n + 2 * layer);
  auto inner = [=](const Vec3& p) { return Vec3(p.x() * h, p.y() * h, (p.z() + layer) * h); };
  auto outer = [=](const Vec3& p) { return Vec3(p.x() * h, p.y() * h, p.z() == 0 ? 0.0 : thickness); };
  return mapped_box({across, across, n}, {false, false, false, false, true, true}, inner, outer, h);
}

// The ball of a radius about the origin, n³ core cells: cubes in the middle that turn into spherical shells towards the
// surface. `nested`: spherical shells all the way, so that interfaces at multiples of 2/n of the radius fall on faces.
inline Polygrid ball_grid(int n, double radius, double layer, bool nested = false) {
  const double h = 2 * radius / n;
  auto unit = [=](const Vec3& p) -> Vec3 {
    const Vec3 x = 2.0 / n * p - Vec3::Ones();
    const double largest = x.cwiseAbs().maxCoeff();
    if (largest == 0) return x;
    const double share = nested ? 1 : largest * largest;
    return x * ((1 - share) * 0.7 + share * largest / x.norm());
  };
  auto inner = [=](const Vec3& p) -> Vec3 { return (nested ? radius : radius - layer * h) * unit(p); };
  auto outer = [=](const Vec3& p) -> Vec3 { return (nested ? radius + layer * h : radius) * unit(p); };
  return mapped_box(Vec3i::Constant(n), all_sides, inner, outer, h);
}

// The box [0, edge]³, n³ core cells and a layer: equal, axis-aligned cells.
inline Polygrid cube_grid(int n, double edge, double layer) {
  const double h = edge / (n + 2 * layer);
  auto inner = [=](const Vec3& p) -> Vec3 { return h * (p + Vec3::Constant(layer)); };
  // Outer points of the cube's edges stand off diagonally.
  auto outer = [=](const Vec3& p) -> Vec3 {
    Vec3 x = inner(p);
    for (int k = 0; k < 3; ++k) x[k] = p[k] == 0 ? 0 : p[k] == n ? edge : x[k];
    return x;
  };
  return mapped_box(Vec3i::Constant(n), all_sides, inner, outer, h);
}

// The paper's graph on cube_grid: cell centres, boundary nodes straight above them, weights of unequal three-point
// differences (what appendix B gives on an orthogonal grid).
inline void add_cube_graph(Polygrid& grid, int n, double edge) {
  PolygridGraph& graph = grid.graph;
  const Eigen::Index cores = static_cast<Eigen::Index>(n) * n * n, quads = grid.boundary_quads.rows();
  graph.interior.setZero(cores, 3);
  for (Eigen::Index i = 0; i < cores; ++i)
    for (int a = 0; a < 8; ++a) graph.interior.row(i) += grid.points.row(grid.cells(i, a)) / 8;
  graph.boundary.resize(quads, 3);
  graph.boundary_owner.resize(quads);
  graph.boundary_distance.resize(quads);
  graph.links.setZero(cores, 6);
  graph.weights.resize(cores, 6);
  auto cell = [&](const Vec3i& at) { return (at.z() * n + at.y()) * n + at.x(); };
  Eigen::Index next = 0;
  for (Eigen::Index i = 0; i < cores; ++i) {
    const Vec3i at = grid.cell_lattice.row(i).transpose();
    for (int side = 0; side < 6; ++side) {
      const Vec3i there = at + (side % 2 ? 1 : -1) * Vec3i::Unit(side / 2);
      if (there[side / 2] >= 0 && there[side / 2] < n) {
        graph.links(i, side) = cell(there);
        continue;
      }
      graph.boundary.row(next) = graph.interior.row(i);
      graph.boundary(next, side / 2) = side % 2 ? edge : 0;
      graph.boundary_owner[next] = static_cast<std::int32_t>(i);
      graph.boundary_distance[next] = std::abs(graph.boundary(next, side / 2) - graph.interior(i, side / 2));
      graph.links(i, side) = static_cast<std::int32_t>(-1 - next++);
    }
    for (int side = 0; side < 6; ++side) {
      double distance[2];
      for (int k = 0; k < 2; ++k) {
        const std::int32_t link = graph.links(i, k == 0 ? side : side ^ 1);
        const Vec3 other = (link >= 0 ? graph.interior.row(link) : graph.boundary.row(-1 - link)).transpose();
        distance[k] = (other - graph.interior.row(i).transpose()).norm();
      }
      graph.weights(i, side) = 2 / (distance[0] * (distance[0] + distance[1]));
    }
  }
}

}  // namespace shellgrid::test
