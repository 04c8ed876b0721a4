// SPDX-License-Identifier: AGPL-3.0-or-later
#include "solvers/diffusion/polygrid_system.h"

#include <Eigen/Geometry>
#include <algorithm>
#include <cmath>
#include <numeric>
#include <string>

#include "meshing/core/error.h"
#include "meshing/core/parallel.h"
#include "meshing/polycube/polygrid_hierarchy.h"
#include "solvers/diffusion/divided_cell.h"
#include "solvers/diffusion/trilinear_cell.h"
#include "solvers/scattering/fresnel.h"

namespace shellgrid {
namespace {

// The 28 pairs of corners of a cell, and the pair's number from two corners.
struct CornerPairs {
  int number[8][8] = {};
  int first[28] = {}, second[28] = {};
  constexpr CornerPairs() {
    int n = 0;
    for (int a = 0; a < 8; ++a)
      for (int b = a + 1; b < 8; ++b, ++n) {
        number[a][b] = number[b][a] = n;
        first[n] = a;
        second[n] = b;
      }
  }
};
constexpr CornerPairs pairs;

struct ElementTerms {
  std::array<Float4, 28> coupling;   // −∫ D ∇h_a·∇h_b
  std::array<Float4, 8> absorption;  // ∫ σ_a h_a
};

void check_indices(const Polygrid& polygrid) {
  const auto points = static_cast<std::int32_t>(polygrid.points.rows());
  if (points == 0 || polygrid.cells.rows() == 0) throw InputError("polygrid: it has no cells");
  if (polygrid.boundary_quads.rows() == 0) throw InputError("polygrid: it has no boundary quads");
  if ((polygrid.cells.array() < 0).any() || (polygrid.cells.array() >= points).any())
    throw InputError("polygrid: a cell's point index is out of range");
  if ((polygrid.boundary_quads.array() < 0).any() || (polygrid.boundary_quads.array() >= points).any())
    throw InputError("polygrid: a boundary quad's point index is out of range");
  if (polygrid.point_lattice.rows() != points || static_cast<std::int32_t>(polygrid.outer_twin.size()) != points ||
      static_cast<Eigen::Index>(polygrid.cell_layer.size()) != polygrid.cells.rows())
    throw InputError("polygrid: its arrays differ in length");
  for (std::int32_t twin : polygrid.outer_twin)
    if (twin >= points) throw InputError("polygrid: an outer point's twin is out of range");
  if (!polygrid.points.allFinite()) throw InputError("polygrid: a coordinate is not finite");
}

// Throws for cells whose map is not one to one at a corner or a Gauss point; returns the volume.
double check_cells(const Polygrid& polygrid) {
  const TrilinearQuadrature& quadrature = TrilinearQuadrature::instance();
  struct Finding {
    std::int64_t inverted = 0, first = -1;
    double volume = 0;
    Finding operator+(const Finding& o) const {
      return {inverted + o.inverted, first >= 0 ? first : o.first, volume + o.volume};
    }
  };
  const Finding finding = parallel_sum(
      static_cast<std::size_t>(polygrid.cells.rows()), Finding{},
      [&](std::size_t cell) {
        const CellCorners x = cell_corners(polygrid, static_cast<int>(cell));
        double least = 1, volume = 0;
        for (const TrilinearShape& shape : quadrature.corner) least = std::min(least, jacobian(x, shape).determinant());
        for (const TrilinearShape& shape : quadrature.gauss) {
          const double determinant = jacobian(x, shape).determinant();
          least = std::min(least, determinant);
          volume += determinant / 8;
        }
        Finding own;
        own.volume = volume;
        if (!(least > 0)) own = {1, static_cast<std::int64_t>(cell), volume};
        return own;
      },
      512);
  if (finding.inverted > 0) {
    const CellCorners x = cell_corners(polygrid, static_cast<int>(finding.first));
    const Vec3 centre = x.colwise().mean();
    throw InputError("polygrid: " + std::to_string(finding.inverted) + " inverted or flat cells, the first (" +
                     std::to_string(finding.first) + ") at " + std::to_string(centre.x()) + " " +
                     std::to_string(centre.y()) + " " + std::to_string(centre.z()) + " mm; build the polygrid anew");
  }
  return finding.volume;
}

bool is_divided(const Rgb* reduced_extinction, int channel) {
  float least = reduced_extinction[0][channel], greatest = least;
  for (int q = 1; q < 8; ++q) {
    least = std::min(least, reduced_extinction[q][channel]);
    greatest = std::max(greatest, reduced_extinction[q][channel]);
  }
  return greatest > divided_contrast * least;
}

// Replaces what the trilinear element has for one channel.
void divide_element(const CellCorners& x, const Rgb* absorption, const Rgb* reduced_extinction, int channel,
                    ElementTerms& terms) {
  constexpr int vtk_of_bits[8] = {0, 1, 3, 2, 4, 5, 7, 6};
  double metric[8][6], diffusion[8], loss[8], coupling[28], absorbed[8];
  for (int q = 0; q < 8; ++q) {
    const int corner = vtk_of_bits[q];
    const Mat3 j = jacobian(x, TrilinearQuadrature::instance().gauss[corner]);
    const Mat3 inverse = j.inverse();
    const double volume = j.determinant() / 8;
    const Mat3 m = volume * inverse.transpose() * inverse;
    const double entries[6] = {m(0, 0), m(1, 1), m(2, 2), m(0, 1), m(0, 2), m(1, 2)};
    std::copy(entries, entries + 6, metric[q]);
    diffusion[q] = 1 / (3.0 * reduced_extinction[corner][channel]);
    loss[q] = volume * absorption[corner][channel];
  }
  divided_element(metric, diffusion, loss, coupling, absorbed);
  int pair = 0;
  for (int a = 0; a < 8; ++a) {
    terms.absorption[vtk_of_bits[a]][channel] = static_cast<float>(absorbed[a]);
    for (int b = a + 1; b < 8; ++b, ++pair)
      terms.coupling[pairs.number[vtk_of_bits[a]][vtk_of_bits[b]]][channel] = static_cast<float>(coupling[pair]);
  }
}

ElementTerms core_element(const CellCorners& x, const Rgb* absorption, const Rgb* reduced_extinction) {
  ElementTerms terms{};
  for (int q = 0; q < 8; ++q) {
    const TrilinearShape& shape = TrilinearQuadrature::instance().gauss[q];
    const Mat3 j = jacobian(x, shape);
    const double determinant = j.determinant();
    const Eigen::Matrix<double, 8, 3> gradient = shape.gradient * j.inverse().transpose();
    const Float4 diffusion =
        static_cast<float>(determinant / 8) / (3.0f * (to_lanes(reduced_extinction[q]) + Float4{0, 0, 0, 1}));
    const Float4 loss = to_lanes(absorption[q]) * static_cast<float>(determinant / 8);
    for (int n = 0; n < 28; ++n)
      terms.coupling[n] -=
          diffusion * static_cast<float>(gradient.row(pairs.first[n]).dot(gradient.row(pairs.second[n])));
    for (int a = 0; a < 8; ++a) terms.absorption[a] += loss * static_cast<float>(shape.value[a]);
  }
  for (int c = 0; c < 3; ++c)
    if (is_divided(reduced_extinction, c)) divide_element(x, absorption, reduced_extinction, c, terms);
  return terms;
}

// Corner quadrature: at corner a only a and its three edge neighbours have gradients.
ElementTerms layer_element(const CellCorners& x, const Rgb* absorption, const Rgb* reduced_extinction) {
  ElementTerms terms{};
  for (int q = 0; q < 8; ++q) {
    const TrilinearShape& shape = TrilinearQuadrature::instance().corner[q];
    const Mat3 j = jacobian(x, shape);
    const double determinant = j.determinant();
    const Eigen::Matrix<double, 8, 3> gradient = shape.gradient * j.inverse().transpose();
    const Float4 diffusion =
        static_cast<float>(determinant / 8) / (3.0f * (to_lanes(reduced_extinction[q]) + Float4{0, 0, 0, 1}));
    int active[4] = {q, 0, 0, 0}, count = 1;
    for (int a = 0; a < 8; ++a)
      if (a != q && !shape.gradient.row(a).isZero(0)) active[count++] = a;
    for (int m = 0; m < count; ++m)
      for (int n = m + 1; n < count; ++n)
        terms.coupling[pairs.number[active[m]][active[n]]] -=
            diffusion * static_cast<float>(gradient.row(active[m]).dot(gradient.row(active[n])));
    terms.absorption[q] += to_lanes(absorption[q]) * static_cast<float>(determinant / 8);
  }
  return terms;
}

// Cells about each point: entries 8·cell + corner, ascending.
struct Incidence {
  std::vector<std::int64_t> start;
  std::vector<std::int64_t> entry;
};

Incidence point_cells(const Polygrid& polygrid) {
  Incidence incidence;
  incidence.start.assign(polygrid.points.rows() + 1, 0);
  for (Eigen::Index k = 0; k < polygrid.cells.size(); ++k) ++incidence.start[polygrid.cells.data()[k] + 1];
  std::partial_sum(incidence.start.begin(), incidence.start.end(), incidence.start.begin());
  incidence.entry.resize(polygrid.cells.size());
  std::vector<std::int64_t> next(incidence.start.begin(), incidence.start.end() - 1);
  for (Eigen::Index k = 0; k < polygrid.cells.size(); ++k) incidence.entry[next[polygrid.cells.data()[k]]++] = k;
  return incidence;
}

void order_unknowns(const Polygrid& polygrid, PolygridSystem& system) {
  const auto n = static_cast<std::size_t>(polygrid.points.rows());
  std::vector<std::array<std::int32_t, 5>> order(n);
  for (std::size_t i = 0; i < n; ++i)
    order[i] = {polygrid.point_lattice(i, 2), polygrid.point_lattice(i, 1), polygrid.point_lattice(i, 0),
                polygrid.outer_twin[i] >= 0 ? 1 : 0, static_cast<std::int32_t>(i)};
  std::sort(order.begin(), order.end());
  system.point_of_unknown.resize(n);
  system.unknown_of_point.resize(n);
  system.key.resize(n);
  for (std::size_t u = 0; u < n; ++u) {
    system.point_of_unknown[u] = order[u][4];
    system.unknown_of_point[order[u][4]] = static_cast<std::int32_t>(u);
    system.key[u] = {order[u][2], order[u][1], order[u][0], order[u][3]};
  }
}

// The polygrid's transfers between points, for unknowns: an outer point's parents stand above its twin's.
std::vector<UnknownTransfer> transfer_unknowns(const Polygrid& polygrid, const PolygridSystem& system) {
  std::vector<UnknownTransfer> transfers;
  // Of the present level: each unknown's inner point and whether it is outer.
  struct Unknown {
    std::int32_t point;
    bool outer;
  };
  std::vector<Unknown> unknowns;
  for (const std::int32_t point : system.point_of_unknown) {
    const std::int32_t twin = polygrid.outer_twin[point];
    unknowns.push_back({twin >= 0 ? twin : point, twin >= 0});
  }
  for (const PointTransfer& points : point_transfers(polygrid)) {
    UnknownTransfer transfer;
    transfer.start.push_back(0);
    std::vector<char> has_outer(points.coarse_lattice.size(), 0);
    for (const Unknown& u : unknowns) {
      if (points.start[u.point + 1] == points.start[u.point])
        throw InputError("polygrid: a point belongs to no core cell, or an outer point's twin is outer itself");
      transfer.start.push_back(transfer.start.back() + points.start[u.point + 1] - points.start[u.point]);
      for (std::int64_t k = points.start[u.point]; u.outer && k < points.start[u.point + 1]; ++k)
        has_outer[points.parent[k]] = 1;
    }
    std::vector<std::int32_t> number(points.coarse_lattice.size());
    std::vector<Unknown> coarse;
    for (std::size_t p = 0; p < number.size(); ++p) {
      number[p] = static_cast<std::int32_t>(coarse.size());
      const Vec3i& at = points.coarse_lattice[p];
      for (int outer = 0; outer <= has_outer[p]; ++outer) {
        coarse.push_back({static_cast<std::int32_t>(p), outer == 1});
        transfer.key.push_back({at.x(), at.y(), at.z(), outer});
      }
    }
    transfer.parent.resize(transfer.start.back());
    parallel_for(
        unknowns.size(),
        [&](std::size_t i) {
          const Unknown& u = unknowns[i];
          std::int64_t at = transfer.start[i];
          for (std::int64_t k = points.start[u.point]; k < points.start[u.point + 1]; ++k)
            transfer.parent[at++] = number[points.parent[k]] + (u.outer ? 1 : 0);
        },
        2048);
    transfers.push_back(std::move(transfer));
    unknowns = std::move(coarse);
  }
  return transfers;
}

// Adds the elements' couplings up, row by row; a row's sum does not depend on threads, and A_ij = A_ji bit by bit.
void gather_rows(const Polygrid& polygrid, const std::vector<ElementTerms>& elements, PolygridSystem& system) {
  const Incidence incidence = point_cells(polygrid);
  const std::size_t n = system.point_of_unknown.size();
  struct Rows {
    std::vector<std::int32_t> length, column;
    std::vector<Float4> coupling;
  };
  constexpr std::size_t chunk = 2048;
  std::vector<Rows> parts((n + chunk - 1) / chunk);
  system.absorption.assign(n, Double4{});
  parallel_chunks(n, chunk, [&](std::size_t begin, std::size_t end) {
    Rows& rows = parts[begin / chunk];
    rows.column.reserve((end - begin) * 28);
    rows.coupling.reserve((end - begin) * 28);
    std::vector<std::int32_t> column;
    std::vector<Float4> coupling;
    for (std::size_t u = begin; u < end; ++u) {
      column.clear();
      coupling.clear();
      const std::int32_t point = system.point_of_unknown[u];
      for (std::int64_t e = incidence.start[point]; e < incidence.start[point + 1]; ++e) {
        const std::int64_t cell = incidence.entry[e] / 8;
        const int a = static_cast<int>(incidence.entry[e] % 8);
        system.absorption[u] += to_double(elements[cell].absorption[a]);
        for (int b = 0; b < 8; ++b) {
          if (b == a) continue;
          const std::int32_t other = polygrid.cells(cell, b);
          const std::size_t slot = std::find(column.begin(), column.end(), other) - column.begin();
          if (slot == column.size()) {
            column.push_back(other);
            coupling.push_back(Float4{});
          }
          coupling[slot] += elements[cell].coupling[pairs.number[a][b]];
        }
      }
      rows.length.push_back(static_cast<std::int32_t>(column.size()));
      for (std::int32_t other : column) rows.column.push_back(system.unknown_of_point[other]);
      rows.coupling.insert(rows.coupling.end(), coupling.begin(), coupling.end());
    }
  });
  CouplingOperator& matrix = system.matrix;
  matrix.row_start.assign(1, 0);
  matrix.row_start.reserve(n + 1);
  for (const Rows& rows : parts)
    for (std::int32_t length : rows.length) matrix.row_start.push_back(matrix.row_start.back() + length);
  matrix.column.resize(matrix.row_start.back());
  matrix.coupling.resize(matrix.row_start.back());
  parallel_for(
      parts.size(),
      [&](std::size_t p) {
        const std::int64_t at = matrix.row_start[p * chunk];
        std::copy(parts[p].column.begin(), parts[p].column.end(), matrix.column.begin() + at);
        std::copy(parts[p].coupling.begin(), parts[p].coupling.end(), matrix.coupling.begin() + at);
      },
      1);
}

void add_boundary_areas(const Polygrid& polygrid, PolygridSystem& system) {
  system.boundary_area.assign(system.point_of_unknown.size(), 0.0);
  for (Eigen::Index quad = 0; quad < polygrid.boundary_quads.rows(); ++quad) {
    const std::array<double, 4> area = quad_areas(polygrid, quad);
    for (int a = 0; a < 4; ++a) {
      system.boundary_area[system.unknown_of_point[polygrid.boundary_quads(quad, a)]] += area[a];
      system.surface_area += area[a];
    }
  }
}

}  // namespace

std::array<double, 4> quad_areas(const Polygrid& polygrid, Eigen::Index quad) {
  constexpr double gauss[2] = {0.5 - 0.28867513459481288225, 0.5 + 0.28867513459481288225};
  Vec3 x[4];
  for (int a = 0; a < 4; ++a) x[a] = polygrid.points.row(polygrid.boundary_quads(quad, a)).transpose();
  std::array<double, 4> result{};
  for (double s : gauss)
    for (double t : gauss) {
      const Vec3 along_s = (1 - t) * (x[1] - x[0]) + t * (x[2] - x[3]);
      const Vec3 along_t = (1 - s) * (x[3] - x[0]) + s * (x[2] - x[1]);
      const double area = 0.25 * along_s.cross(along_t).norm();
      const double value[4] = {(1 - s) * (1 - t), s * (1 - t), s * t, (1 - s) * t};
      for (int a = 0; a < 4; ++a) result[a] += area * value[a];
    }
  return result;
}

double check_polygrid(const Polygrid& polygrid) {
  check_indices(polygrid);
  return check_cells(polygrid);
}

PolygridSystem assemble_polygrid_system(const Polygrid& polygrid, const CellCoefficients& coefficients, double ior) {
  const double volume = check_polygrid(polygrid);
  const auto cells = static_cast<std::size_t>(polygrid.cells.rows());
  if (coefficients.absorption.size() != 8 * cells || coefficients.reduced_extinction.size() != 8 * cells)
    throw InputError("polygrid: the coefficients do not belong to its cells");
  const DiffuseFresnel fresnel = diffuse_fresnel(ior);
  PolygridSystem system;
  system.boundary_factor = fresnel.boundary_factor;
  system.current_reflectance = fresnel.current_reflectance;
  system.volume = volume;

  std::vector<ElementTerms> elements(cells);
  parallel_for(cells, [&](std::size_t cell) {
    const CellCorners x = cell_corners(polygrid, static_cast<int>(cell));
    const Rgb* absorption = coefficients.absorption.data() + 8 * cell;
    const Rgb* reduced_extinction = coefficients.reduced_extinction.data() + 8 * cell;
    elements[cell] = polygrid.cell_layer[cell] == 1 ? layer_element(x, absorption, reduced_extinction)
                                                    : core_element(x, absorption, reduced_extinction);
  });

  order_unknowns(polygrid, system);
  system.transfers = transfer_unknowns(polygrid, system);
  gather_rows(polygrid, elements, system);
  add_boundary_areas(polygrid, system);
  set_reaction(system);
  return system;
}

}  // namespace shellgrid
