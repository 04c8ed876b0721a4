// SPDX-License-Identifier: AGPL-3.0-or-later
#include "solvers/diffusion/embedded_boundary.h"

#include <Eigen/Dense>
#include <algorithm>
#include <array>
#include <cmath>
#include <string>

#include "meshing/core/error.h"
#include "meshing/core/parallel.h"
#include "meshing/distance/distance_field.h"
#include "meshing/surface/closest_point.h"
#include "meshing/surface/half_edges.h"
#include "solvers/scattering/fresnel.h"

namespace shellgrid {
namespace {

// Corner k of a cell lies towards + of axis a where bit a of k is set. Tetrahedra: the six ways from corner 0 to 7.
constexpr int tetrahedra[6][4] = {{0, 1, 3, 7}, {0, 1, 5, 7}, {0, 2, 3, 7}, {0, 2, 6, 7}, {0, 4, 5, 7}, {0, 4, 6, 7}};
// The lower faces' corners, two triangles each about the same diagonal as in the neighbour.
constexpr int lower_faces[3][2][3] = {{{0, 2, 6}, {0, 4, 6}}, {{0, 1, 5}, {0, 4, 5}}, {{0, 1, 3}, {0, 2, 3}}};

Vec3 corner(int k) { return Vec3(k & 1, (k >> 1) & 1, k >> 2); }
Vec3 crossing(const Vec3& a, double fa, const Vec3& b, double fb) { return a + fa / (fa - fb) * (b - a); }
double tetrahedron_volume(const Vec3& a, const Vec3& b, const Vec3& c, const Vec3& d) {
  return std::abs((b - a).cross(c - a).dot(d - a)) / 6;
}

// The part of a unit cell that lies inside.
struct CutCell {
  double volume = 0, area = 0;
  Vec3 moment = Vec3::Zero(), normal = Vec3::Zero();  // ∫ x dA, ∫ n dA

  void add_triangle(const Vec3& a, const Vec3& b, const Vec3& c, const Vec3& outward) {
    Vec3 vector = 0.5 * (b - a).cross(c - a);
    if (vector.dot(outward) < 0) vector = -vector;
    const double size = vector.norm();
    area += size;
    moment += size / 3 * (a + b + c);
    normal += vector;
  }
  void add_tetrahedron(const std::array<Vec3, 4>& x, const std::array<double, 4>& f) {
    int in[4], out[4], ins = 0, outs = 0;
    for (int k = 0; k < 4; ++k) (f[k] < 0 ? in[ins++] : out[outs++]) = k;
    const double whole = 1.0 / 6;
    if (ins == 0) return;
    if (ins == 4) {
      volume += whole;
      return;
    }
    // Outward: from the inside corners to the outside ones.
    Vec3 outward = Vec3::Zero();
    for (int k = 0; k < ins; ++k) outward -= x[in[k]] / ins;
    for (int k = 0; k < outs; ++k) outward += x[out[k]] / outs;
    const auto cut = [&](int a, int b) { return crossing(x[a], f[a], x[b], f[b]); };
    if (ins == 2) {
      const int a = in[0], b = in[1], c = out[0], d = out[1];
      const Vec3 ac = cut(a, c), ad = cut(a, d), bc = cut(b, c), bd = cut(b, d);
      volume += tetrahedron_volume(x[a], ac, ad, bd) + tetrahedron_volume(x[a], ac, bc, bd) +
                tetrahedron_volume(x[a], x[b], bc, bd);
      add_triangle(ac, ad, bd, outward);
      add_triangle(ac, bc, bd, outward);
      return;
    }
    const int alone = ins == 1 ? in[0] : out[0];
    const int* others = ins == 1 ? out : in;
    const Vec3 p = cut(alone, others[0]), q = cut(alone, others[1]), r = cut(alone, others[2]);
    const double tip = tetrahedron_volume(x[alone], p, q, r);
    volume += ins == 1 ? tip : whole - tip;
    add_triangle(p, q, r, outward);
  }
};

// The part of a triangle of area one half that lies inside.
double inside_area(double a, double b, double c) {
  const int ins = (a < 0) + (b < 0) + (c < 0);
  if (ins == 0) return 0;
  if (ins == 3) return 0.5;
  const bool one = ins == 1;
  if ((b < 0) == one && (a < 0) != one && (c < 0) != one) std::swap(a, b);
  if ((c < 0) == one && (a < 0) != one && (b < 0) != one) std::swap(a, c);
  const double tip = 0.5 * a / (a - b) * a / (a - c);  // about the corner that is alone
  return one ? tip : 0.5 - tip;
}

void check_coefficients(const EmbeddedGrid& grid, const std::vector<Rgb>& absorption,
                        const std::vector<Rgb>& reduced_extinction) {
  if (absorption.size() != grid.cells.size() || reduced_extinction.size() != grid.cells.size())
    throw InputError("embedded grid: the coefficients do not belong to its cells");
  for (std::size_t i = 0; i < absorption.size(); ++i)
    if (!absorption[i].isFinite().all() || !(absorption[i] >= 0).all() || !reduced_extinction[i].isFinite().all() ||
        !(reduced_extinction[i] > 0).all())
      throw InputError("embedded grid: a coefficient of cell " + std::to_string(i) + " is not positive or not finite");
}

bool before(const Vec3i& a, const Vec3i& b) {
  return a.z() != b.z() ? a.z() < b.z() : a.y() != b.y() ? a.y() < b.y() : a.x() < b.x();
}

// Calls body(cell) for the cells in the 3×3×3 about a place.
template <class Body>
void for_neighbours(const EmbeddedGrid& grid, const Vec3i& at, const Body& body) {
  for (int z = -1; z <= 1; ++z)
    for (int y = -1; y <= 1; ++y) {
      // Cells of a row stand together.
      const Vec3i first = at + Vec3i(-1, y, z);
      for (auto c = std::lower_bound(grid.cells.begin(), grid.cells.end(), first, before);
           c != grid.cells.end() && c->z() == first.z() && c->y() == first.y() && c->x() <= first.x() + 2; ++c)
        body(static_cast<std::int32_t>(c - grid.cells.begin()));
    }
}

}  // namespace

EmbeddedGrid embed_level_set(const GridFrame& frame, const Vec3i& counts, const std::vector<float>& distance) {
  if (!(frame.voxel > 0) || (counts.array() < 2).any() ||
      distance.size() != static_cast<std::size_t>(counts.x()) * counts.y() * counts.z())
    throw InputError("embedded grid: the distances do not belong to its grid points");
  const auto index = [&](int x, int y, int z) {
    return (static_cast<std::size_t>(z) * counts.y() + y) * counts.x() + x;
  };
  const double h = frame.voxel, least = 1e-4 * h;
  EmbeddedGrid grid;
  grid.frame = frame;
  // Number of the cell at the same place of the layer before and of this one, for their shared faces.
  const std::size_t plane = static_cast<std::size_t>(counts.x()) * counts.y();
  std::vector<std::int32_t> below(plane, -1), here(plane, -1);
  for (int z = 0; z + 1 < counts.z(); ++z, std::swap(below, here)) {
    std::fill(here.begin(), here.end(), -1);
    for (int y = 0; y + 1 < counts.y(); ++y)
      for (int x = 0; x + 1 < counts.x(); ++x) {
        std::array<double, 8> f;
        int inside = 0;
        for (int k = 0; k < 8; ++k) {
          f[k] = distance[index(x + (k & 1), y + ((k >> 1) & 1), z + (k >> 2))];
          if (!std::isfinite(f[k])) throw InputError("embedded grid: a distance is not finite");
          if (std::abs(f[k]) < least) f[k] = f[k] < 0 ? -least : least;
          inside += f[k] < 0;
        }
        if (inside == 0) continue;
        if (x == 0 || y == 0 || z == 0 || x + 2 == counts.x() || y + 2 == counts.y() || z + 2 == counts.z())
          throw InputError("embedded grid: the object reaches its rim");
        const auto number = static_cast<std::int32_t>(grid.cells.size());
        const std::size_t at = static_cast<std::size_t>(y) * counts.x() + x;
        CutCell cut;
        if (inside == 8)
          cut.volume = 1;
        else
          for (const auto& t : tetrahedra) {
            std::array<Vec3, 4> corners;
            std::array<double, 4> values;
            for (int k = 0; k < 4; ++k) corners[k] = corner(t[k]), values[k] = f[t[k]];
            cut.add_tetrahedron(corners, values);
          }
        grid.cells.push_back({x, y, z});
        grid.volume.push_back(cut.volume * h * h * h);
        here[at] = number;
        const std::int32_t neighbours[3] = {here[at - 1], here[at - counts.x()], below[at]};
        for (int axis = 0; axis < 3; ++axis) {
          double area = 0;
          for (const auto& t : lower_faces[axis]) area += inside_area(f[t[0]], f[t[1]], f[t[2]]);
          if (area > 0 && neighbours[axis] >= 0) grid.faces.push_back({neighbours[axis], number, area * h * h});
        }
        if (cut.area > 0 && cut.normal.norm() > 0)
          grid.pieces.push_back({number, cut.area * h * h,
                                 frame.to_world({x, y, z}) + h * (cut.moment / cut.area).eval(),
                                 cut.normal.normalized()});
      }
  }
  if (grid.cells.empty()) throw InputError("embedded grid: nothing lies inside; the spacing is too wide");
  return grid;
}

EmbeddedGrid embed_surface(const TriangleMesh& surface, double spacing) {
  if (!(spacing > 0)) throw InputError("embedded grid: the spacing is not positive");
  if (surface.vertex_count() > 0 &&
      (surface.vertices.colwise().maxCoeff() - surface.vertices.colwise().minCoeff()).prod() >
          1e9 * std::pow(spacing, 3))
    throw InputError("embedded grid: it would have more than 1e9 cells; give a greater spacing");
  DistanceOptions options;
  options.voxel = spacing;
  options.inside_band = options.outside_band = 2 * spacing;
  DistanceStatistics statistics;
  const DistanceField field = compute_distance_field(surface, options, statistics);
  const Eigen::RowVector3d low = surface.vertices.colwise().minCoeff(), high = surface.vertices.colwise().maxCoeff();
  Vec3i first, counts;
  for (int a = 0; a < 3; ++a) {
    first[a] = static_cast<int>(std::floor((low[a] - field.frame.origin[a]) / spacing)) - 2;
    counts[a] = static_cast<int>(std::ceil((high[a] - field.frame.origin[a]) / spacing)) + 3 - first[a];
  }
  std::vector<float> distance(static_cast<std::size_t>(counts.x()) * counts.y() * counts.z());
  parallel_for(
      static_cast<std::size_t>(counts.z()),
      [&](std::size_t z) {
        for (int y = 0; y < counts.y(); ++y) {
          // Samples outside the band have the sign of the last one in it.
          auto last = static_cast<float>(2 * spacing);
          float* row = &distance[(z * counts.y() + y) * counts.x()];
          for (int x = 0; x < counts.x(); ++x) {
            const Vec3i at = first + Vec3i(x, y, static_cast<int>(z));
            if (field.distance.is_active(at.x(), at.y(), at.z()))
              row[x] = field.distance.value(at.x(), at.y(), at.z()),
              last = static_cast<float>(row[x] < 0 ? -2 * spacing : 2 * spacing);
            else
              row[x] = last;
          }
        }
      },
      1);
  GridFrame frame = field.frame;
  frame.origin = frame.to_world(first);
  return embed_level_set(frame, counts, distance);
}

EmbeddedSystem assemble_embedded_system(const EmbeddedGrid& grid, const std::vector<Rgb>& absorption,
                                        const std::vector<Rgb>& reduced_extinction, double ior) {
  check_coefficients(grid, absorption, reduced_extinction);
  const DiffuseFresnel fresnel = diffuse_fresnel(ior);
  const double c2 = 2 * fresnel.boundary_factor, h = grid.frame.voxel;
  const std::size_t n = grid.cells.size();
  const auto diffusion = [&](std::int32_t i) -> Double4 {
    return 1 / (3 * (to_double(to_lanes(reduced_extinction[i])) + Double4{0, 0, 0, 1}));
  };
  EmbeddedSystem system;
  system.light_factor = 4 / (1 - fresnel.fluence_reflectance);
  for (std::size_t i = 0; i < n; ++i) system.absorption.push_back(grid.volume[i] * to_double(to_lanes(absorption[i])));
  // Rows of couplings, ascending: to −z, −y, −x, +x, +y, +z.
  std::vector<std::array<std::int32_t, 6>> place(n);
  for (auto& p : place) p.fill(-1);
  for (std::size_t k = 0; k < grid.faces.size(); ++k) {
    const EmbeddedGrid::Face& face = grid.faces[k];
    const Vec3i step = grid.cells[face.upper] - grid.cells[face.lower];
    const int axis = step.x() ? 0 : step.y() ? 1 : 2;
    place[face.lower][3 + axis] = place[face.upper][2 - axis] = static_cast<std::int32_t>(k);
  }
  CouplingOperator& matrix = system.matrix;
  matrix.row_start.push_back(0);
  for (std::size_t i = 0; i < n; ++i) {
    for (const std::int32_t k : place[i]) {
      if (k < 0) continue;
      const EmbeddedGrid::Face& face = grid.faces[k];
      const Double4 a = diffusion(face.lower), b = diffusion(face.upper);
      matrix.column.push_back(face.lower == static_cast<std::int32_t>(i) ? face.upper : face.lower);
      matrix.coupling.push_back(to_float(face.area / h * (2 * a * b / (a + b))));
    }
    matrix.row_start.push_back(static_cast<std::int64_t>(matrix.column.size()));
  }
  matrix.reaction = system.absorption;
  for (const EmbeddedGrid::Piece& piece : grid.pieces) {
    const Double4 own = diffusion(piece.cell);
    const double reach = 0.5 * c2 * std::min({own[0], own[1], own[2]});
    std::int32_t cell = piece.cell;
    double depth = (piece.centre - grid.centre(cell)).dot(piece.normal);
    if (depth < -reach) {
      // The centre below that lies nearest to the piece's normal.
      double best = 1e300;
      for_neighbours(grid, grid.cells[piece.cell], [&](std::int32_t j) {
        const Vec3 way = piece.centre - grid.centre(j);
        const double d = way.dot(piece.normal), aside = (way - d * piece.normal).squaredNorm() + 0.1 * d * d;
        if (d > 0 && aside < best) best = aside, cell = j, depth = d;
      });
      depth = std::max(depth, -reach);
    }
    // D2 with ∂φ/∂n = (φ_s − φ_cell) / depth, φ_s eliminated.
    const Double4 factor = 1 / (c2 + depth / diffusion(cell));
    system.outlets.push_back({cell, piece.area, factor});
    matrix.reaction[cell] += piece.area * factor;
  }
  return system;
}

std::vector<Double4> boundary_source(const EmbeddedSystem& system, const std::vector<Double4>& irradiance) {
  std::vector<Double4> source(system.matrix.size(), Double4{});
  for (std::size_t k = 0; k < system.outlets.size(); ++k) {
    const EmbeddedSystem::Outlet& o = system.outlets[k];
    source[o.cell] += o.area * system.light_factor * o.factor * irradiance[k];  // PHYSICS D2
  }
  return source;
}

std::vector<Double4> boundary_exitance(const EmbeddedSystem& system, const std::vector<Double4>& fluence,
                                       const std::vector<Double4>& irradiance) {
  std::vector<Double4> exitance;
  for (std::size_t k = 0; k < system.outlets.size(); ++k) {
    const EmbeddedSystem::Outlet& o = system.outlets[k];
    exitance.push_back(irradiance[k] +
                       o.factor * (fluence[o.cell] - system.light_factor * irradiance[k]));  // PHYSICS D3
  }
  return exitance;
}

EnergyBalance energy_balance(const EmbeddedSystem& system, const std::vector<Double4>& fluence,
                             const std::vector<Double4>& irradiance) {
  const std::vector<Double4> exitance = boundary_exitance(system, fluence, irradiance);
  EnergyBalance balance;
  for (std::size_t k = 0; k < exitance.size(); ++k) {
    balance.entering += system.outlets[k].area * irradiance[k];
    balance.leaving += system.outlets[k].area * exitance[k];
  }
  for (std::size_t i = 0; i < fluence.size(); ++i) balance.absorbed += system.absorption[i] * fluence[i];
  balance.relative_defect = safe_quotient(balance.entering - balance.leaving - balance.absorbed, balance.entering);
  for (int c = 0; c < 4; ++c) balance.relative_defect[c] = std::abs(balance.relative_defect[c]);
  return balance;
}

std::vector<Rgb> pieces_to_vertices(const EmbeddedGrid& grid, const TriangleMesh& surface,
                                    const std::vector<Rgb>& values) {
  if (values.size() != grid.pieces.size()) throw InputError("embedded grid: the values are not one a piece");
  const VertexMatrix normals = vertex_normals(surface);
  std::vector<std::int32_t> piece_of(grid.cells.size(), -1);
  VertexMatrix centres(static_cast<Eigen::Index>(grid.pieces.size()), 3);
  for (std::size_t k = 0; k < grid.pieces.size(); ++k) {
    piece_of[grid.pieces[k].cell] = static_cast<std::int32_t>(k);
    centres.row(static_cast<Eigen::Index>(k)) = grid.pieces[k].centre.transpose();
  }
  const NearestVertexQuery nearest(centres);
  const double h = grid.frame.voxel;
  std::vector<Rgb> result(surface.vertex_count());
  parallel_for(result.size(), [&](std::size_t v) {
    const Vec3 place = surface.vertex(static_cast<int>(v)), normal = normals.row(v).transpose();
    const Vec3 u = normal.unitOrthogonal(), w = normal.cross(u);
    const Vec3i at = grid.frame.to_index(place).array().floor().cast<int>();
    Mat3 matrix = Mat3::Zero(), right = Mat3::Zero();  // right: a column a channel
    int count = 0;
    for_neighbours(grid, at, [&](std::int32_t cell) {
      const std::int32_t k = piece_of[cell];
      if (k < 0 || grid.pieces[k].normal.dot(normal) < 0.3) return;
      const Vec3 way = (grid.pieces[k].centre - place) / h;
      const Vec3 terms(1, way.dot(u), way.dot(w));
      const double weight = grid.pieces[k].area / (h * h) * std::exp(-1.5 * way.squaredNorm());
      matrix += weight * terms * terms.transpose();
      right += weight * terms * values[k].cast<double>().matrix().transpose();
      ++count;
    });
    const Eigen::LDLT<Mat3> factor(matrix);
    if (count >= 4 && factor.info() == Eigen::Success && factor.rcond() > 1e-3)
      result[v] = factor.solve(right).row(0).transpose().array().cast<float>();
    else
      result[v] = values[nearest.nearest(place)];
  });
  return result;
}

}  // namespace shellgrid
