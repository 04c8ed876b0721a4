// SPDX-License-Identifier: AGPL-3.0-or-later
#include "solvers/diffusion/cell_walk.h"

#include <Eigen/Geometry>
#include <algorithm>
#include <string>

#include "meshing/core/error.h"

namespace shellgrid {
namespace {

// Corners of the six faces, in the order of CellNeighbours.
constexpr int face_corners[6][4] = {{0, 3, 7, 4}, {1, 2, 6, 5}, {0, 1, 5, 4}, {3, 2, 6, 7}, {0, 1, 2, 3}, {4, 5, 6, 7}};

using FaceKey = std::array<std::int32_t, 4>;

FaceKey sorted_key(FaceKey key) {
  std::sort(key.begin(), key.end());
  return key;
}

constexpr double slack = 1e-9;

// Reference coordinates of a point in a cell, also a little outside of it. False where Newton's iteration fails.
bool invert(const CellCorners& x, const Vec3& point, Vec3& reference) {
  for (int iteration = 0; iteration < 20; ++iteration) {
    const TrilinearShape shape(reference);
    Vec3 rest = point;
    for (int a = 0; a < 8; ++a) rest -= shape.value[a] * x.row(a).transpose();
    const Mat3 j = jacobian(x, shape).transpose();
    const double determinant = j.determinant();
    if (!(std::abs(determinant) > 1e-300)) return false;
    Vec3 step = j.inverse() * rest;
    const double length = step.cwiseAbs().maxCoeff();
    if (!(length < 1e6)) return false;
    if (length > 0.5) step *= 0.5 / length;
    reference += step;
    if (length < 1e-10) return true;
    // Far outside, the direction is all that matters.
    if ((reference.array() < -1).any() || (reference.array() > 2).any()) return true;
  }
  return false;
}

// Looks for the point in the cells around, ring by ring.
bool search_around(const Polygrid& polygrid, const CellNeighbours& neighbours, const Vec3& point, CellPlace& place) {
  constexpr std::size_t most_cells = 250;
  std::vector<std::int32_t> cells = {place.cell};
  for (std::size_t at = 0; at < cells.size(); ++at) {
    Vec3 reference = Vec3::Constant(0.5);
    if (invert(cell_corners(polygrid, cells[at]), point, reference) && (reference.array() >= -1e-6).all() &&
        (reference.array() <= 1 + 1e-6).all()) {
      place = {cells[at], reference.cwiseMax(0).cwiseMin(1)};
      return true;
    }
    for (const std::int32_t next : neighbours.cell[cells[at]])
      if (next >= 0 && cells.size() < most_cells && std::find(cells.begin(), cells.end(), next) == cells.end())
        cells.push_back(next);
  }
  return false;
}

}  // namespace

CellNeighbours::CellNeighbours(const Polygrid& polygrid) {
  struct Face {
    FaceKey key;
    std::int32_t cell;  // −1 − quad for a boundary quad
    int number;
  };
  std::vector<Face> faces;
  faces.reserve(6 * polygrid.cells.rows() + polygrid.boundary_quads.rows());
  for (std::int32_t c = 0; c < polygrid.cells.rows(); ++c)
    for (int f = 0; f < 6; ++f) {
      FaceKey key;
      for (int k = 0; k < 4; ++k) key[k] = polygrid.cells(c, face_corners[f][k]);
      faces.push_back({sorted_key(key), c, f});
    }
  for (std::int32_t q = 0; q < polygrid.boundary_quads.rows(); ++q) {
    FaceKey key;
    for (int k = 0; k < 4; ++k) key[k] = polygrid.boundary_quads(q, k);
    faces.push_back({sorted_key(key), -1 - q, 0});
  }
  std::sort(faces.begin(), faces.end(), [](const Face& a, const Face& b) {
    return a.key != b.key ? a.key < b.key : a.cell != b.cell ? a.cell > b.cell : a.number < b.number;
  });
  const std::array<std::int32_t, 6> none = {-1, -1, -1, -1, -1, -1};
  cell.assign(polygrid.cells.rows(), none);
  quad.assign(polygrid.cells.rows(), none);
  quad_cell.assign(polygrid.boundary_quads.rows(), -1);
  quad_corners.resize(quad_cell.size());
  for (std::size_t at = 0; at < faces.size();) {
    std::size_t end = at + 1;
    while (end < faces.size() && faces[end].key == faces[at].key) ++end;
    if (end - at > 2) throw InputError("polygrid: more than two cells meet at a face");
    if (end - at == 2) {
      const Face &first = faces[at], &second = faces[at + 1];
      if (first.cell < 0) throw InputError("polygrid: a boundary quad stands twice");
      if (second.cell >= 0) {
        cell[first.cell][first.number] = second.cell;
        cell[second.cell][second.number] = first.cell;
      } else {
        const std::int32_t q = -1 - second.cell;
        quad[first.cell][first.number] = q;
        quad_cell[q] = first.cell;
        for (int k = 0; k < 4; ++k)
          for (int a = 0; a < 8; ++a)
            if (polygrid.cells(first.cell, a) == polygrid.boundary_quads(q, k))
              quad_corners[q][k] = Vec3(corner_coordinate[a][0], corner_coordinate[a][1], corner_coordinate[a][2]);
      }
    }
    at = end;
  }
  for (const std::int32_t behind : quad_cell)
    if (behind < 0) throw InputError("polygrid: a boundary quad is no cell's face");
}

WalkEnd walk_to(const Polygrid& polygrid, const CellNeighbours& neighbours, const Vec3& point, CellPlace& place,
                int& face) {
  CellPlace at = place;
  std::int32_t before = -1;
  for (int hop = 0; hop < 32; ++hop) {
    if (!invert(cell_corners(polygrid, at.cell), point, at.reference)) break;
    double worst = slack;
    face = -1;
    for (int k = 0; k < 3; ++k) {
      const double beyond[2] = {-at.reference[k], at.reference[k] - 1};
      for (int side = 0; side < 2; ++side) {
        const int f = 2 * k + side;
        // Curved faces may send a point back and forth between two cells: it is then as good as in either.
        if (beyond[side] > worst && (neighbours.cell[at.cell][f] != before || before < 0)) {
          worst = beyond[side];
          face = f;
        }
      }
    }
    if (face < 0) {
      at.reference = at.reference.cwiseMax(0).cwiseMin(1);
      place = at;
      return WalkEnd::inside;
    }
    const std::int32_t next = neighbours.cell[at.cell][face];
    if (next < 0) {
      place = at;
      return WalkEnd::surface;
    }
    before = at.cell;
    at = {next, Vec3::Constant(0.5)};
  }
  return search_around(polygrid, neighbours, point, place) ? WalkEnd::inside : WalkEnd::lost;
}

Vec3 face_normal(const Polygrid& polygrid, const CellPlace& place, int face) {
  Vec3 on_face = place.reference.cwiseMax(0).cwiseMin(1);
  on_face[face / 2] = face % 2;
  const Mat3 j = jacobian(cell_corners(polygrid, place.cell), TrilinearShape(on_face));
  const int k = face / 2;
  // ∂x/∂ξ of the other two coordinates span the face; cells have positive Jacobians.
  const Vec3 normal = j.row((k + 1) % 3).cross(j.row((k + 2) % 3)).transpose() * (face % 2 ? 1 : -1);
  const double length = normal.norm();
  return length > 0 ? Vec3(normal / length) : Vec3(0, 0, 1);
}

}  // namespace shellgrid
