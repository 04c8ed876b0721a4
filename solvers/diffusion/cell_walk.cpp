// SPDX-License-Identifier: AGPL-3.0-or-later
#include "solvers/diffusion/cell_walk.h"

#include <Eigen/Geometry>
#include <algorithm>
#include <string>

#include "meshing/core/error.h"
#include "solvers/diffusion/channel_lanes.h"

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

// A cell's map from reference coordinates r, s, t as a polynomial, with x, y and z in the lanes.
class CellMap {
 public:
  CellMap(const Polygrid& polygrid, std::int32_t cell) {
    Double4 x[8];
    for (int a = 0; a < 8; ++a) {
      const double* p = polygrid.points.data() + 3 * static_cast<std::ptrdiff_t>(polygrid.cells(cell, a));
      x[a] = Double4{p[0], p[1], p[2], 0};
    }
    constant_ = x[0];
    r_ = x[1] - x[0];
    s_ = x[3] - x[0];
    t_ = x[4] - x[0];
    rs_ = x[2] - x[1] - s_;
    rt_ = x[5] - x[1] - t_;
    st_ = x[7] - x[3] - t_;
    rst_ = x[6] - x[2] - x[5] + x[1] - st_;
  }

  // Where the reference point lies, and the derivatives there by r, s and t.
  void evaluate(const Vec3& at, Double4& place, Double4 derivative[3]) const {
    const double r = at.x(), s = at.y(), t = at.z();
    const Double4 by_rs = rs_ + t * rst_, by_r = r_ + t * rt_, by_s = s_ + t * st_;
    derivative[0] = by_r + s * by_rs;
    derivative[1] = by_s + r * by_rs;
    derivative[2] = t_ + r * rt_ + s * (st_ + r * rst_);
    place = constant_ + t * t_ + r * derivative[0] + s * by_s;
  }

 private:
  Double4 constant_, r_, s_, t_, rs_, rt_, st_, rst_;
};

Vec3 vector_of(Double4 a) { return {a[0], a[1], a[2]}; }

// Reference coordinates of a point in a cell, also a little outside of it. False where Newton's iteration fails.
bool invert(const CellMap& map, const Vec3& point, Vec3& reference) {
  const Double4 target = {point.x(), point.y(), point.z(), 0};
  for (int iteration = 0; iteration < 20; ++iteration) {
    Double4 place, derivative[3];
    map.evaluate(reference, place, derivative);
    const Vec3 rest = vector_of(target - place), r = vector_of(derivative[0]), s = vector_of(derivative[1]),
               t = vector_of(derivative[2]);
    const Vec3 across = s.cross(t);
    const double determinant = r.dot(across);
    if (!(std::abs(determinant) > 1e-300)) return false;
    Vec3 step = Vec3(across.dot(rest), t.cross(r).dot(rest), r.cross(s).dot(rest)) / determinant;
    const double length = step.cwiseAbs().maxCoeff();
    if (!(length < 1e6)) return false;
    if (length > 0.5) step *= 0.5 / length;
    reference += step;
    // The next step would be of this one's square.
    if (length < 1e-6) return true;
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
    if (invert(CellMap(polygrid, cells[at]), point, reference) && (reference.array() >= -1e-6).all() &&
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
    if (!invert(CellMap(polygrid, at.cell), point, at.reference)) break;
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
    // Most neighbours have the same axes; for others it is a place to start from like any.
    at.reference[face / 2] += face % 2 ? -1 : 1;
    at = {next, at.reference.cwiseMax(0).cwiseMin(1)};
  }
  return search_around(polygrid, neighbours, point, place) ? WalkEnd::inside : WalkEnd::lost;
}

double way_past_face(const Polygrid& polygrid, const CellPlace& outside, int face, const Vec3& direction) {
  const int k = face / 2;
  Double4 place, derivative[3];
  CellMap(polygrid, outside.cell).evaluate(outside.reference, place, derivative);
  // Of dr/dℓ, dx/dr being the derivatives: a coordinate's part across the others.
  const Vec3 across = vector_of(derivative[(k + 1) % 3]).cross(vector_of(derivative[(k + 2) % 3]));
  return (outside.reference[k] - face % 2) * vector_of(derivative[k]).dot(across) / direction.dot(across);
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
